"""Checks of an open chain: do joint readings and measured links belong together; and its points, link by link."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import Mask
from truing.belonging.relation import RecordSlip, RelationState, RelationTest, SlipKind
from truing.simulation.mechanisms.chains.column_slips import (
    ColumnSlip,
    ColumnSlipKind,
    does_not_belong,
    foreign_share,
    likely_slip,
)
from truing.simulation.mechanisms.chains.start_values import StartValues
from truing.simulation.mechanisms.chains.tree import Tree
from truing.stages.common.chain_measurements import chain_conditions, is_framed, measured_links, reference_link
from truing.stages.common.chain_start import nominal_fit
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
        start_of = nominal_fit(tree, settings, measured, conditions, usable).start_of
        start = start_of(usable, conditions)
        usable = _without_lone_errors(start, usable)
        start = start_of(usable, conditions)
    except ValueError:
        return RelationTest(JOINTS, RelationState.NOT_TESTED, "no-frame")
    misfit, limit = start.rms / _MM, foreign_share(start) / _MM
    if not does_not_belong(start):
        return RelationTest(JOINTS, RelationState.OK, "agrees", misfit=misfit, limit=limit, unit="mm")
    slip = likely_slip(conditions, tree.is_revolute, start_of)
    if slip is None:
        return RelationTest(JOINTS, RelationState.FAILS, "no-slip", misfit=misfit, limit=limit, unit="mm")
    # The diagnosis corrects an exchange and zeros, as findings; no other slip.
    corrected = slip.kind in (ColumnSlipKind.EXCHANGED, ColumnSlipKind.ZEROS)
    state = RelationState.ATTENTION if corrected else RelationState.FAILS
    return RelationTest(
        JOINTS,
        state,
        "no-slip" if state is RelationState.FAILS else "departs",
        misfit=misfit,
        misfit_explained=slip.after / _MM,
        limit=limit,
        unit="mm",
        slips=tuple(_recorded(slip, tree, table.schema.names)),
    )


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
