"""Information of a chain's poses on its unknowns and on each cause, with hidden combinations, as tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pyarrow as pa

from truing.arrays import TableRow
from truing.calibration.chain_design import (
    CauseSight,
    PlannedPoses,
    Remedy,
    cause_sights,
    hidden_combinations,
    observability_of,
    remaining_parts,
)
from truing.simulation.mechanisms.chains.causes import ChainCause
from truing.simulation.mechanisms.chains.harmonics import JointHarmonic, JointPitchError
from truing.stages.common.chain_candidates import JointRanges
from truing.stages.configurations.chain_poses import SEPARATION_SIGMAS, ShownByPoses

# The data determine a number if they reduce its prior standard deviation to less than this share (as in the diagnosis).
_DETERMINED = 0.7
_NEW_PAYLOAD_KG = 1.0  # next to no payload, where the campaign has none


def shown_by(
    poses: PlannedPoses, probes: PlannedPoses, causes: Sequence[ChainCause], ranges: JointRanges
) -> ShownByPoses:
    """Return the unknowns, causes and hidden combinations of poses; ``probes``: other poses that may show more."""
    unknowns, seen = observability_of(poses)
    prior = seen.scales
    numbers = {
        "kind": [str(unknown.kind) for unknown in unknowns],
        "subject": [unknown.subject for unknown in unknowns],
        "parameter": [unknown.parameter for unknown in unknowns],
        "unit": [unknown.unit for unknown in unknowns],
        "tolerance": pa.array([unknown.scale if unknown.is_known else None for unknown in unknowns], pa.float64()),
        "sigma_data_alone": pa.array([s if np.isfinite(s) else None for s in seen.sigma], pa.float64()),
        "sigma_expected": seen.sigma_with_prior,
        "identifiable": seen.sigma_with_prior < _DETERMINED * prior,
    }
    hidden = hidden_combinations(poses, probes)
    rows = [
        (
            combination,
            ranges.table(
                probes.conditions.readings[list(combination.poses)], times=pa.array(combination.times, pa.int64())
            ),
        )
        for combination in hidden
    ]
    return ShownByPoses(
        len(poses.conditions.readings), pa.table(numbers), _cause_table(poses, probes, causes), tuple(rows)
    )


def _cause_table(poses: PlannedPoses, probes: PlannedPoses, causes: Sequence[ChainCause]) -> pa.Table:
    """A row per parameter of each cause: its expected sigma, and the cause most like it with what would separate
    them."""
    sights = cause_sights(poses, causes)
    separability = remaining_parts(sights)
    nearest = separability.argmin(1) if len(sights) > 1 else np.zeros(len(sights), int)
    alike = [k for k in range(len(sights)) if sights[k].signal >= SEPARATION_SIGMAS > separability[k, nearest[k]]]
    scale = np.sqrt(len(poses.conditions.readings) / len(probes.conditions.readings))
    remedies = _remedies(probes, [(causes[k], causes[nearest[k]]) for k in alike], float(scale))
    remedy = dict(zip(alike, remedies, strict=True))
    rows: list[TableRow] = []
    for k, sight in enumerate(sights):
        rows += _cause_rows(
            sight, poses.model.part_count, sights[nearest[k]].cause, float(separability[k, nearest[k]]), remedy.get(k)
        )
    schema = pa.schema(
        [
            *((name, pa.string()) for name in ("cause", "subject", "parameter", "unit")),
            *((name, pa.float64()) for name in ("plausible", "sigma_expected", "signal", "visible_share", "order")),
            *((name, pa.string()) for name in ("most_like", "most_like_subject")),
            ("most_like_order", pa.float64()),
            ("apart", pa.float64()),
            ("separated_by", pa.string()),
        ]
    )
    return pa.Table.from_pylist(rows, schema=schema)


def _cause_rows(
    sight: CauseSight, parts: int, other: ChainCause, separability: float, remedy: Remedy | None
) -> list[TableRow]:
    cause = sight.cause
    common = {"cause": cause.id, "subject": cause.subject, "signal": sight.signal}
    common |= {"visible_share": sight.visible}
    common |= {"order": _order_of(cause)}
    if other is not cause:
        common |= {"most_like": other.id, "most_like_subject": other.subject, "apart": separability}
        common |= {"most_like_order": _order_of(other)}
    common |= {"separated_by": None if remedy is None else str(remedy)}
    return [
        {
            **common,
            "parameter": p.name,
            "unit": p.unit,
            "plausible": p.scale / p.si,
            "sigma_expected": float(s * p.scale / p.si) if np.isfinite(s) else None,
        }
        for p, s in zip(cause.parameters(parts), sight.sigma, strict=True)
    ]


def _order_of(cause: ChainCause) -> float | None:
    """Return the periods per turn of a harmonic; None for other causes, also for waves along a slide."""
    if isinstance(cause, JointPitchError) or not isinstance(cause, JointHarmonic):
        return None
    return float(cause.order)


def _remedies(probes: PlannedPoses, pairs: Sequence[tuple[ChainCause, ChainCause]], scale: float) -> list[Remedy]:
    """Poses that separate the effects of two causes: as many poses anywhere within the ranges, these with two payloads,
    or neither. ``scale``: root of the number of poses per probe."""
    if not pairs:
        return []
    causes = list({cause.key: cause for pair in pairs for cause in pair}.values())
    index_of = {cause.key: k for k, cause in enumerate(causes)}
    tried = [(Remedy.POSES, probes)]
    if probes.model.known.gravity is not None:
        usual = float(np.median(probes.conditions.payload_kg))
        payload = probes.conditions.payload_kg.copy()
        payload[::2] = 0.0
        payload[1::2] = usual or _NEW_PAYLOAD_KG
        tried.append((Remedy.PAYLOAD, replace(probes, conditions=replace(probes.conditions, payload_kg=payload))))
    sights_by_remedy = [(remedy, scale * remaining_parts(cause_sights(poses, causes))) for remedy, poses in tried]
    return [
        next(
            (
                remedy
                for remedy, separability in sights_by_remedy
                if separability[index_of[a.key], index_of[b.key]] >= SEPARATION_SIGMAS
            ),
            Remedy.NOTHING,
        )
        for a, b in pairs
    ]
