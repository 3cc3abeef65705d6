"""Test of a chain at its joint readings against measured positions or distances, with slips that explain a failure."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from truing.arrays import Array, Mask
from truing.belonging.joint_rows import ChainComparison, column_slip, slips_in_poses
from truing.belonging.relation import RecordSlip, RelationState, RelationTest, SlipKind
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
from truing.simulation.mechanisms.chains.joint_senses import JointSenses, senses_that_join
from truing.simulation.mechanisms.chains.start_values import StartValues
from truing.simulation.mechanisms.chains.tree import Tree
from truing.stages.common.chain_measurements import MeasuredLinks
from truing.stages.common.chain_start import NominalFit, tolerated_misfit
from truing.stages.common.chain_tables import joint_columns
from truing.stages.quality.chain_slips import (
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
from truing.stages.quality.orientation_checks import JOINTS

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

_DISTANCES = "distances"
_MM = 1e-3
# Slips whose misfit is at most this many times that of the best explain the data as well.
_AS_LIKELY = 2.0
# Share of the spread of the positions above which a misfit within tolerances says nothing: any readings leave as much.
_UNEXPLAINED = 0.5
# Another link that leaves this share of the spread is named before slips of single columns are tried.
_SURE = 0.002


def not_tested(reason: str, subject: str = "") -> RelationTest:
    """The test of joint readings without a result, for a reason."""
    return RelationTest(JOINTS, RelationState.NOT_TESTED, reason, subject)


def readings_tested(compared: ComparedChain, settings: Campaign) -> RelationTest:
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
            return not_tested("tolerances")
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


def hidden_slips(compared: ComparedChain) -> Iterator[RecordSlip]:
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
