"""Choice of poses for an open chain, and what given poses show: geometry, joint zeros, and each cause.

Like `stages.design` no stage of a run: tables in, tables and numbers out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from truing.arrays import Array
from truing.calibration.chain_design import (
    CauseSight,
    PlannedPoses,
    Remedy,
    cause_sights,
    choose_chain_poses,
    hidden_combinations,
    observability_of,
    rest_apart,
)
from truing.estimation.design.pose_order import PoseOrder, order_poses
from truing.estimation.design.pose_selection import bound_design, efficiency, sum_log_det
from truing.schemas.faults import CampaignFaults, Fault
from truing.simulation.mechanisms.chains.causes import ChainCause, JointOffset
from truing.simulation.mechanisms.chains.harmonics import JointHarmonic
from truing.simulation.mechanisms.chains.joint_curves import JointErrorCurve
from truing.simulation.mechanisms.chains.model import ChainModel
from truing.simulation.mechanisms.chains.tree import Tree
from truing.stages.common.chain_candidates import (
    FILE,
    JointRanges,
    conditions_of_table,
    drawn_readings,
    forbidden_poses,
    joint_ranges,
)
from truing.stages.common.chain_tables import joint_readings, tree_of
from truing.stages.common.missing_data import HELD_OUT
from truing.stages.configurations.chain_poses import APART, ChainDesign, ChainDesignTables, ShownByPoses
from truing.stages.configurations.tables import first_number

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.stages.configurations.chosen import DesignOptions
    from truing.stages.diagnosis.diagnosis_data import DiagnosisData

_CANDIDATES = 1200
_PROBES = 200  # candidates that decide whether other poses, or another payload, would show something
_NEW_PAYLOAD_KG = 1.0  # beside no payload, where the campaign has none
_PLAN_POSES = 12  # least number of poses of a campaign that are evaluated


def design_chain(settings: Campaign, options: DesignOptions, tables: ChainDesignTables) -> ChainDesign:
    """Choose poses of a chain, and report what they and the campaign's own show; raises CampaignFaults."""
    _check(options)
    given, rng = tables.campaign, np.random.default_rng(options.seed)
    tree = tree_of(given["joints"])
    ranges = joint_ranges(tree, settings, given["joints"], given.get("configurations"))
    regions = forbidden_poses(tree, ranges, tables.avoid, tables.avoid_file, tables.functions)
    drawn = drawn_readings(tree, ranges, regions, _CANDIDATES, rng)
    data = _data(given, tree, ranges, drawn, settings)
    layout = _layout(data)
    offered = _planned(layout, settings, ranges.table(drawn, pose=pa.array(np.arange(len(drawn)))), drawn)
    with_causes = _with_causes(offered, settings, options.causes)
    rows = with_causes.rows
    kept_readings, kept = _kept(with_causes, settings, tables, tree)
    found = choose_chain_poses(rows, options.poses, kept, options.method, rng)
    chosen = drawn[found.chosen]
    check = _verification(drawn, chosen, ranges, options.verification)
    whole = np.concatenate([chosen, check])
    order = _ordered(whole, ranges, kept_readings, options, rng)
    table = _plan_table(ranges, whole, order, options, tables.extend)
    everything = _measured_poses(ranges, kept_readings, table)
    probes = _subset(offered, slice(0, _PROBES))
    own = _own_poses(data, given, settings, tree, layout)
    return ChainDesign(
        options,
        table,
        ranges,
        len(regions.links) + len(regions.functions),
        len(drawn),
        found,
        0 if kept_readings is None else len(kept_readings),
        order,
        None if own is None or len(layout.model.known.base_t) > 1 else _existing(with_causes, own, rows),
        None if own is None else _shown(own, probes, settings, ranges),
        _shown(_planned(layout, settings, everything, joint_readings(tree, everything)), probes, settings, ranges),
        options.causes,
    )


def _check(options: DesignOptions) -> None:
    """Raise CampaignFaults for options that only legs have."""
    if options.method == "direct":
        expected = "exchange, ioops or random; the gradient by the readings of a chain is not used yet"
        raise CampaignFaults([Fault("--method", expected, value=options.method)])
    if options.parameters:
        expected = "no parameters of legs; --causes adds causes to the unknowns of a chain"
        raise CampaignFaults([Fault("--parameters", expected, value=" ".join(options.parameters))])


def _data(
    given: Mapping[str, pa.Table], tree: Tree, ranges: JointRanges, drawn: NDArray, settings: Campaign
) -> DiagnosisData[Any]:
    """Data of the diagnosis of the campaign, or of its nominal measurement if nothing was measured yet."""
    from truing.stages.diagnosis.search import assembled_data

    try:
        if "distances" in given and given["distances"].num_rows:
            raise ValueError("points or poses: poses for distances are not chosen yet")
        return assembled_data(_measured(given, tree, ranges, drawn, settings), settings)
    except ValueError as why:
        raise CampaignFaults([Fault(FILE, f"a campaign whose poses can be evaluated: {why}")]) from None


def _measured(
    given: Mapping[str, pa.Table], tree: Tree, ranges: JointRanges, drawn: NDArray, settings: Campaign
) -> Mapping[str, pa.Table]:
    from truing.stages.simulated_campaigns.chain_plan import nominal_tables

    if any(name in given and given[name].num_rows for name in ("observations", "measured_poses")):
        return given
    planned = given.get("configurations")
    if planned is None or len(planned) < _PLAN_POSES:
        poses = pa.array(np.arange(_PROBES) + 1)
        roles = pa.array(["calibration"] * _PROBES)
        planned = ranges.table(drawn[np.arange(_PROBES) % len(drawn)], pose=poses, role=roles)
    return nominal_tables(tree, given["joints"], given.get("survey"), planned, settings)


def _layout(data: DiagnosisData[Any]) -> PlannedPoses:
    """The plain model at its nominal numbers, and the instrument of further poses."""
    from truing.stages.diagnosis.next_measurement import MeasuredPoints

    model: ChainModel = data.model.with_causes(())
    instrument = MeasuredPoints(data.calibration.measured, data.calibration.frames).instrument()
    return PlannedPoses(model, model.conditions, instrument)


def _planned(layout: PlannedPoses, settings: Campaign, table: pa.Table, readings: NDArray) -> PlannedPoses:
    return replace(layout, conditions=conditions_of_table(layout.model, settings, table, readings))


def _subset(poses: PlannedPoses, own: slice) -> PlannedPoses:
    mask = np.zeros(len(poses.conditions.readings), bool)
    mask[own] = True
    return replace(poses, conditions=poses.conditions.subset(mask))


def _candidate_causes(poses: PlannedPoses, settings: Campaign) -> list[ChainCause]:
    """Causes that stay with the machine, at every subject where these poses could show them."""
    from truing.stages.diagnosis.search import kinds_of, searched_for

    scene = poses.model.at(poses.conditions).scene
    known = searched_for(settings, kinds_of(settings).values())
    kinds = [kind for kind in known if kind.catalogued and isinstance(kind, ChainCause)]
    found = [cause for kind in kinds for cause in scene.candidates(kind)]
    unsure = {poses.model.tree.readings[k] for k in poses.model.free_offsets}  # their zeros are unknowns already
    found = [cause for cause in found if not (isinstance(cause, JointOffset) and cause.joint in unsure)]
    # A curve imitates every function of its reading, and a harmonic whose order is searched competes with a hundred
    # others; the diagnosis compares them all.
    found = [cause for cause in found if not isinstance(cause, JointErrorCurve)]
    found = [cause for cause in found if not (isinstance(cause, JointHarmonic) and cause.beside > 0.0)]
    return [cause for cause in found if cause.is_persistent and cause.parameters(poses.model.part_count)]


def _with_causes(poses: PlannedPoses, settings: Campaign, names: Sequence[str]) -> PlannedPoses:
    """The poses with the effects of causes among the unknowns; raises CampaignFaults for unknown names."""
    causes = _candidate_causes(poses, settings)
    known = list(dict.fromkeys(cause.id for cause in causes))
    if strange := [name for name in names if name not in known]:
        expected = f"causes that poses of this chain can show: {', '.join(known)}"
        raise CampaignFaults(Fault("--causes", expected, value=name) for name in strange)
    return replace(poses, model=poses.model.with_causes([cause for cause in causes if cause.id in names]))


def _kept(
    poses: PlannedPoses, settings: Campaign, tables: ChainDesignTables, tree: Tree
) -> tuple[Array | None, Array | None]:
    """Readings (K, n) of the poses that are kept, and their information (G, G)."""
    table = tables.extend
    if table is None:
        return None, None
    try:
        if "role" in table.schema.names:
            role = table.column("role").cast(pa.string())
            table = table.filter(pc.fill_null(pc.not_equal(role, HELD_OUT), True))
        readings = joint_readings(tree, table)
        if not len(readings) or not np.isfinite(readings).all():
            raise ValueError("a reading of every joint in every pose, and poses that are not for verification")
    except ValueError as why:
        raise CampaignFaults([Fault(tables.extend_file, str(why))]) from None
    if "pose" not in table.schema.names:
        table = table.append_column("pose", pa.array(np.arange(len(table))))
    return readings, _planned(poses, settings, table, readings).information


def _verification(drawn: NDArray, chosen: NDArray, ranges: JointRanges, count: int) -> Array:
    """Candidates far from the chosen poses and from each other, in shares of the ranges of the joints."""
    apart = np.abs((drawn[:, None] - chosen) / ranges.width).max(-1).min(1)
    found: list[int] = []
    for _ in range(count):
        found.append(int(np.argmax(apart)))
        apart = np.minimum(apart, np.abs((drawn - drawn[found[-1]]) / ranges.width).max(-1))
    return np.asarray(drawn[found])


def _ordered(
    readings: NDArray, ranges: JointRanges, kept: Array | None, options: DesignOptions, rng: np.random.Generator
) -> PoseOrder:
    """Order in which no function of a reading follows time: the reading, its sine and its cosine."""
    share = (readings - ranges.low) / ranges.width
    start = np.full(share.shape[1], 0.5) if kept is None else (kept[-1] - ranges.low) / ranges.width
    groups = np.stack([readings, np.sin(readings), np.cos(readings)], -1).transpose(1, 0, 2)
    return order_poses(share, start, groups, rng, options.trade_off)


def _plan_table(
    ranges: JointRanges, readings: NDArray, order: PoseOrder, options: DesignOptions, extend: pa.Table | None
) -> pa.Table:
    roles = np.repeat(["calibration", HELD_OUT], [options.poses, options.verification])[order.order].tolist()
    return ranges.table(
        readings[order.order],
        pose=pa.array(np.arange(len(readings)) + first_number(extend)),
        role=pa.array(roles, pa.string()),
    )


def _measured_poses(ranges: JointRanges, kept: NDArray | None, table: pa.Table) -> pa.Table:
    """Poses that are kept and those of a plan, without those for verification."""
    own = table.filter(pc.not_equal(table.column("role"), HELD_OUT)).select([c.name for c in ranges.columns])
    whole = own if kept is None else pa.concat_tables([ranges.table(kept), own])
    return whole.append_column("pose", pa.array(np.arange(len(whole))))


def _own_poses(
    data: DiagnosisData[Any], given: Mapping[str, pa.Table], settings: Campaign, tree: Tree, layout: PlannedPoses
) -> PlannedPoses | None:
    """The campaign's own poses that may be fitted; None without configurations."""
    if "configurations" not in given or not len(given["configurations"]):
        return None
    own = data.calibration.conditions
    if len(own.readings) != len(layout.model.conditions.readings) or len(given["configurations"]) < _PLAN_POSES:
        return None
    return layout


def _existing(offered: PlannedPoses, own: PlannedPoses, rows: NDArray) -> float:
    """D-efficiency of the campaign's own poses relative to the best of as many."""
    poses = replace(own, model=offered.model.at(own.conditions))
    prior = np.eye(rows.shape[-1])[None]
    bound = bound_design(rows[:, None], len(own.conditions.readings), prior, gap=1e-4)
    return efficiency(sum_log_det(poses.information + prior), bound.upper, rows.shape[-1])


def _shown(poses: PlannedPoses, probes: PlannedPoses, settings: Campaign, ranges: JointRanges) -> ShownByPoses:
    unknowns, seen = observability_of(poses)
    prior = seen.scales
    numbers = {
        "kind": [str(own.kind) for own in unknowns],
        "subject": [own.subject for own in unknowns],
        "parameter": [own.parameter for own in unknowns],
        "unit": [own.unit for own in unknowns],
        "tolerance": pa.array([own.scale if own.is_known else None for own in unknowns], pa.float64()),
        "sigma_data_alone": pa.array([s if np.isfinite(s) else None for s in seen.sigma], pa.float64()),
        "sigma_expected": seen.sigma_with_prior,
        "identifiable": seen.sigma_with_prior < _DETERMINED * prior,
    }
    hidden = hidden_combinations(poses, probes)
    rows = [
        (one, ranges.table(probes.conditions.readings[list(one.poses)], times=pa.array(one.times, pa.int64())))
        for one in hidden
    ]
    causes = _candidate_causes(poses, settings)
    return ShownByPoses(
        len(poses.conditions.readings), pa.table(numbers), _cause_table(poses, probes, causes), tuple(rows)
    )


# The data determine a number if they reduce its prior standard deviation to less than this share (as in the diagnosis).
_DETERMINED = 0.7


def _cause_table(poses: PlannedPoses, probes: PlannedPoses, causes: Sequence[ChainCause]) -> pa.Table:
    """A row per parameter of each cause: its expected sigma, and the cause most like it with what would separate
    them."""
    sights = cause_sights(poses, causes)
    apart = rest_apart(sights)
    nearest = apart.argmin(1) if len(sights) > 1 else np.zeros(len(sights), int)
    alike = [k for k in range(len(sights)) if sights[k].signal >= APART > apart[k, nearest[k]]]
    scale = np.sqrt(len(poses.conditions.readings) / len(probes.conditions.readings))
    remedies = _remedies(probes, [(causes[k], causes[nearest[k]]) for k in alike], float(scale))
    remedy = dict(zip(alike, remedies, strict=True))
    rows: list[dict[str, Any]] = []
    for k, sight in enumerate(sights):
        rows += _cause_rows(
            sight, poses.model.part_count, sights[nearest[k]].cause, float(apart[k, nearest[k]]), remedy.get(k)
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
    sight: CauseSight, parts: int, other: ChainCause, apart: float, remedy: Remedy | None
) -> list[dict[str, Any]]:
    cause = sight.cause
    common = {"cause": cause.id, "subject": cause.subject, "signal": sight.signal}
    common |= {"visible_share": sight.visible}
    common |= {"order": _order_of(cause)}
    if other is not cause:
        common |= {"most_like": other.id, "most_like_subject": other.subject, "apart": apart}
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
    return float(cause.order) if isinstance(cause, JointHarmonic) else None


def _remedies(probes: PlannedPoses, pairs: Sequence[tuple[ChainCause, ChainCause]], scale: float) -> list[Remedy]:
    """What separates the effects of two causes: as many poses anywhere within the ranges, these with two payloads, or
    neither. ``scale``: root of the number of poses per probe."""
    if not pairs:
        return []
    causes = list({cause.key: cause for pair in pairs for cause in pair}.values())
    place = {cause.key: k for k, cause in enumerate(causes)}
    tried = [(Remedy.POSES, probes)]
    if probes.model.known.gravity is not None:
        usual = float(np.median(probes.conditions.payload_kg))
        payload = probes.conditions.payload_kg.copy()
        payload[::2] = 0.0
        payload[1::2] = usual or _NEW_PAYLOAD_KG
        tried.append((Remedy.PAYLOAD, replace(probes, conditions=replace(probes.conditions, payload_kg=payload))))
    found = [(remedy, scale * rest_apart(cause_sights(poses, causes))) for remedy, poses in tried]
    return [
        next((remedy for remedy, apart in found if apart[place[a.key], place[b.key]] >= APART), Remedy.NOTHING)
        for a, b in pairs
    ]
