"""Checks of an open chain: do joint readings and measured links belong together; and its points, link by link."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Mask
from truing.belonging.joint_rows import ChainComparison, slips_in_poses, units_and_mirror
from truing.belonging.relation import RecordSlip, RelationState, RelationTest, SlipKind
from truing.simulation.mechanisms.chains.column_slips import (
    ColumnSlip,
    ColumnSlipKind,
    does_not_belong,
    foreign_share,
    likely_slip,
)
from truing.simulation.mechanisms.chains.conditions import ChainConditions
from truing.simulation.mechanisms.chains.start_values import StartValues
from truing.simulation.mechanisms.chains.tree import Tree
from truing.stages.common.chain_description import described_otherwise, rows_of
from truing.stages.common.chain_measurements import (
    MeasuredLinks,
    chain_conditions,
    is_framed,
    measured_links,
    reference_link,
)
from truing.stages.common.chain_start import NominalFit, nominal_fit
from truing.stages.common.chain_tables import joint_columns, joint_readings, tree_of
from truing.stages.common.point_arrays import pose_ids
from truing.stages.quality import point_checks
from truing.stages.quality.belonging import READINGS, belonging_checks
from truing.stages.quality.check import Check, CheckResults

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

JOINTS = "joints-against-links"
_OF_FRAMES = ("poses-determined", "geometry", "geometry-line", "geometry-plane", "geometry-leverage")
_FEWEST, _FEWEST_POSES = 3, 8
_MM = 1e-3
# Poses that miss by so many times the median are left out, if at least so large a share remains.
_FAR, _MOST = 5.0, 0.9
_RADIANS = 180.0 / np.pi
# Slips whose misfit is at most so many times that of the best explain the data as well.
_AS_LIKELY = 2.0


def checks(tables: Mapping[str, pa.Table], settings: Campaign) -> CheckResults:
    """Checks of joint readings against links, and of object points but for frames of links with few targets."""
    tested = joints_against_links(tables, settings)
    found = point_checks.checks(tables, settings)
    if found.why_not and tested.state is RelationState.NOT_TESTED:
        return found
    relations = (tested, *(one for one in found.relations if one.relation != READINGS))
    read = found.read or f"{len(tables['configurations'])} poses of a chain"
    single = set() if found.why_not else _single(tables["observations"])
    own = () if found.why_not else _without_frames(found, single)
    return replace(found, checks=chain(belonging_checks([tested]), own), read=read, relations=relations, why_not="")


def joints_against_links(tables: Mapping[str, pa.Table], settings: Campaign) -> RelationTest:
    """Test that the nominal chain at the joint readings reaches the measured places, up to a calibration."""
    if "joints" not in tables or not any(
        name in tables and tables[name].num_rows for name in ("observations", "measured_poses")
    ):
        return RelationTest(JOINTS, RelationState.NOT_TESTED, "no-poses")
    tree, table = tree_of(tables["joints"]), tables["configurations"]
    others = described_otherwise(tree, rows_of(settings.mechanism))
    try:
        measured = measured_links(tables, tree, pose_ids(table))
        readings = joint_readings(tree, table)
        usable = np.asarray(np.isfinite(readings).all(1) & measured.seen.any(1))
        usable &= is_framed(measured, reference_link(settings, measured))
        if usable.sum() < _FEWEST_POSES:
            return RelationTest(JOINTS, RelationState.NOT_TESTED, "no-poses")
        conditions = chain_conditions(
            tree, table, settings, measured.reference, np.nan_to_num(readings), usable, measured.coupling
        )
        fit = nominal_fit(tree, settings, measured, conditions, usable)
        start = fit.start_of(usable, conditions)
        in_poses = slips_in_poses(_comparison(fit, tree, table, measured, conditions, usable, start))
        everything = start
        usable = _without_lone_errors(start, usable)
        start = fit.start_of(usable, conditions)
    except ValueError:
        return RelationTest(JOINTS, RelationState.NOT_TESTED, "no-frame")
    tested = RelationTest(
        JOINTS, RelationState.OK, "agrees", misfit=everything.rms / _MM, limit=foreign_share(start) / _MM, unit="mm"
    )
    if in_poses is not None and in_poses.is_explained:
        return _failed(tested, in_poses.slips, in_poses.after)
    if not does_not_belong(start):
        # The diagnosis keeps poses that miss as a whole.
        if in_poses is not None and does_not_belong(everything):
            return _failed(tested, in_poses.slips, None)
        return replace(tested, misfit=start.rms / _MM)
    whole = sorted(
        [*_of_measured(fit, conditions, usable), *_of_description(others, settings, measured, conditions, usable)]
    )
    if whole:
        rivals = tuple(one.slip for one in whole[1:] if one.share < _AS_LIKELY * whole[0].share)
        return replace(_failed(tested, (whole[0].slip,), whole[0].after), rivals=rivals)
    slip = likely_slip(conditions, tree.is_revolute, fit.start_of)
    if slip is None:
        return _failed(tested, () if in_poses is None else in_poses.slips, None)
    # The diagnosis corrects an exchange and zeros, as findings; no other slip.
    corrected = slip.kind in (ColumnSlipKind.EXCHANGED, ColumnSlipKind.ZEROS)
    state = RelationState.ATTENTION if corrected else RelationState.FAILS
    return replace(
        tested,
        state=state,
        reason="no-slip" if state is RelationState.FAILS else "departs",
        misfit_explained=slip.after / _MM,
        slips=tuple(_recorded(slip, tree, table.schema.names)),
    )


def _failed(tested: RelationTest, slips: tuple[RecordSlip, ...], after: float | None) -> RelationTest:
    """The test with slips that explain it, and the misfit, m, after their correction."""
    left = None if after is None else after / _MM
    return replace(tested, state=RelationState.FAILS, reason="no-slip", slips=slips, misfit_explained=left)


def _comparison(
    fit: NominalFit,
    tree: Tree,
    table: pa.Table,
    measured: MeasuredLinks,
    conditions: ChainConditions,
    usable: Mask,
    start: StartValues,
) -> ChainComparison:
    """Readings and measured positions of the usable poses, for slips in some of them."""
    is_position, links, names = measured.is_position, measured.channels.links, measured.channels.names

    def errors_at(chosen: Mask) -> Callable[[Array, Array], Array]:
        fitted = np.zeros(len(usable), bool)
        fitted[usable] = chosen
        places = fit.start_of(fitted, conditions)
        if len(places.base_t) <= conditions.series.max():
            raise ValueError("a frame of the measurement without poses")

        def errors(readings: Array, values: Array) -> Array:
            own, of = conditions.readings.copy(), fit.values.copy()
            own[usable] = readings
            of[np.ix_(usable, is_position)] = values
            return fit.errors_at(places, replace(conditions, readings=own), of)[np.ix_(usable, is_position)]

        return errors

    return ChainComparison(
        conditions.readings[usable],
        fit.values[np.ix_(usable, is_position)],
        tree.is_revolute,
        [column.name for column in joint_columns(tree, table.schema.names)],
        [pair for pair, own in zip(zip(links, names, strict=True), is_position, strict=True) if own],
        [str(pose) for pose, own in zip(conditions.poses, usable, strict=True) if own],
        foreign_share(start),
        errors_at,
    )


@dataclass(frozen=True, order=True)
class _Whole:
    """A slip of all positions, or of the description: the misfit after it is undone, over the positions' spread and
    in m."""

    share: float
    slip: RecordSlip = field(compare=False)
    after: float = field(compare=False)


def _whole(slip: RecordSlip, after: StartValues) -> Iterator[_Whole]:
    if not does_not_belong(after):
        yield _Whole(after.rms / after.spread, slip, after.rms)


def _of_measured(fit: NominalFit, conditions: ChainConditions, usable: Mask) -> Iterator[_Whole]:
    """Yield units and mirror images of all measured positions that explain the misfit."""
    for one in units_and_mirror():
        values = np.where(fit.is_position[:, None], fit.values @ one.matrix, fit.values)
        yield from _whole(one.slip, fit.start_of(usable, conditions, values))


def _of_description(
    others: Iterable[tuple[RecordSlip, Tree]],
    settings: Campaign,
    measured: MeasuredLinks,
    conditions: ChainConditions,
    usable: Mask,
) -> Iterator[_Whole]:
    """Yield slips in the description, each with the chain without it, that explain the misfit."""
    for slip, other in others:
        fit = nominal_fit(other, settings, measured, conditions, usable)
        yield from _whole(slip, fit.start_of(usable, conditions))


def _recorded(slip: ColumnSlip, tree: Tree, names: list[str]) -> Iterator[RecordSlip]:
    """Yield the slip with the columns that it concerns; zeros one by one."""
    columns = [joint_columns(tree, names)[k] for k in slip.readings]
    subjects = tuple(column.name for column in columns)
    if slip.kind is ColumnSlipKind.EXCHANGED:
        yield RecordSlip(SlipKind.COLUMNS, "columns of readings", subjects)
    elif slip.kind is ColumnSlipKind.REVERSED:
        yield RecordSlip(SlipKind.SIGN, "readings", subjects)
    elif slip.kind in (ColumnSlipKind.DOWN, ColumnSlipKind.UP):
        yield RecordSlip(SlipKind.ROWS_SHIFTED, "readings", shift=1 if slip.kind is ColumnSlipKind.DOWN else -1)
    elif slip.kind is ColumnSlipKind.ZEROS:
        for column, offset in zip(columns, slip.offsets, strict=True):
            yield RecordSlip(SlipKind.ZERO, "readings", (column.name,), offset=offset / column.si)
    else:
        factor = _RADIANS if slip.kind is ColumnSlipKind.RADIANS else 1.0 / _RADIANS
        yield RecordSlip(SlipKind.UNIT, "readings", subjects, factor=factor, dimension="angle")


def _without_lone_errors(start: StartValues, usable: Mask) -> Mask:
    """Mask (B,) of the usable poses without a few that miss by far more than most, such as those of a wrong target."""
    size = np.sqrt(np.nanmean(np.sum(start.errors**2, -1), axis=1))
    kept = size <= _FAR * float(np.median(size))
    if kept.mean() < _MOST:
        return usable
    found = usable.copy()
    found[usable] = kept
    return found


def _single(observations: pa.Table) -> set[str]:
    """Links with fewer than three targets."""
    pairs = set(zip(*(observations.column(name).to_pylist() for name in ("body", "target")), strict=True))
    links = [link for link, _ in pairs]
    return {link for link in links if links.count(link) < _FEWEST}


def _without_frames(found: CheckResults, single: set[str]) -> Iterator[Check]:
    for check in found.checks:
        is_target = check.check == "geometry-leverage"
        of_frame = check.check in _OF_FRAMES and (check.subject in single or is_target)
        if check.check != READINGS and not (of_frame and single):
            yield check
