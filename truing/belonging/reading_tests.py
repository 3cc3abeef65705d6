"""Tests of a legged mechanism: do actuator readings, measured poses and the description match each other?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from truing.arrays import Array, Index
from truing.belonging.clock_lag import Courses, clock_lag
from truing.belonging.reading_hypotheses import (
    PENALTY,
    Description,
    MeasuredMotion,
    RecordingHypothesis,
    best_recording,
    descriptions,
    finite_required_readings,
    joint_descriptions,
    physical_effects,
)
from truing.belonging.relation import RecordSlip, RelationState, RelationTest, SlipKind
from truing.belonging.slips_in_rows import (
    RowOrder,
    agreement,
    best_order,
    copied_columns,
    rounded_to,
    rounding,
    row_places,
    slipped_rows,
    stray_readings,
)
from truing.simulation.mechanisms.legs.kinematics import closure_rows, upper_joints

READINGS, LEGS = "readings-against-poses", "legs-regular"
_APART = 0.5  # misfit over the required movement that no error of the geometry explains
_NOTED = 0.2
_MOVED = 10.0  # least movement of a leg for a comparison, in sigmas of a reading
_AS_LIKELY = 10.0  # log evidence within which two explanations are indistinguishable
_CLEAR = 50.0  # log evidence by which a slip must win
_MOST_SLIPS = 2  # more slips together would explain any data
_HALVES = 0.5  # largest share of the misfit that may remain after a slip is undone
_LEAST_POSES = 3
_MOST_POSES = 240  # most poses for hypotheses about columns and the description; rows are tested in all poses
_TOLERATED = 4.0  # sigmas of an offset by the declared tolerances
_STRAIGHT = 0.05  # rad between directions of parallel legs
_SAME_M = 1e-6  # distance of joints that are the same
_SINGULAR = 1e-4  # least ratio of singular values of the legs' rows, with arms in units of their rms
_MOSTLY = 0.7  # share of the rows that moved
_SINGLE = 3  # number of stray readings above which a part of the table is tested first
_FREE_NUMBERS = 12  # least degrees of freedom after the fit of physics for a test of rounding
_FROZEN = 4  # fewest equal readings in successive rows


@dataclass(frozen=True)
class ReadingNames:
    """Names of the columns of readings (L) and of the poses (B), and columns that group poses with their values."""

    columns: tuple[str, ...]
    poses: tuple[str, ...]
    groups: tuple[tuple[str, tuple[str, ...]], ...] = ()


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
    search = _search(motion)
    misfit, moved, legs = _plain_misfit(motion, required)
    comparable = np.isfinite(misfit)
    base = RelationTest(
        READINGS, RelationState.OK, "agrees", "", misfit, None, _APART * moved, "mm", tried=search.tried
    )
    if not comparable:
        base = replace(
            base, state=RelationState.FAILS, reason="unreached", misfit=float(len(required)), limit=None, unit="1"
        )
    if explained := _explained(search, motion, names, base):
        is_whole = 1e-3 * (explained.misfit_explained or 0.0) <= _MOVED * motion.noise
        return explained if is_whole else _test_joints(motion, names, base) or explained
    if zero := _other_zero(motion, required):
        return replace(base, state=RelationState.FAILS, reason="slip", misfit=abs(zero.offset), slips=(zero,))
    if frozen := _frozen(motion, required, names):  # a wrong description asks readings to move that do not
        failed = replace(base, state=RelationState.FAILS, reason="slip", slips=frozen)
        return _test_joints(motion, names, base) or failed
    if not comparable:
        return _test_joints(motion, names, base) or base
    if moved <= 1e3 * _MOVED * motion.noise:
        return replace(base, state=RelationState.NOT_TESTED, reason="hardly-moved", misfit=None, limit=None)
    if strays := _single_slips(motion, required, names):
        stray = replace(base, state=RelationState.FAILS, reason="slip", slips=tuple(_stray_slips(strays, names)))
        return (_test_of_part(motion, required, names, base) or stray) if len(strays) > _SINGLE else stray
    if misfit > _APART * moved or len(legs):
        return (
            _test_of_part(motion, required, names, base)
            or _test_joints(motion, names, base)
            or _without_name(motion, required, names, base, legs)
        )
    departs = misfit > _NOTED * moved
    return (_test_of_part(motion, required, names, base) if departs else None) or _agreement_test(
        motion, search, names, base
    )


def _explained(search: _Found, motion: MeasuredMotion, names: ReadingNames, base: RelationTest) -> RelationTest | None:
    """Return the result if slips in all rows explain the data."""
    slips = (*search.intended.slips(names.columns, motion.readings), *_row_slips(search.order, names))
    if not 0 < len(slips) <= _MOST_SLIPS:
        return None
    sizes = _halved(search.plain.misfit, _reordered(search.intended, search.order), motion.noise)
    before, after = (1e3 * size for size in sizes)
    explained = replace(
        base, state=RelationState.FAILS, reason="slip", misfit=before, misfit_explained=after, unit="mm"
    )
    return replace(explained, slips=slips, rivals=_rivals(search, names, motion, slips))


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
    search = _search(motion, of_joints=True)
    if not search.intended.description.slips or _row_slips(search.order, names):
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
    for intended in _likely(_search(part)):
        slips = [slip for slip in intended.slips(names.columns, part.readings) if slip.kind is not SlipKind.ZERO]
        undone = intended.undone(subset.readings)
        rows = slipped_rows(undone, wanted, agreed)
        if rows is not None and 0 < len(slips) <= _MOST_SLIPS:
            groups = [(name, [values[row] for row in reachable.tolist()]) for name, values in names.groups]
            where = row_places(*rows, [names.poses[row] for row in reachable.tolist()], groups)
            residual = np.where(rows[0][:, None], undone, subset.readings) - wanted
            found = tuple(_with_named_rows(slip, tuple(where)) for slip in slips)
            after = 1e3 * _rms(residual - residual.mean(axis=0))
            return replace(
                base, state=RelationState.FAILS, reason="slip", unit="mm", misfit_explained=after, slips=found
            )
    return None


def _with_named_rows(slip: RecordSlip, where: tuple[str, ...]) -> RecordSlip:
    """Return a slip with the rows that it concerns before a long list of columns, which sentences cut short."""
    return replace(slip, subjects=(*where, *slip.subjects) if len(slip.subjects) > 2 else (*slip.subjects, *where))


def _likely(search: _Found) -> list[RecordingHypothesis]:
    """Return possible intended readings in some rows, the most likely first. The rest of the table decides between
    them, because it determines the geometry far better than tolerances do."""
    least = search.plain.evidence + _AS_LIKELY
    likely = [one for one in (search.intended, *search.rivals) if one.evidence > least and not one.description.slips]
    return sorted(likely, key=lambda hypothesis: -hypothesis.evidence)


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
    return replace(failed, subject=" ".join(names.columns[leg] for leg in legs), misfit=misfit, limit=_APART * moved)


def _agreement_test(motion: MeasuredMotion, search: _Found, names: ReadingNames, base: RelationTest) -> RelationTest:
    """Return the result if readings and poses agree within what a calibration explains."""
    if late := _late(motion, base):
        return late
    hidden = _hidden(motion, search.plain, names)
    misfit, moved = base.misfit or 0.0, (base.limit or 0.0) / _APART
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
    size = 1e3 * abs(lag.seconds) * _rms(courses.rate)
    late = replace(base, state=RelationState.ATTENTION, reason="late", misfit=size, unit="mm", slips=(slip,))
    return replace(late, state=RelationState.FAILS, reason="slip") if lag.is_clear else late


def _single_slips(motion: MeasuredMotion, required: Array, names: ReadingNames) -> list[tuple[str, str]]:
    """Return the pose and the column of single readings that do not belong to their pose."""
    determined = np.isfinite(required).all(axis=1)
    at = np.flatnonzero(determined)
    readings = stray_readings(motion.readings[determined], required[determined], motion.noise)
    return [(names.poses[at[row]], names.columns[leg]) for row, leg in readings.tolist()]


def _stray_slips(strays: list[tuple[str, str]], names: ReadingNames) -> Iterator[RecordSlip]:
    """Yield the slip of poses of which most columns are stray, as the pose itself may be wrong; and of single
    readings."""
    poses = [pose for pose, _ in strays]
    poses_all_wrong = [pose for pose in dict.fromkeys(poses) if poses.count(pose) > 0.5 * len(names.columns)]
    cells = tuple(f"{column} in pose {pose}" for pose, column in strays if pose not in poses_all_wrong)
    if poses_all_wrong:
        yield RecordSlip(
            SlipKind.STRAY, "readings or measured position of", tuple(f"pose {pose}" for pose in poses_all_wrong)
        )
    if cells:
        yield RecordSlip(SlipKind.STRAY, "readings", cells)


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
    wrong = (misfit > _APART * moved) & (moved > _MOVED * motion.noise)
    return 1e3 * _rms(read - wanted), 1e3 * _rms(wanted), np.flatnonzero(wrong)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


@dataclass(frozen=True)
class _Found:
    """Readings as recorded, as most likely intended (in all poses), the order of rows, and the number of hypotheses
    tried."""

    plain: RecordingHypothesis
    intended: RecordingHypothesis
    order: RowOrder
    tried: int
    rivals: tuple[RecordingHypothesis, ...]


def _search(motion: MeasuredMotion, *, of_joints: bool = False) -> _Found:
    """Return the result for the mechanism as described and its slips; ``of_joints``: also those of few joints."""
    step = -(-len(motion.p) // _MOST_POSES)
    thin, tried = motion.every_nth(step), 0
    scored: list[tuple[RecordingHypothesis, Description]] = []
    plain = None
    for description in chain(descriptions(motion), joint_descriptions(motion) if of_joints else ()):
        hypothesis, intended, count = best_recording(thin, description.every_nth(step), exchanged=False)
        plain = plain or hypothesis
        scored.append((intended, description))
        tried += count
    assert plain is not None  # the description as recorded is always among them
    ahead = max(scored, key=lambda scored_row: scored_row[0].evidence)
    for description in {id(description_of): description_of for description_of in (scored[0][1], ahead[1])}.values():
        _, intended, count = best_recording(thin, description.every_nth(step), exchanged=True)
        scored.append((intended, description))
        tried += count
    best, description = max(scored, key=lambda pair: pair[0].evidence)
    if not _explains_enough(plain, best, motion.noise):
        best, description = plain, scored[0][1]
    near = [_score_all_rows(motion, one, about) for one, about in scored if best.evidence - one.evidence < _AS_LIKELY]
    intended = _score_all_rows(motion, best, description)
    required = finite_required_readings(description)
    return _Found(plain, intended, best_order(intended.misfit + required, required, motion.noise), tried, tuple(near))


def _score_all_rows(
    motion: MeasuredMotion, hypothesis: RecordingHypothesis, description: Description
) -> RecordingHypothesis:
    """Return a hypothesis that was chosen on some of the poses, for all of them."""
    required = finite_required_readings(description)
    return replace(
        hypothesis, description=description, misfit=hypothesis.readings(motion.readings, required) - required
    )


def _explains_enough(plain: RecordingHypothesis, best: RecordingHypothesis, noise: float) -> bool:
    """Return True if slips explain more than all physical effects of the catalogue, and at least halve the misfit."""
    if best.evidence - plain.evidence <= _CLEAR:
        return False
    before, after = _halved(plain.misfit, best.misfit, noise)
    required = finite_required_readings(best.description)
    left, moved = (_rms(values - values.mean(axis=0)) for values in (best.misfit, required))
    return before > _MOVED * noise and after <= _HALVES * before and left <= _APART * moved


def _halved(before: Array, after: Array, noise: float) -> tuple[float, float]:
    """Return the rms misfit, m, before and after slips are undone: about the mean of each leg if it is clear and
    halved, or else in total, as where lengths are wrong."""
    pairs = [(_rms(values - values.mean(axis=0)), _rms(values)) for values in (before, after)]
    about, without_mean = zip(*pairs, strict=True)
    return about if about[1] <= _HALVES * about[0] and about[0] > _MOVED * noise else without_mean


def _rivals(
    search: _Found, names: ReadingNames, motion: MeasuredMotion, slips: tuple[RecordSlip, ...]
) -> tuple[RecordSlip, ...]:
    """Return single slips that explain the data as well as the chosen ones."""
    if not search.intended.slips(names.columns, motion.readings):  # an order of rows alone: no description explains it
        return ()
    record_slips = [rival.slips(names.columns, motion.readings) for rival in search.rivals]
    return tuple(
        dict.fromkeys(
            slips_of_rival[0]
            for slips_of_rival in record_slips
            if len(slips_of_rival) == 1 and slips_of_rival[0] not in slips
        )
    )


def _reordered(hypothesis: RecordingHypothesis, order: RowOrder) -> Array:
    """Return the misfit with columns and rows in their right places."""
    required = finite_required_readings(hypothesis.description)
    is_placed = order.rows >= 0
    return np.asarray((hypothesis.misfit + required)[order.rows[is_placed]] - required[is_placed])


def _row_slips(order: RowOrder, names: ReadingNames) -> tuple[RecordSlip, ...]:
    """Return an order of rows as slips: all shifted, shifted from a pose on, reversed, or exchanged in cycles."""
    moved = order.moved
    if order.gain <= 0.0:
        return ()
    if order.shift:
        return (RecordSlip(SlipKind.ROWS_SHIFTED, "readings", (), shift=order.shift),)
    by = order.rows[moved] - moved
    steps, counts = np.unique(by, return_counts=True)
    if counts.max() >= _MOSTLY * len(moved) and len(moved) > 2:
        shift = int(steps[counts.argmax()])
        first, last = moved[by == shift][[0, -1]]
        ends = last + abs(shift) < len(order.rows) - 1
        where = f"from pose {names.poses[first]} {f'to pose {names.poses[last]}' if ends else 'on'}"
        return (RecordSlip(SlipKind.ROWS_SHIFTED, "readings", (where,), shift=shift),)
    if len(moved) > 2 and np.mean(order.rows[moved] + moved == len(order.rows) - 1) >= _MOSTLY:
        return (RecordSlip(SlipKind.ROWS_EXCHANGED, "readings", ("all rows, in reverse order",)),)
    rows = tuple(f"pose {names.poses[pose]} has the readings of {names.poses[order.rows[pose]]}" for pose in moved)
    return (RecordSlip(SlipKind.ROWS_EXCHANGED, "readings", rows),)


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
        if small.all() and (np.abs(wanted) > _MOVED * sigma).all():
            return RecordSlip(SlipKind.ZERO, "readings", offset=1e3 * float(np.median(wanted)))
    return None


def _frozen(motion: MeasuredMotion, required: Array, names: ReadingNames) -> tuple[RecordSlip, ...]:
    """Return columns that repeat one number over poses which require clearly different ones."""
    frozen_slips = []
    for leg, name in enumerate(names.columns):
        value = motion.readings[:, leg]
        ends = np.flatnonzero(np.diff(value) != 0.0)
        numbers = np.unique(value)
        least = max(2.0 * _MOVED * motion.noise, 1.5 * float(np.diff(numbers).min()) if len(numbers) > 1 else 0.0)
        for first, last in zip(np.r_[0, ends + 1], np.r_[ends + 1, len(value)], strict=True):
            wanted = required[first:last, leg]
            if last - first >= _FROZEN and np.ptp(np.nan_to_num(wanted)) > least:
                frozen_slips.append(
                    RecordSlip(SlipKind.FROZEN, "readings", (f"{name} from pose {names.poses[first]} on",))
                )
                break
    return tuple(frozen_slips)


def _hidden(motion: MeasuredMotion, plain: RecordingHypothesis, names: ReadingNames) -> tuple[RecordSlip, ...]:
    """Return exchanges of columns that these poses cannot show, because the legs move equally."""
    required = finite_required_readings(plain.description)
    travel = required - required.mean(axis=0)
    level = max(_rms(plain.misfit - plain.misfit.mean(axis=0)), motion.noise)
    needed = 2.0 * (_CLEAR + PENALTY) / len(required)
    squared_distance = np.mean((travel[:, :, None] - travel[:, None, :]) ** 2, axis=0)
    pairs = [(i, j) for i, j in np.argwhere(squared_distance < needed * level**2).tolist() if i < j]
    return tuple(
        RecordSlip(SlipKind.COLUMNS, "columns of readings", (names.columns[i], names.columns[j])) for i, j in pairs
    )
