"""Choice of poses for an open chain, and what given poses show: geometry, joint zeros, and each cause.

Like `stages.design` no stage of a run: tables in, tables and numbers out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from truing.arrays import Array
from truing.calibration.chain_design import PlannedPoses, choose_chain_poses
from truing.estimation.design.pose_selection import bound_design, efficiency, sum_log_det
from truing.schemas.faults import CampaignFaults, Fault
from truing.simulation.mechanisms.chains.causes import ChainCause, JointOffset
from truing.simulation.mechanisms.chains.harmonics import JointHarmonic
from truing.simulation.mechanisms.chains.joint_curves import JointErrorCurve
from truing.simulation.mechanisms.chains.model import ChainModel
from truing.simulation.mechanisms.chains.tree import Tree
from truing.stages.common.chain_candidates import (
    FILE,
    ForbiddenPoses,
    JointRanges,
    conditions_of_table,
    drawn_readings,
    forbidden_poses,
    joint_ranges,
)
from truing.stages.common.chain_tables import joint_readings, tree_of
from truing.stages.common.missing_data import HELD_OUT
from truing.stages.configurations.chain_plan import ordered_poses, plan_table, poses_to_fit, verification_poses
from truing.stages.configurations.chain_poses import ChainDesign, ChainDesignTables
from truing.stages.configurations.chain_visibility import shown_by

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.stages.configurations.chosen import DesignOptions
    from truing.stages.diagnosis.diagnosis_data import DiagnosisData

_CANDIDATES = 1200
_PROBES = 200  # candidates that decide whether other poses, or another payload, would show something
_PLAN_POSES = 12  # least number of poses of a campaign that are evaluated


@dataclass(frozen=True)
class ChainScope:
    """Poses that a chain may take, and the model and instrument that evaluate them.

    ``drawn`` (C, n): candidate readings within ``ranges``, rad or m. ``layout``: the campaign's own poses; ``offered``:
    the candidates. ``kept`` (K, n): readings of poses that stay in the plan, with their information (G, G).
    """

    tree: Tree
    ranges: JointRanges
    regions: ForbiddenPoses
    drawn: Array
    data: DiagnosisData[ChainModel]
    layout: PlannedPoses
    offered: PlannedPoses
    kept: Array | None
    kept_information: Array | None


def chain_scope(
    settings: Campaign, options: DesignOptions, tables: ChainDesignTables, rng: np.random.Generator
) -> ChainScope:
    """Draw candidates, and linearise the campaign's model, with the causes of the options; raises CampaignFaults."""
    given = tables.campaign
    tree = tree_of(given["joints"])
    ranges = joint_ranges(tree, settings, given["joints"], given.get("configurations"))
    regions = forbidden_poses(tree, ranges, tables.avoid, tables.avoid_file, tables.functions)
    drawn = drawn_readings(tree, ranges, regions, _CANDIDATES, rng)
    data = _data(given, tree, ranges, drawn, settings)
    layout = _layout(data)
    offered = _planned(layout, settings, ranges.table(drawn, pose=pa.array(np.arange(len(drawn)))), drawn)
    offered = _with_causes(offered, settings, options.causes)
    kept = _kept_poses(offered, settings, tables, tree)
    return ChainScope(tree, ranges, regions, drawn, data, layout, offered, *kept)


def design_chain(settings: Campaign, options: DesignOptions, tables: ChainDesignTables) -> ChainDesign:
    """Choose poses of a chain, and report the detectable effects of these and the campaign's own poses.

    Raises CampaignFaults.
    """
    _check(options)
    rng = np.random.default_rng(options.seed)
    scope = chain_scope(settings, options, tables, rng)
    ranges, drawn, layout = scope.ranges, scope.drawn, scope.layout
    rows = scope.offered.rows
    choice = choose_chain_poses(rows, options.poses, scope.kept_information, options.method, rng)
    chosen = drawn[choice.chosen]
    check = verification_poses(drawn, chosen, ranges, options.verification)
    plan = np.concatenate([chosen, check])
    order = ordered_poses(plan, ranges, scope.kept, options, rng)
    table = plan_table(ranges, plan, order, options, tables.extend)
    everything = poses_to_fit(ranges, scope.kept, table)
    measured = _planned(layout, settings, everything, joint_readings(scope.tree, everything))
    probes = probe_poses(scope)
    existing = measured_poses(scope, tables)
    return ChainDesign(
        options,
        table,
        ranges,
        len(scope.regions.links) + len(scope.regions.functions),
        len(drawn),
        choice,
        0 if scope.kept is None else len(scope.kept),
        order,
        None if existing is None or len(layout.model.known.base_t) > 1 else _existing(scope.offered, existing, rows),
        None if existing is None else shown_by(existing, probes, _candidate_causes(existing, settings), ranges),
        shown_by(measured, probes, _candidate_causes(measured, settings), ranges),
        options.causes,
    )


def probe_poses(scope: ChainScope) -> PlannedPoses:
    """The first candidates, without the causes of the options: poses that stand for all that could be measured."""
    return _subset(replace(scope.offered, model=scope.layout.model), slice(0, _PROBES))


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
) -> DiagnosisData[ChainModel]:
    """Data of the diagnosis of the campaign, or of its nominal measurement if nothing was measured yet."""
    from truing.stages.diagnosis.search import assembled_data

    try:
        return assembled_data(_measured(given, tree, ranges, drawn, settings), settings).whole
    except ValueError as why:
        raise CampaignFaults([Fault(FILE, f"a campaign whose poses can be evaluated: {why}")]) from None


def _measured(
    given: Mapping[str, pa.Table], tree: Tree, ranges: JointRanges, drawn: NDArray, settings: Campaign
) -> Mapping[str, pa.Table]:
    from truing.stages.simulated_campaigns.chain_plan import nominal_tables

    if any(name in given and given[name].num_rows for name in ("observations", "measured_poses", "distances")):
        return given
    planned = given.get("configurations")
    if planned is None or len(planned) < _PLAN_POSES:
        poses = pa.array(np.arange(_PROBES) + 1)
        roles = pa.array(["calibration"] * _PROBES)
        planned = ranges.table(drawn[np.arange(_PROBES) % len(drawn)], pose=poses, role=roles)
    return nominal_tables(tree, given["joints"], given.get("survey"), planned, settings)


def _layout(data: DiagnosisData[ChainModel]) -> PlannedPoses:
    """The plain model at its nominal numbers, and the instrument of further poses."""
    from truing.stages.diagnosis.next_measurement import MeasuredPoints

    model: ChainModel = data.model.with_causes(())
    instrument = MeasuredPoints(data.calibration.measured, data.calibration.frames).instrument()
    return PlannedPoses(model, model.conditions, instrument)


def _planned(layout: PlannedPoses, settings: Campaign, table: pa.Table, readings: NDArray) -> PlannedPoses:
    return replace(layout, conditions=conditions_of_table(layout.model, settings, table, readings))


def _subset(poses: PlannedPoses, rows: slice) -> PlannedPoses:
    mask = np.zeros(len(poses.conditions.readings), bool)
    mask[rows] = True
    return replace(poses, conditions=poses.conditions.subset(mask))


def _candidate_causes(poses: PlannedPoses, settings: Campaign) -> list[ChainCause]:
    """Causes that stay with the machine, at every subject where these poses could show them."""
    from truing.stages.diagnosis.search import kinds_of, searched_for

    scene = poses.model.at(poses.conditions).scene
    known = searched_for(settings, kinds_of(settings).values())
    kinds = [kind for kind in known if kind.catalogued and isinstance(kind, ChainCause)]
    causes = [cause for kind in kinds for cause in scene.candidates(kind)]
    unsure = {poses.model.tree.readings[k] for k in poses.model.free_offsets}  # their zeros are unknowns already
    causes = [cause for cause in causes if not (isinstance(cause, JointOffset) and cause.joint in unsure)]
    # A curve imitates every function of its reading, and a harmonic whose order is searched competes with a hundred
    # others; the diagnosis compares them all.
    causes = [cause for cause in causes if not isinstance(cause, JointErrorCurve)]
    causes = [cause for cause in causes if not (isinstance(cause, JointHarmonic) and cause.beside > 0.0)]
    return [cause for cause in causes if cause.is_persistent and cause.parameters(poses.model.part_count)]


def _with_causes(poses: PlannedPoses, settings: Campaign, names: Sequence[str]) -> PlannedPoses:
    """The poses with the effects of causes among the unknowns; raises CampaignFaults for unknown names."""
    causes = _candidate_causes(poses, settings)
    known = list(dict.fromkeys(cause.id for cause in causes))
    if unknown := [name for name in names if name not in known]:
        expected = f"causes that poses of this chain can show: {', '.join(known)}"
        raise CampaignFaults(Fault("--causes", expected, value=name) for name in unknown)
    return replace(poses, model=poses.model.with_causes([cause for cause in causes if cause.id in names]))


def _kept_poses(
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


def measured_poses(scope: ChainScope, tables: ChainDesignTables) -> PlannedPoses | None:
    """The campaign's own poses that may be fitted; None without configurations."""
    given, layout = tables.campaign, scope.layout
    if "configurations" not in given or not len(given["configurations"]):
        return None
    conditions = scope.data.calibration.conditions
    if len(conditions.readings) != len(layout.model.conditions.readings) or len(given["configurations"]) < _PLAN_POSES:
        return None
    return layout


def _existing(offered: PlannedPoses, existing: PlannedPoses, rows: NDArray) -> float:
    """D-efficiency of the campaign's own poses relative to the best of as many."""
    poses = replace(existing, model=offered.model.at(existing.conditions))
    prior = np.eye(rows.shape[-1])[None]
    bound = bound_design(rows[:, None], len(existing.conditions.readings), prior, gap=1e-4)
    return efficiency(sum_log_det(poses.information + prior), bound.upper, rows.shape[-1])
