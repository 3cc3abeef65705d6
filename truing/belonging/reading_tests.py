"""Tests of a legged mechanism: do actuator readings, measured poses and the description match each other?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from truing.arrays import Array, Index
from truing.belonging.clock_lag import Courses, clock_lag
from truing.belonging.reading_frames import other_frames
from truing.belonging.reading_hypotheses import (
    PENALTY,
    MeasuredMotion,
    RecordingHypothesis,
    descriptions,
    finite_required_readings,
    physical_effects,
)
from truing.belonging.reading_row_slips import (
    MOVED,
    ReadingNames,
    frozen_readings,
    row_slips,
    stray_readings_by_name,
    stray_slips,
)
from truing.belonging.reading_search import (
    APART,
    CLEAR,
    SlipSearch,
    likely_recordings,
    misfit_before_after,
    misfit_in_order,
    rival_slips,
    rms,
    search_slips,
)
from truing.belonging.relation import RecordSlip, RelationState, RelationTest, SlipKind
from truing.belonging.slips_in_rows import agreement, copied_columns, rounded_to, rounding, row_places, slipped_rows
from truing.simulation.mechanisms.legs.kinematics import closure_rows, upper_joints

READINGS, LEGS = "readings-against-poses", "legs-regular"
_NOTED = 0.2
_MOST_SLIPS = 2  # more slips together would explain any data
_LEAST_POSES = 3
_SINGLE = 3  # number of stray readings above which a part of the table is tested first
_TOLERATED = 4.0  # sigmas of an offset by the declared tolerances
_STRAIGHT = 0.05  # rad between directions of parallel legs
_SAME_M = 1e-6  # distance of joints that are the same
_SINGULAR = 1e-4  # least ratio of singular values of the legs' rows, with arms in units of their rms
_FREE_NUMBERS = 12  # least degrees of freedom after the fit of physics for a test of rounding


def relate_readings(motion: MeasuredMotion, names: ReadingNames) -> tuple[RelationTest, ...]:
    """Return the tests of the legs (do they hold the platform?) and of readings against poses.

    Leave out poses without a reading or a pose from ``motion``.
    """
    if len(motion.p) < _LEAST_POSES:
        return (RelationTest(READINGS, RelationState.NOT_TESTED, "no-poses"),)
    regular = relate_legs(motion)
    if regular is not None and regular.state is RelationState.FAILS:
        untested = RelationTest(READINGS, RelationState.NOT_TESTED, "legs-singular")
        return regular, _slip_of_joints(motion, names) or untested
    try:
        relation_test = _test(motion, names)
    except NotImplementedError:
        relation_test = RelationTest(READINGS, RelationState.NOT_TESTED, "no-inverse")
    return (relation_test,) if regular is None else (regular, relation_test)


def relate_legs(motion: MeasuredMotion) -> RelationTest | None:
    """Return the test if the described legs hold the platform at the measured poses; None for fewer than six."""
    legs = motion.legs
    if legs.count < 6:
        return None
    if (pair := _first_equal_legs(motion)) is not None:
        subject = " ".join(f"leg{leg + 1}" for leg in pair)
        return RelationTest(LEGS, RelationState.FAILS, "legs-alike", subject, misfit=0.0, limit=_SINGULAR, unit="1")
    with np.errstate(invalid="ignore", divide="ignore"):
        towards = legs.closure.close(legs, upper_joints(legs, motion.p, motion.R), motion.readings)[1]
    known = np.isfinite(towards).all((-1, -2))
    if not known.any():
        return None
    rows = closure_rows(legs, motion.R[known], -towards[known])
    arm = np.sqrt(np.mean(np.sum((legs.b - legs.b.mean(axis=0)) ** 2, axis=-1)))
    size = np.linalg.svd(rows / np.repeat([1.0, max(arm, 1e-12)], 3), compute_uv=False)
    worst = float((size[:, 5] / size[:, 0]).max())
    if worst >= _SINGULAR:
        return RelationTest(LEGS, RelationState.OK, "regular", misfit=worst, limit=_SINGULAR, unit="1")
    bend = np.linalg.norm(np.cross(towards[known], towards[known][:, :1]), axis=-1).max()
    reason = "legs-parallel" if bend < _STRAIGHT else "legs-singular"
    return RelationTest(LEGS, RelationState.FAILS, reason, misfit=worst, limit=_SINGULAR, unit="1")


def _first_equal_legs(motion: MeasuredMotion) -> tuple[int, int] | None:
    """Return two legs with the same joints, which hold the platform as one."""
    joints = np.concatenate([motion.legs.a, motion.legs.b], axis=-1)
    distance = np.linalg.norm(joints[:, None] - joints[None], axis=-1)
    pairs = np.argwhere(np.triu(distance < _SAME_M, 1)).tolist()
    return (pairs[0][0], pairs[0][1]) if pairs else None


def _test(motion: MeasuredMotion, names: ReadingNames) -> RelationTest:
    required = next(descriptions(motion)).required_readings()
    search = search_slips(motion)
    misfit, moved, legs = _plain_misfit(motion, required)
    comparable = np.isfinite(misfit)
    base = RelationTest(READINGS, RelationState.OK, "agrees", "", misfit, None, APART * moved, "mm", tried=search.tried)
    if not comparable:
        base = replace(
            base, state=RelationState.FAILS, reason="unreached", misfit=float(len(required)), limit=None, unit="1"
        )
    if (explained := _explained(search, motion, names, base)) and _is_near(search, explained):
        is_whole = 1e-3 * (explained.misfit_explained or 0.0) <= MOVED * motion.noise
        return explained if is_whole else _test_joints(motion, names, base) or explained
    if (misfit > APART * moved) and (framed := _in_other_frames(motion, base)):
        return _test_joints(motion, names, base) or framed  # exchanged joints of a flat side are a turned frame, too
    if zero := _other_zero(motion, required):
        return replace(base, state=RelationState.FAILS, reason="slip", misfit=abs(zero.offset), slips=(zero,))
    if frozen := frozen_readings(motion, required, names):  # a wrong description asks readings to move that do not
        failed = replace(base, state=RelationState.FAILS, reason="slip", slips=frozen)
        return _test_joints(motion, names, base) or failed
    if not comparable:
        return _test_joints(motion, names, base) or base
    if moved <= 1e3 * MOVED * motion.noise:
        return replace(base, state=RelationState.NOT_TESTED, reason="hardly-moved", misfit=None, limit=None)
    if strays := stray_readings_by_name(motion, required, names):
        stray = replace(base, state=RelationState.FAILS, reason="slip", slips=tuple(stray_slips(strays, names)))
        return (_test_of_part(motion, required, names, base) or stray) if len(strays) > _SINGLE else stray
    if misfit > APART * moved or len(legs):
        return (
            _test_of_part(motion, required, names, base)
            or _test_joints(motion, names, base)
            or _without_name(motion, required, names, base, legs)
        )
    departs = misfit > _NOTED * moved
    return (_test_of_part(motion, required, names, base) if departs else None) or _agreement_test(
        motion, search, names, base
    )


def _explained(
    search: SlipSearch, motion: MeasuredMotion, names: ReadingNames, base: RelationTest
) -> RelationTest | None:
    """Return the result if slips in all rows explain the data."""
    slips = (*search.intended.slips(names.columns, motion.readings), *row_slips(search.order, names))
    if not 0 < len(slips) <= _MOST_SLIPS:
        return None
    sizes = misfit_before_after(search.plain.misfit, misfit_in_order(search.intended, search.order), motion.noise)
    before, after = (1e3 * size for size in sizes)
    explained = replace(
        base, state=RelationState.FAILS, reason="slip", misfit=before, misfit_explained=after, unit="mm"
    )
    return replace(explained, slips=slips, rivals=rival_slips(search, names, motion, slips))


def _is_near(search: SlipSearch, explained: RelationTest) -> bool:
    """Return True if slips leave less than half of the required movement, as no error of the geometry does.

    The best order of rows wins by evidence alone, also where all rows stay far off.
    """
    required = finite_required_readings(search.intended.description)
    moved = 1e3 * rms(required - required.mean(axis=0))
    return explained.misfit_explained is None or explained.misfit_explained <= APART * moved


def _in_other_frames(motion: MeasuredMotion, base: RelationTest) -> RelationTest | None:
    """Return the result if readings and poses agree once fixed frames of base and platform are moved."""
    placed = other_frames(motion)
    if placed is None:
        return None
    after = 1e3 * placed.misfit
    before = None if base.reason == "unreached" else base.misfit
    return replace(
        base,
        state=RelationState.FAILS,
        reason="slip",
        unit="mm",
        misfit=before,
        misfit_explained=after,
        slips=(placed.slip,),
    )


def _slip_of_joints(motion: MeasuredMotion, names: ReadingNames) -> RelationTest | None:
    """Return the slip of the description that explains readings and poses, where its legs do not hold the platform."""
    try:
        return _test_joints(motion, names, RelationTest(READINGS, RelationState.FAILS, "no-slip", unit="mm"))
    except NotImplementedError:
        return None


def _test_joints(motion: MeasuredMotion, names: ReadingNames, base: RelationTest) -> RelationTest | None:
    """Return the result if a slip in the joints of few legs, or of one side, explains the data."""
    if copied_columns(motion.readings):  # a leg that reads as its mirror image does is no mirrored leg
        return None
    search = search_slips(motion, of_joints=True)
    if not search.intended.description.slips or row_slips(search.order, names):
        return None
    return _explained(search, motion, names, replace(base, tried=search.tried))


def _test_of_part(
    motion: MeasuredMotion, required: Array, names: ReadingNames, base: RelationTest
) -> RelationTest | None:
    """Return the result if slips explain some rows of the table and the rest is right."""
    reachable = np.flatnonzero(np.isfinite(required).all(axis=1))
    subset, wanted = motion.subset(reachable), required[reachable]
    agreed = agreement(subset.readings, wanted, motion.noise)
    if agreed is None:
        return None
    part = subset.subset(agreed.apart)
    for intended in likely_recordings(search_slips(part)):
        slips = [slip for slip in intended.slips(names.columns, part.readings) if slip.kind is not SlipKind.ZERO]
        undone = intended.undone(subset.readings)
        rows = slipped_rows(undone, wanted, agreed)
        if rows is not None and 0 < len(slips) <= _MOST_SLIPS:
            groups = [(name, [values[row] for row in reachable.tolist()]) for name, values in names.groups]
            where = row_places(*rows, [names.poses[row] for row in reachable.tolist()], groups)
            residual = np.where(rows[0][:, None], undone, subset.readings) - wanted
            found = tuple(_with_named_rows(slip, tuple(where)) for slip in slips)
            after = 1e3 * rms(residual - residual.mean(axis=0))
            return replace(
                base, state=RelationState.FAILS, reason="slip", unit="mm", misfit_explained=after, slips=found
            )
    return None


def _with_named_rows(slip: RecordSlip, where: tuple[str, ...]) -> RecordSlip:
    """Return a slip with the rows that it concerns before a long list of columns, which sentences cut short."""
    return replace(slip, subjects=(*where, *slip.subjects) if len(slip.subjects) > 2 else (*slip.subjects, *where))


def _without_name(
    motion: MeasuredMotion, required: Array, names: ReadingNames, base: RelationTest, legs: Index
) -> RelationTest:
    """Return the result if no tested slip explains the misfit, with the legs that do not fit, if others do."""
    pairs = [pair for pair in copied_columns(motion.readings) if set(pair) & set(legs.tolist())]
    if pairs:
        slips = tuple(
            RecordSlip(SlipKind.COPIED, "columns of readings", tuple(names.columns[leg] for leg in pair))
            for pair in pairs
        )
        return replace(base, state=RelationState.FAILS, reason="slip", slips=slips)
    failed = replace(base, state=RelationState.FAILS, reason="no-slip")
    if not 0 < len(legs) < len(names.columns):
        return failed
    measured_motion = motion.chosen_columns(legs)
    misfit, moved, _ = _plain_misfit(measured_motion, required[:, legs])
    return replace(failed, subject=" ".join(names.columns[leg] for leg in legs), misfit=misfit, limit=APART * moved)


def _agreement_test(
    motion: MeasuredMotion, search: SlipSearch, names: ReadingNames, base: RelationTest
) -> RelationTest:
    """Return the result if readings and poses agree within what a calibration explains."""
    if late := _late(motion, base):
        return late
    hidden = _hidden(motion, search.plain, names)
    misfit, moved = base.misfit or 0.0, (base.limit or 0.0) / APART
    if misfit <= _NOTED * moved:
        step = rounding(motion.readings, _calibrated_misfit(motion), motion.noise)
        return replace(base, hidden=hidden) if step is None else _rounded(base, step, motion.noise)
    step = rounded_to(motion.readings, 1e-3 * misfit, motion.noise)
    if step is None:
        return replace(base, state=RelationState.ATTENTION, reason="departs", hidden=hidden)
    slip = RecordSlip(SlipKind.ROUNDED, "readings", offset=1e3 * step)
    return replace(base, state=RelationState.FAILS, reason="slip", slips=(slip,))


def _rounded(base: RelationTest, step: float, noise: float) -> RelationTest:
    """Return a warning of numbers recorded in coarse steps: the error by rounding and the declared noise, mm."""
    slip = RecordSlip(SlipKind.ROUNDED, "readings", offset=1e3 * step)
    error = 1e3 * step / float(np.sqrt(12.0))
    return replace(
        base, state=RelationState.ATTENTION, reason="rounded", misfit=error, limit=1e3 * noise, slips=(slip,)
    )


def _calibrated_misfit(motion: MeasuredMotion) -> float:
    """Return the rms misfit, m, after a fit of geometry, gains, leaks and drivers; 0 where there are too few poses."""
    first_description = next(descriptions(motion))
    required, geometry = finite_required_readings(first_description), np.nan_to_num(first_description.by_geometry())
    travel = required - required.mean(axis=0)
    left, freedom = 0.0, 0
    for leg in range(required.shape[1]):
        columns = [geometry[:, leg], travel, travel[:, leg, None] ** 2, motion.drivers, np.ones((len(required), 1))]
        known = np.hstack(columns)
        known = known / np.maximum(np.sqrt(np.mean(known**2, axis=0)), 1e-300)
        misfit = motion.readings[:, leg] - required[:, leg]
        coefficients, _, rank, _ = np.linalg.lstsq(known, misfit, rcond=1e-9)
        left += float(np.sum((misfit - known @ coefficients) ** 2))
        freedom += len(misfit) - int(rank)
    return float(np.sqrt(left / freedom)) if freedom >= _FREE_NUMBERS else 0.0


def _late(motion: MeasuredMotion, base: RelationTest) -> RelationTest | None:
    """Return the result if readings are late by a common time against the poses, on a machine that moves."""
    description = next(descriptions(motion))
    required = finite_required_readings(description)
    courses = None if motion.time_s is None else Courses.of(required, motion.time_s)
    if courses is None:
        return None
    movements = courses.ways, np.concatenate([courses.ways, courses.last[..., None]], axis=-1)
    effects, settling = (physical_effects(motion, description, required, movement) for movement in movements)
    lag = clock_lag(motion.readings - required, courses, effects, settling, motion.noise)
    if lag is None:
        return None
    slip = RecordSlip(SlipKind.LATE, "readings", offset=lag.seconds)
    size = 1e3 * abs(lag.seconds) * rms(courses.rate)
    late = replace(base, state=RelationState.ATTENTION, reason="late", misfit=size, unit="mm", slips=(slip,))
    return replace(late, state=RelationState.FAILS, reason="slip") if lag.is_clear else late


def _plain_misfit(motion: MeasuredMotion, required: Array) -> tuple[float, float, Index]:
    """Return misfit and movement over all legs, rms in mm about each leg's mean; and the legs that do not fit alone."""
    known = np.isfinite(required).all(axis=1)
    if known.mean() < 0.5:
        return float("inf"), 0.0, np.arange(0)
    rows_known = np.flatnonzero(known)
    rows_known = rows_known[
        np.lexsort(motion.readings[rows_known].T)
    ]  # sorted, so that sums do not depend on the order of the rows in their last digits
    wanted, read = (values[rows_known] - values[rows_known].mean(axis=0) for values in (required, motion.readings))
    misfit, moved = np.sqrt(np.mean((read - wanted) ** 2, axis=0)), np.sqrt(np.mean(wanted**2, axis=0))
    wrong = (misfit > APART * moved) & (moved > MOVED * motion.noise)
    return 1e3 * rms(read - wanted), 1e3 * rms(wanted), np.flatnonzero(wrong)


def _other_zero(motion: MeasuredMotion, required: Array) -> RecordSlip | None:
    """Return the slip of readings relative to the reference configuration, or given as whole lengths. The offset must
    have this size in all legs, within tolerances. Calibration explains other offsets, which errors of the geometry can
    also cause."""
    legs = motion.legs
    residual = required - motion.readings
    offset = np.median(residual, axis=0)
    if not np.isfinite(offset).all():
        return None
    if not np.sqrt(np.nanmean((residual - offset) ** 2)) <= _NOTED * np.sqrt(
        np.nanmean((required - required.mean(axis=0)) ** 2)
    ):
        return None
    scale = next(descriptions(motion)).scales(motion.tolerance)
    sigma = np.linalg.norm(np.median(next(descriptions(motion)).by_geometry(), axis=0) * scale, axis=-1)
    for wanted in (legs.rho0, -legs.rho0, -legs.l):
        small = np.abs(offset - wanted) <= _TOLERATED * sigma
        if small.all() and (np.abs(wanted) > MOVED * sigma).all():
            return RecordSlip(SlipKind.ZERO, "readings", offset=1e3 * float(np.median(wanted)))
    return None


def _hidden(motion: MeasuredMotion, plain: RecordingHypothesis, names: ReadingNames) -> tuple[RecordSlip, ...]:
    """Return exchanges of columns that these poses cannot show, because the legs move equally."""
    required = finite_required_readings(plain.description)
    travel = required - required.mean(axis=0)
    level = max(rms(plain.misfit - plain.misfit.mean(axis=0)), motion.noise)
    needed = 2.0 * (CLEAR + PENALTY) / len(required)
    squared_distance = np.mean((travel[:, :, None] - travel[:, None, :]) ** 2, axis=0)
    pairs = [(i, j) for i, j in np.argwhere(squared_distance < needed * level**2).tolist() if i < j]
    return tuple(
        RecordSlip(SlipKind.COLUMNS, "columns of readings", (names.columns[i], names.columns[j])) for i, j in pairs
    )
