"""Tables of studies of a chain: accuracy of its tip after a calibration, what is unique, and effects of tolerances."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import Array, TableRow
from truing.calibration.chain_accuracy import (
    TipSight,
    ToleranceSource,
    covered,
    expected_errors,
    held_out_needed,
    poses_needed,
    tip_sight,
    tolerance_sources,
    total_variance,
)
from truing.calibration.chain_design import PlannedPoses, choose_chain_poses, hidden_combinations, observability_of
from truing.estimation.design.pose_selection import bound_design
from truing.schemas.faults import CampaignFaults, Fault
from truing.simulation.mechanisms.chains.closed_tree import ClosedTree
from truing.stages.chain_design import ChainScope, chain_scope, measured_poses, probe_poses
from truing.stages.common.chain_candidates import FILE, drawn_readings, forbidden_poses, joint_ranges
from truing.stages.common.chain_tables import tree_of
from truing.stages.common.missing_data import LEAST_POSES_OF_CHAIN
from truing.stages.configurations.chain_plan import ordered_poses, plan_table
from truing.stages.configurations.chain_poses import ChainDesignTables
from truing.stages.configurations.chosen import DesignOptions

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.chain_mechanism import ChainMechanism

_DEG, _MM = np.pi / 180.0, 1e-3
_COMPONENTS = {"x": "mm", "y": "mm", "z": "mm", "rx": "deg", "ry": "deg", "rz": "deg"}
_LIMITS_SI = np.array([_MM] * 3 + [_DEG] * 3)
_UNITS = ("um",) * 3 + ("arcsec",) * 3
_SI = np.array([1e-6] * 3 + [_DEG / 3600.0] * 3)
_EVALUATED = 400  # poses of the workspace at which errors are evaluated
_MOST_CHOSEN = 400  # poses of a plan that is made; with more, only their number is said
_DETERMINED = 0.7  # as in the diagnosis
_TRIES = 8


def chain_accuracy_tables(settings: Campaign, options: DesignOptions, tables: ChainDesignTables) -> dict[str, pa.Table]:
    """Return the tables by the ending of their file: expected errors (none), and ``-plan``, the poses to measure.

    The plan has the fewest poses by which every limit of [requirement] is reached; without one, as many as the options
    say. Raises CampaignFaults.
    """
    rng = np.random.default_rng(options.seed)
    scope = chain_scope(settings, options, tables, rng)
    offered = scope.offered
    try:
        sight = tip_sight(_some(offered, _EVALUATED))
    except ValueError as why:
        raise CampaignFaults([Fault(FILE, str(why))]) from None
    rows = offered.rows
    kept = np.zeros((rows.shape[-1],) * 2) if scope.kept_information is None else scope.kept_information
    limits = _limits(settings)
    needed = poses_needed(sight, _best_of_a_pose(rows, kept), kept, np.where(sight.known, limits, np.inf))
    least = 1 if scope.kept is not None else LEAST_POSES_OF_CHAIN
    needed = [None if count is None else max(count, least) for count in needed]
    plan, information = _plan(scope, sight, rows, kept, limits, needed, options, rng)
    found = _own_errors(scope, tables, sight, limits, needed)
    found += _errors("plan", len(plan), information, sight, limits, needed)
    order = ordered_poses(plan, scope.ranges, scope.kept, options, rng)
    table = plan_table(scope.ranges, plan, order, replace(options, poses=len(plan), verification=0), tables.extend)
    return {"": pa.Table.from_pylist(found, schema=_ERRORS), "-plan": table}


def chain_requirement_table(settings: Campaign, given: Mapping[str, pa.Table]) -> pa.Table:
    """Return the expected errors of a calibration by the campaign's own poses, measured or planned, with what decides
    its requirements; empty without any. Raises CampaignFaults."""
    limits, tables = _limits(settings), ChainDesignTables(given)
    if not np.isfinite(limits).any():
        return _ERRORS.empty_table()
    scope = chain_scope(settings, DesignOptions(1), tables, np.random.default_rng(0))
    try:
        sight = tip_sight(_some(scope.offered, _EVALUATED))
    except ValueError:  # nothing measured moves with the tip
        return _ERRORS.empty_table()
    return pa.Table.from_pylist(_own_errors(scope, tables, sight, limits, [None] * len(limits)), schema=_ERRORS)


def _own_errors(
    scope: ChainScope, tables: ChainDesignTables, sight: TipSight, limits: NDArray, needed: list[int | None]
) -> list[TableRow]:
    own = measured_poses(scope, tables)
    if own is None:
        return []
    own = replace(own, model=scope.offered.model.at(own.conditions))
    return _errors("own", len(own.conditions.readings), own.information, sight, limits, needed)


_ERRORS = pa.schema(
    [
        ("poses", pa.string()),
        ("count", pa.int64()),
        ("component", pa.string()),
        ("unit", pa.string()),
        ("error_95", pa.float64()),
        ("of_readings_95", pa.float64()),
        ("requirement", pa.float64()),
        ("poses_needed", pa.int64()),
        ("held_out_needed", pa.int64()),
        ("seen", pa.bool_()),
    ]
)


def _errors(
    poses: str, count: int, information: NDArray, sight: TipSight, limits: NDArray, needed: list[int | None]
) -> list[TableRow]:
    errors, held_out = expected_errors(sight, information), held_out_needed(sight, information, limits)
    of_readings = covered(sight.of_readings)
    return [
        {
            "poses": poses,
            "count": count,
            "component": component,
            "unit": _UNITS[k],
            "error_95": float(errors[k] / _SI[k]) if sight.known[k] else None,
            "of_readings_95": float(of_readings[k] / _SI[k]) if sight.known[k] else None,
            "requirement": float(limits[k] / _SI[k]) if np.isfinite(limits[k]) else None,
            "poses_needed": needed[k],
            "held_out_needed": held_out[k] if sight.known[k] else None,
            "seen": bool(sight.known[k]),
        }
        for k, component in enumerate(_COMPONENTS)
    ]


def _limits(settings: Campaign) -> Array:
    """Return the limits (6,) of [requirement], m and rad; infinite without one."""
    limits = [getattr(settings.requirement, f"{name}_{unit}") for name, unit in _COMPONENTS.items()]
    return np.array([np.inf if limit is None else limit for limit in limits], float) * _LIMITS_SI


def _some(poses: PlannedPoses, count: int) -> PlannedPoses:
    mask = np.arange(len(poses.conditions.readings)) < count
    return replace(poses, conditions=poses.conditions.subset(mask))


def _best_of_a_pose(rows: NDArray, kept: NDArray) -> Array:
    """Return the mean information (G, G) of a pose of the optimal design of many."""
    design = bound_design(rows[:, None], 100.0, (np.eye(rows.shape[-1]) + kept)[None], gap=1e-3)
    return np.asarray(np.einsum("c,cmg,cmh->gh", design.weights, rows, rows, optimize=True))


def _plan(
    scope: ChainScope,
    sight: TipSight,
    rows: NDArray,
    kept: NDArray,
    limits: NDArray,
    needed: list[int | None],
    options: DesignOptions,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Return readings (N, n) of the fewest poses that reach all limits within reach, and the information (G, G) with
    kept ones."""
    counts = [count for count in needed if count is not None]
    count = min(max(counts, default=options.poses), _MOST_CHOSEN)
    reached = np.array([number is not None and number <= _MOST_CHOSEN for number in needed])
    for _ in range(_TRIES):
        choice = choose_chain_poses(rows, count, scope.kept_information, options.method, rng)
        chosen = rows[choice.chosen].reshape(-1, rows.shape[-1])
        information = kept + chosen.T @ chosen
        if (expected_errors(sight, information)[reached] <= limits[reached]).all() or count >= _MOST_CHOSEN:
            break
        count += max(1, count // 10)
    return np.asarray(scope.drawn[choice.chosen]), np.asarray(information)


def chain_uniqueness_tables(
    settings: Campaign, options: DesignOptions, tables: ChainDesignTables
) -> dict[str, pa.Table]:
    """Return the tables: unknowns that are determined by kind (none), and ``-combinations`` that stay uncertain.

    ``possible`` are poses anywhere within the ranges of the joints, ``own`` those of the campaign. Raises
    CampaignFaults.
    """
    scope = chain_scope(settings, options, tables, np.random.default_rng(options.seed))
    possible, own = probe_poses(scope), measured_poses(scope, tables)
    counts: list[TableRow] = []
    combinations: list[TableRow] = []
    for name, poses in (("possible", possible), *((("own", own),) if own is not None else ())):
        unknowns, seen = observability_of(poses)
        for kind in dict.fromkeys(unknown.kind for unknown in unknowns):
            at = np.array([unknown.kind is kind for unknown in unknowns])
            determined = seen.sigma_with_prior[at] < _DETERMINED * seen.scales[at]
            row = {"poses": name, "count": len(poses.conditions.readings), "kind": str(kind)}
            counts.append({**row, "unknowns": int(at.sum()), "determined": int(determined.sum())})
        for combination in hidden_combinations(poses, possible):
            readings = scope.ranges.table(possible.conditions.readings[list(combination.poses)]).to_pylist()
            combinations.append(
                {
                    "poses": name,
                    "combination": combination.text,
                    "sigma": combination.sigma if np.isfinite(combination.sigma) else None,
                    "remedy": str(combination.remedy),
                    "shown_at": "; ".join(" ".join(f"{n} {v:g}" for n, v in row.items()) for row in readings) or None,
                }
            )
    text = dict.fromkeys(("poses", "combination", "remedy", "shown_at"), pa.string())
    order = ("poses", "combination", "sigma", "remedy", "shown_at")
    schema = pa.schema([(name, text.get(name, pa.float64())) for name in order])
    return {"": pa.Table.from_pylist(counts), "-combinations": pa.Table.from_pylist(combinations, schema=schema)}


def chain_tolerance_tables(
    settings: Campaign, options: DesignOptions, tables: ChainDesignTables
) -> dict[str, pa.Table]:
    """Return the tables: the tip's error by each tolerance (none), and ``-readings``, by the noise of each joint.

    Errors are those of a chain as built, without a calibration, over the ranges of the joints. Raises CampaignFaults.
    """
    section = cast("ChainMechanism", settings.mechanism)
    given = tables.campaign
    tree = tree_of(given["joints"])
    if isinstance(tree, ClosedTree):
        raise CampaignFaults([Fault(FILE, "a chain without loops: tolerances of loops are not studied yet")])
    tolerance = section.tolerance
    offsets = np.where(
        tree.is_revolute,
        (tolerance.offset_deg or 0.0) * _DEG,
        (tolerance.length_mm or 0.0 if tolerance.offset_mm is None else tolerance.offset_mm) * _MM,
    )
    sigma = np.array([(tolerance.length_mm or 0.0) * _MM] * 3 + [(tolerance.angle_deg or 0.0) * _DEG] * 3)
    if not offsets.any() and not sigma.any():
        expected = "offset_deg, offset_mm, length_mm or angle_deg: tolerances of the joints and links"
        raise CampaignFaults([Fault(FILE, expected, column="mechanism.tolerance")])
    ranges = joint_ranges(tree, settings, given["joints"], given.get("configurations"))
    regions = forbidden_poses(tree, ranges, tables.avoid, tables.avoid_file, tables.functions)
    readings = drawn_readings(tree, ranges, regions, 5 * _EVALUATED, np.random.default_rng(options.seed))
    last = max(k for k, node in enumerate(tree.nodes) if node.parent >= 0)
    tip = tree.links.get(section.tip or "", last)
    sources = tolerance_sources(tree, tip, readings, offsets, sigma)
    noise = np.where(tree.is_revolute, settings.noise.joint_deg * _DEG, settings.noise.joint_mm * _MM)
    of_readings = [source for source in tolerance_sources(tree, tip, readings, noise, np.zeros(6)) if noise.any()]
    total = total_variance(sources)
    rows = [_row(source, total) for source in sources]
    rows.sort(key=lambda row: -float(row["position_um"]))
    whole = {"kind": "all", "subject": "", **_sizes(total), "position_share": 1.0, "orientation_share": 1.0}
    made = {"": pa.Table.from_pylist([whole, *rows])}
    if of_readings:
        made["-readings"] = pa.Table.from_pylist([_row(source, total_variance(of_readings)) for source in of_readings])
    return made


def _sizes(variance: NDArray) -> dict[str, float]:
    """Return rms and largest error of position and orientation over the poses of variance (B, 6)."""
    parts = {
        "position": (variance[:, :3].sum(1), 1e-6, "um"),
        "orientation": (variance[:, 3:].sum(1), _SI[3], "arcsec"),
    }
    return {
        f"{name}{which}_{unit}": float(np.sqrt(size) / si)
        for name, (squares, si, unit) in parts.items()
        for which, size in (("", squares.mean()), ("_largest", squares.max()))
    }


def _row(source: ToleranceSource, total: NDArray) -> TableRow:
    own = source.variance
    shares = {
        f"{name}_share": float(own[:, part].sum() / max(float(total[:, part].sum()), 1e-300))
        for name, part in (("position", slice(0, 3)), ("orientation", slice(3, 6)))
    }
    return {"kind": source.kind, "subject": source.subject, **_sizes(own), **shares}
