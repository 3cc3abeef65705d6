"""Checks of an open chain: joint readings against measured links and distances, masses, copies, and points by link."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Mask
from truing.belonging.copied_poses import relate_copied_numbers
from truing.belonging.joint_rows import (
    ChainComparison,
    column_slip,
    slips_in_poses,
)
from truing.belonging.relation import RecordSlip, RelationState, RelationTest, SlipKind
from truing.belonging.weights import Weights, relate_weights
from truing.estimation.rigid_poses.points import PosePoints
from truing.quality.bodies import PoseSurroundings
from truing.simulation.mechanisms.chains.column_slips import (
    ColumnSlip,
    ColumnSlipKind,
    corrected_columns,
    does_not_belong,
    few_poses,
    foreign_misfit,
    half_turns_as_good,
    likely_slip,
)
from truing.simulation.mechanisms.chains.conditions import ChainConditions
from truing.simulation.mechanisms.chains.joint_senses import JointSenses, senses_that_join
from truing.simulation.mechanisms.chains.measured_lines import with_ground
from truing.simulation.mechanisms.chains.start_values import StartValues
from truing.simulation.mechanisms.chains.tree import JointKind, Tree
from truing.stages.common.chain_description import rows_of
from truing.stages.common.chain_distances import fit_of_distances, measured_distances
from truing.stages.common.chain_measurements import (
    MeasuredLinks,
    Screen,
    chain_conditions,
    excluded_poses,
    is_framed,
    measured_links,
    reference_link,
)
from truing.stages.common.chain_start import NominalFit, nominal_fit, tolerated_misfit
from truing.stages.common.chain_tables import joint_columns, joint_readings, payload_of, tree_of
from truing.stages.common.point_arrays import pose_ids
from truing.stages.quality import point_checks
from truing.stages.quality.belonging import READINGS, belonging_checks
from truing.stages.quality.chain_slips import (
    FEWEST_POSES,
    ComparedChain,
    WholeSlip,
    moved_frame,
    slips_of_bodies,
    slips_of_description,
    slips_of_links,
    slips_of_measured,
    slips_of_numbers,
    slips_of_single_lines,
    slips_of_surveys,
    slips_of_zeros,
    units_within_tolerances,
    with_most_poses,
    without_lone_errors,
)
from truing.stages.quality.check import Check, CheckResults
from truing.stages.quality.orientation_checks import FRAMES_DIFFER, JOINTS, orientation_test

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.chain_mechanism import ChainMechanism

_DISTANCES = "distances"
_OF_FRAMES = ("poses-determined", "geometry", "geometry-line", "geometry-plane", "geometry-leverage")
_FEWEST = 3
_MM = 1e-3
# Slips whose misfit is at most this many times that of the best explain the data as well.
_AS_LIKELY = 2.0
# Share of the spread of the positions above which a misfit within tolerances says nothing: any readings leave as much.
_UNEXPLAINED = 0.5
# Another link that leaves this share of the spread is named before slips of single columns are tried.
_SURE = 0.002


def checks(tables: Mapping[str, pa.Table], settings: Campaign) -> CheckResults:
    """Checks of joint readings against links, and of object points but for frames of links with few targets."""
    of_links = any(name in tables and tables[name].num_rows for name in ("observations", "measured_poses"))
    of_distances = "distances" in tables and tables["distances"].num_rows > 0
    tested = [joints_against_links(tables, settings)] if of_links or not of_distances else []
    tested += [joints_against_distances(tables, settings)] if of_distances else []
    results = point_checks.checks(tables, settings)
    tested += copies_of_links(tables, settings)
    tested += [masses_against_lengths(tables, settings)] if "joints" in tables else []
    if results.why_not and all(test.state is RelationState.NOT_TESTED for test in tested):
        return results
    relations = (*tested, *(relation for relation in results.relations if relation.relation != READINGS))
    read = results.read or f"{len(tables['configurations'])} poses of a chain"
    single = set() if results.why_not else _single(tables["observations"])
    of_times = point_checks.checks_of_times(tables, settings)
    loose = of_times if results.why_not else _without_frames(results, single, _framing(tables, settings))
    return replace(results, checks=chain(belonging_checks(tested), loose), read=read, relations=relations, why_not="")


def joints_against_links(tables: Mapping[str, pa.Table], settings: Campaign) -> RelationTest:
    """Test that the nominal chain at the joint readings reaches the measured places, up to a calibration."""
    if "joints" not in tables or not any(
        name in tables and tables[name].num_rows for name in ("observations", "measured_poses")
    ):
        return _not_tested("no-poses")
    try:
        compared = _links_compared(tables, settings)
        if compared is None:
            return _not_tested("no-poses")
        turned = orientation_test(compared, settings, tables.get("measured_poses"))
        if (
            turned is not None
            and turned.state is RelationState.FAILS
            and (turned.slips or turned.reason == FRAMES_DIFFER)
        ):
            return turned
        tested = _tested(compared, settings)
        # Single strays of orientations lead only where the positions agree.
        if (
            turned is not None
            and not tested.slips
            and (turned.state is not RelationState.ATTENTION or tested.state is RelationState.OK)
        ):
            return turned
        if tested.slips and all(slip.kind is SlipKind.STRAY for slip in tested.slips):
            # A wrong target bends the frame of its link: the pose misses, though its readings are right.
            compared = _links_compared(tables, settings, _away_from_shape)
            return tested if compared is None else _tested(compared, settings)
        return tested
    except ValueError:
        return _not_tested("no-frame")


def masses_against_lengths(tables: Mapping[str, pa.Table], settings: Campaign) -> RelationTest:
    """Test declared masses and their centres by the reach of the chain."""
    tree, table, section = (
        tree_of(tables["joints"]),
        tables["configurations"],
        cast("ChainMechanism", settings.mechanism),
    )
    readings = joint_readings(tree, table)
    travel = np.nan_to_num(np.nanmax(readings, axis=0, initial=0.0) - np.nanmin(readings, axis=0, initial=0.0))
    lengths = sum(float(np.sqrt(np.sum(node.t**2))) for node in tree.nodes)
    return relate_weights(
        Weights(
            np.array([node.mass for node in tree.nodes]),
            np.array([node.com for node in tree.nodes]),
            float(np.max(payload_of(settings, table), initial=0.0)),
            _MM * np.array(section.payload_com_mm or (0.0, 0.0, 0.0)),
            lengths + float(travel[~tree.is_revolute].sum()),
            all(node.mass > 0.0 for node in tree.nodes if node.kind is not JointKind.FIXED),
            _next_joints(tree),
            [node.link for node in tree.nodes],
        )
    )


def _next_joints(tree: Tree) -> Array:
    """Return the place (N, 3), m, of the next joint of each link in its frame; zero of outer links."""
    ends = np.zeros((len(tree.nodes), 3))
    for node in reversed(tree.nodes):
        if node.parent >= 0:
            ends[node.parent] = node.t
    return ends


def copies_of_links(tables: Mapping[str, pa.Table], settings: Campaign) -> list[RelationTest]:
    """The tests that no two measured poses, and no two rows of distances, are equal in every digit."""
    if "joints" not in tables:
        return []
    tree, poses = tree_of(tables["joints"]), pose_ids(tables["configurations"])
    found = []
    if "measured_poses" in tables and tables["measured_poses"].num_rows:
        measured = measured_links({"measured_poses": tables["measured_poses"]}, tree, poses)
        used, turned = measured.is_position, measured.channels.is_rotation
        found.append(_copies(measured, used, poses, "measurements", measured.reference[:, turned]))
    if "distances" in tables and tables["distances"].num_rows:
        measured = measured_distances(tables, with_ground(tree), poses)
        assert measured.ends is not None
        used = np.arange(measured.values.shape[1]) >= measured.values.shape[1] - len(measured.ends)
        found.append(_copies(measured, used, poses, _DISTANCES))
    return found


def _copies(
    measured: MeasuredLinks, used: Mask, poses: tuple[int | str, ...], quantity: str, also: Array | None = None
) -> RelationTest:
    """The test that the used channels (K,), m, are not equal in every digit in two poses."""
    is_observed = measured.is_observed[:, used]
    sigma = np.sqrt(np.diagonal(measured.cov[:, used], axis1=-2, axis2=-1))[is_observed]
    numbers = measured.values[:, used].reshape(len(poses), -1)
    seen = np.repeat(is_observed, measured.values.shape[-1], axis=1)
    least = float(np.nanmin(sigma)) if sigma.size else 0.0
    names = tuple(map(str, poses))
    orientations = None if also is None else also.reshape(len(poses), -1)
    return relate_copied_numbers(numbers, seen, least, names, quantity, orientations)


def _away_from_shape(tables: Mapping[str, pa.Table], body: str, points: PosePoints) -> Mask:
    """Mask (B, T) of the points of a body that do not fit its other points."""
    alone = PoseSurroundings(
        points.poses, np.arange(float(len(points.poses))), np.zeros((len(points.poses), 0)), (), None, is_counted=True
    )
    view = point_checks.viewed(tables["observations"], tables.get("survey"), body, alone)
    is_out_of_place = np.zeros(points.is_observed.shape, bool)
    is_out_of_place[:, [points.targets.index(name) for name in view.survey.targets]] = view.gross
    return is_out_of_place


def _links_compared(
    tables: Mapping[str, pa.Table], settings: Campaign, wrong: Screen | None = None
) -> ComparedChain | None:
    """Return the chain and what was measured on its links, without the points ``wrong``; None for too few poses."""
    tree, table = tree_of(tables["joints"]), tables["configurations"]
    measured = measured_links(tables, tree, pose_ids(table), wrong)
    usable = _usable(tree, table, measured)
    usable &= is_framed(measured, reference_link(settings, measured))
    usable &= ~excluded_poses(settings.exclude, pose_ids(table))
    if usable.sum() < FEWEST_POSES:
        return None
    compared = _compared(
        tree,
        table,
        settings,
        measured,
        usable,
        lambda other, conditions: nominal_fit(other, settings, measured, conditions, usable),
    )
    return replace(compared, fit_on=lambda other: nominal_fit(tree, settings, other, compared.conditions, usable))


def _compared(
    tree: Tree,
    table: pa.Table,
    settings: Campaign,
    measured: MeasuredLinks,
    usable: Mask,
    fit_of: Callable[[Tree, ChainConditions], NominalFit],
) -> ComparedChain:
    conditions = _conditions(tree, table, settings, measured, usable)
    rows = rows_of(cast("ChainMechanism", settings.mechanism))
    return ComparedChain(tree, table, measured, conditions, usable, rows, lambda other: fit_of(other, conditions))


def joints_against_distances(tables: Mapping[str, pa.Table], settings: Campaign) -> RelationTest:
    """Test that the nominal chain at the joint readings has the measured distances, up to a calibration."""
    tree, table = with_ground(tree_of(tables["joints"])), tables["configurations"]
    measured = measured_distances(tables, tree, pose_ids(table))
    usable = _usable(tree, table, measured)
    if usable.sum() < FEWEST_POSES:
        return _not_tested("no-poses", _DISTANCES)
    # The ground, which stands next to the chain, is no row of its description.
    compared = _compared(
        tree,
        table,
        settings,
        measured,
        usable,
        lambda other, conditions: fit_of_distances(with_ground(other), measured, conditions, usable),
    )
    tested = replace(_tested(compared, settings), subject=_DISTANCES)
    if tested.state is not RelationState.OK:
        return tested
    return replace(tested, hidden=tuple(_hidden(compared)))


def _not_tested(reason: str, subject: str = "") -> RelationTest:
    return RelationTest(JOINTS, RelationState.NOT_TESTED, reason, subject)


def _usable(tree: Tree, table: pa.Table, measured: MeasuredLinks) -> Mask:
    """Mask (B,) of the poses with readings of all joints, and a measurement."""
    return np.asarray(np.isfinite(joint_readings(tree, table)).all(1) & measured.is_observed.any(1))


def _conditions(
    tree: Tree, table: pa.Table, settings: Campaign, measured: MeasuredLinks, usable: Mask
) -> ChainConditions:
    readings = np.nan_to_num(joint_readings(tree, table))
    return chain_conditions(tree, table, settings, measured.reference, readings, usable, measured.coupling)


def _tested(compared: ComparedChain, settings: Campaign) -> RelationTest:
    """Test a chain at its readings; raises ValueError where no frame joins the poses."""
    readings = compared.conditions.readings[compared.usable]
    tolerated = tolerated_misfit(compared.tree, compared.measured.channels.node, readings, settings)
    fit, conditions, usable = compared.fit, compared.conditions, compared.usable
    everything = fit.start_of(usable, conditions)
    in_poses = slips_in_poses(_comparison(compared, fit, everything))
    usable = without_lone_errors(everything, usable)
    compared = replace(compared, usable=usable)
    start = fit.start_of(usable, conditions)
    limit = max(foreign_misfit(start), tolerated)
    tested = RelationTest(JOINTS, RelationState.OK, "agrees", misfit=everything.rms / _MM, limit=limit / _MM, unit="mm")
    if in_poses is not None and in_poses.is_explained:
        return _failed(tested, in_poses.slips, in_poses.after)
    if start.rms <= limit:
        # Tolerances may allow more than the whole range of the poses.
        if start.rms > foreign_misfit(start) and (units := list(units_within_tolerances(compared, fit, limit))):
            return _failed_as_a_whole(tested, units)
        if start.rms > _UNEXPLAINED * start.spread:
            return _not_tested("tolerances")
        tested = replace(tested, misfit=start.rms / _MM)
        if zeros := list(slips_of_zeros(compared, fit)):
            return _failed_as_a_whole(tested, zeros)
        if in_poses is None:
            return tested
        # The diagnosis keeps poses that miss as a whole.
        if everything.rms > limit:
            return _failed(replace(tested, misfit=everything.rms / _MM), in_poses.slips, None)
        return replace(tested, state=RelationState.ATTENTION, reason="strays", slips=in_poses.slips)
    return _explained(with_most_poses(compared), tested, tolerated)


def _explained(compared: ComparedChain, tested: RelationTest, tolerated: float) -> RelationTest:
    """The test of a chain that misses its limit, with the slips that explain it; ``tolerated``: misfit, m, by
    tolerances."""
    fit, conditions = compared.fit, compared.conditions
    if slips := [
        *slips_of_measured(compared, fit),
        *slips_of_links(compared),
        *slips_of_surveys(compared),
        *slips_of_description(compared),
        *slips_of_zeros(compared, fit),
    ]:
        return _with_columns_of_slides(_failed_as_a_whole(tested, slips), compared)
    if units := list(units_within_tolerances(compared, fit, tolerated)):
        return _failed_as_a_whole(tested, units)
    if (moved := moved_frame(compared, fit)) is not None:
        return _failed_as_a_whole(tested, [moved])
    bodies = list(slips_of_bodies(compared))
    if bodies and min(body.share for body in bodies) < _SURE:
        return _failed_as_a_whole(tested, bodies)
    slip = likely_slip(conditions, compared.tree.is_revolute, fit.start_of)
    if slip is None:
        if slips := [*slips_of_single_lines(compared, fit), *bodies, *slips_of_numbers(compared)]:
            return _failed_as_a_whole(tested, slips)
        if (senses := senses_that_join(compared.tree, conditions, fit.start_of)) is not None:
            return _failed(tested, _recorded_senses(senses, compared), senses.after)
        return _failed(tested, _constant(compared), None)
    if slip.kind is ColumnSlipKind.ZEROS and len(slip.readings) > 1:
        numbers = slips_of_numbers(compared)
        if numbers and min(number.after for number in numbers) <= _AS_LIKELY * slip.after:
            return _failed_as_a_whole(tested, numbers)
    # The diagnosis corrects an exchange and zeros, as findings; no other slip.
    corrected = slip.kind in (ColumnSlipKind.EXCHANGED, ColumnSlipKind.ZEROS)
    state = RelationState.ATTENTION if corrected else RelationState.FAILS
    equally_good = half_turns_as_good(slip, conditions, compared.tree.is_revolute, fit.start_of)
    names = compared.table.schema.names
    return replace(
        tested,
        rivals=tuple(row for equivalent in equally_good for row in _recorded(equivalent, compared.tree, names)),
        state=state,
        reason="no-slip" if state is RelationState.FAILS else "departs",
        misfit_explained=slip.after / _MM,
        slips=tuple(_recorded(slip, compared.tree, names)),
    )


def _failed(tested: RelationTest, slips: tuple[RecordSlip, ...], after: float | None) -> RelationTest:
    """The test with slips that explain it, and the misfit, m, after their correction."""
    explained = None if after is None else after / _MM
    return replace(tested, state=RelationState.FAILS, reason="no-slip", slips=slips, misfit_explained=explained)


def _comparison(compared: ComparedChain, fit: NominalFit, start: StartValues) -> ChainComparison:
    """Readings and measured positions or distances of the usable poses, for slips in some of them."""
    measured, conditions, usable = compared.measured, compared.conditions, compared.usable
    is_position, of_distances = measured.is_position, measured.ends is not None
    links = [_DISTANCES] * len(compared.names) if of_distances else measured.channels.links

    def errors_at(chosen: Mask) -> Callable[[Array, Array], Array]:
        fitted = np.zeros(len(usable), bool)
        fitted[usable] = chosen
        places = fit.start_of(fitted, conditions)
        if len(places.base_t) <= conditions.series.max() and not of_distances:
            raise ValueError("a frame of the measurement without poses")

        def errors(readings: Array, values: Array) -> Array:
            changed_readings, of = conditions.readings.copy(), fit.values.copy()
            changed_readings[usable] = readings
            of[np.ix_(usable, is_position)] = values
            return fit.errors_at(places, replace(conditions, readings=changed_readings), of)[
                np.ix_(usable, is_position)
            ]

        return errors

    chain_comparison = ChainComparison(
        conditions.readings[usable],
        fit.values[np.ix_(usable, is_position)],
        compared.tree.is_revolute,
        [column.name for column in joint_columns(compared.tree, compared.table.schema.names)],
        [pair for pair, used in zip(zip(links, compared.names, strict=True), is_position, strict=True) if used],
        [str(pose) for pose, used in zip(conditions.poses, usable, strict=True) if used],
        foreign_misfit(start),
        errors_at,
    )
    return (
        replace(chain_comparison, fewest=max(chain_comparison.fewest, _fewest(measured)))
        if of_distances
        else chain_comparison
    )


def _fewest(measured: MeasuredLinks) -> int:
    """Fewest poses whose distances determine the places of their ends twice over."""
    unknown = 3 * int((~np.isfinite(measured.surveyed).all(1)).sum())
    return -(-2 * unknown // measured.values.shape[1])


def _failed_as_a_whole(tested: RelationTest, whole_slips: list[WholeSlip]) -> RelationTest:
    """The test with those slips that explain it as well as the best of them, in the order in which they were tried."""
    least = min(slip.share for slip in whole_slips)
    first, *equally_good = (slip for slip in whole_slips if slip.share <= _AS_LIKELY * least)
    return replace(
        _failed(tested, (first.slip,), first.after), rivals=tuple(equivalent.slip for equivalent in equally_good)
    )


def _with_columns_of_slides(tested: RelationTest, compared: ComparedChain) -> RelationTest:
    """The test with the slips in columns of readings that explain it as well as mirrored positions do: a chain of
    slides alone shows no difference between a mirror image and a reversed slide, or two exchanged ones."""
    explained = tested.misfit_explained
    if compared.tree.is_revolute.any() or tested.slips[0].kind is not SlipKind.MIRRORED or explained is None:
        return tested
    fit, conditions = compared.fit, compared.conditions
    columns = [column.name for column in joint_columns(compared.tree, compared.table.schema.names)]
    found = tuple(
        column_slip(kind, [columns[k] for k in of_slip])
        for kind, of_slip, readings in corrected_columns(conditions.readings, compared.tree.is_revolute)
        if fit.start_of(compared.usable, replace(conditions, readings=readings)).rms / _MM <= _AS_LIKELY * explained
    )
    return replace(tested, rivals=(*tested.rivals, *found))


def _constant(compared: ComparedChain) -> tuple[RecordSlip, ...]:
    """Columns of readings whose value never changes."""
    readings = compared.conditions.readings[compared.usable]
    columns = joint_columns(compared.tree, compared.table.schema.names)
    still = tuple(column.name for column, reading in zip(columns, readings.T, strict=True) if not np.ptp(reading))
    return (RecordSlip(SlipKind.FROZEN, "readings", still),) if still else ()


def _hidden(compared: ComparedChain) -> Iterator[RecordSlip]:
    """Yield slips in columns of readings with which the chain would fit as well as without."""
    fit, conditions = compared.fit, compared.conditions
    few = few_poses(len(conditions.readings))
    columns = [column.name for column in joint_columns(compared.tree, compared.table.schema.names)]
    for kind, kind_columns, readings in corrected_columns(conditions.readings, compared.tree.is_revolute):
        if not does_not_belong(fit.start_of(few, replace(conditions, readings=readings))):
            yield column_slip(kind, [columns[k] for k in kind_columns])


def _recorded(slip: ColumnSlip, tree: Tree, names: list[str]) -> Iterator[RecordSlip]:
    """Yield the slip with the columns that it concerns; zeros one by one."""
    columns = [joint_columns(tree, names)[k] for k in slip.readings]
    if slip.kind is ColumnSlipKind.ZEROS:
        for column, offset in zip(columns, slip.offsets, strict=True):
            yield RecordSlip(SlipKind.ZERO, "readings", (column.name,), offset=offset / column.si)
    else:
        yield column_slip(slip.kind, [column.name for column in columns])


def _recorded_senses(senses: JointSenses, compared: ComparedChain) -> tuple[RecordSlip, ...]:
    """The slips of senses and coupling, in the order of their correction."""
    columns = [column.name for column in joint_columns(compared.tree, compared.table.schema.names)]
    slips = () if senses.coupling is None else (column_slip(senses.coupling, [columns[k] for k in senses.coupled]),)
    reversed_columns = [columns[k] for k in senses.reversed_readings]
    return (*slips, *((column_slip(ColumnSlipKind.REVERSED, reversed_columns),) if reversed_columns else ()))


def _single(observations: pa.Table) -> set[str]:
    """Links with fewer than three targets."""
    pairs = set(zip(*(observations.column(name).to_pylist() for name in ("body", "target")), strict=True))
    links = [link for link, _ in pairs]
    return {link for link in links if links.count(link) < _FEWEST}


def _framing(tables: Mapping[str, pa.Table], settings: Campaign) -> str:
    """Link whose targets define the frame of each pose; empty if none does."""
    links = tree_of(tables["joints"]).links if "joints" in tables else {}
    measured = {link for link in tables["observations"].column("body").to_pylist() if link in links}
    return "" if settings.is_frame_fixed or len(measured) < 2 else min(measured, key=links.__getitem__)


def _without_frames(check_results: CheckResults, single: set[str], framing: str) -> Iterator[Check]:
    """Checks that concern a chain: it uses each target by itself, but for those that define the frame of a pose."""
    for check in check_results.checks:
        is_target = check.check == "geometry-leverage"
        of_frame = check.check in _OF_FRAMES and bool(single) and (check.subject in single or is_target)
        is_needless = check.check == "poses-determined" and check.subject != framing
        if check.check != READINGS and not of_frame and not is_needless:
            yield check
