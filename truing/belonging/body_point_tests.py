"""Tests of measured points against the survey or the common shape of their body."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.belonging.axes_changes import AXES_CHANGES
from truing.belonging.body_points import BodyPoints
from truing.belonging.relation import LENGTH_FACTORS, RecordSlip, RelationState, RelationTest, SlipKind, both_ways
from truing.belonging.slips_in_rows import rounding, row_places
from truing.belonging.target_names import NamedTargets, meant_order, renamed
from truing.belonging.target_rows import exchanged_names, frozen_targets, rows_of_wrong_target, slip_of_target
from truing.estimation.rigid_poses.rigid import RigidFit
from truing.estimation.rigid_poses.umeyama import umeyama, umeyama_misfit

_MOST_AFTER_SCALE = 0.5  # share of a mean square misfit that a scale may leave
_SIGMAS_OF_SCALE = 6.0  # standard deviations of the scale of a pose
_SIGMA_OF_MAD = 1.4826  # standard deviation over the median absolute deviation, for noise
_MOST_AFTER_SLIP = 0.2  # largest share of the misfit that may remain after a slip is undone
_MOST_IN_POSE = 0.5  # share of the misfit below which a pose is better with the slip undone
_COARSE = 0.02  # share of the misfit that remains after a unit is undone, by which coarse numbers do not fit
_AS_RIGHT = 5.0  # typical misfits up to which a pose is right as recorded
_AS_OTHERS = 3.0  # typical misfits of the other poses up to which a slip explains a pose
_SCALE = 0.02  # tolerance of the logarithm of a factor between units
_NEARER = 3.0  # factor by which one change of axes must bring points nearer to the other poses than the next best
_NEARLY = 1.5  # distance by one change of axes over that of the nearest, up to which it is as good
_WITHIN = 1.5  # largest distance of points with the right axes, over that of the other poses from their median
_MIRROR_TARGETS, _LEAST_TARGETS = 4, 3  # three points are congruent to their mirror image
_MOST_TARGETS = 40  # most targets of a body for the test of exchanged labels
SURVEY, POSES = "points-against-survey", "points-among-poses"
_FEWEST_COMPARED = 3  # poses: if two differ, either may be right
_FLAT = 0.02  # thickness over length, below which a body is its own mirror image
_MISFIT = 10.0  # sigmas of a point, from which a body does not fit its survey
_NO_MAJORITY = 0.3  # share of poses with a slip, from which the others may as well have it
_LARGEST_BEND = 0.1  # misfit over a body's size beyond which a pose is not right, however the others are
_OTHER_BODY = 0.05  # misfit over a body's size (rms from its middle) that no deformation explains
_ALL_ROUNDED = 1.0  # rms misfit of points over the step of their numbers; rounding of three coordinates gives 0.5


@dataclass(frozen=True)
class _Trial:
    """A slip that may explain poses (B,): kind, quantity, factor; misfit (B,), m, after it is undone, infinite where
    undefined."""

    kind: SlipKind
    quantity: str
    factor: float
    misfit: Array


def slips_in_poses(body: BodyPoints, limit: float) -> tuple[tuple[RecordSlip, ...], Mask]:
    """Return the slips in some poses of a body while the others are right, and the poses (B,) concerned.

    limit: largest misfit, m, of points that fit their survey. No slip where every pose, or none, is right as recorded,
    and none in poses with fewer than four targets.
    """
    most_seen = np.max(
        [
            seen_targets.sum(axis=1)
            for seen_targets in (body.is_observed, *(other.is_observed for other in body.others))
        ],
        axis=0,
    )
    usable = np.flatnonzero(most_seen >= _enough(most_seen))
    concerned = np.zeros(len(body.is_observed), bool)
    if not len(usable):
        return (), concerned
    subset = body.subset(usable)
    plain = _fitted(subset.survey, subset.points, subset.is_observed)
    mirrored = _fitted(subset.survey * [-1.0, 1.0, 1.0], subset.points, subset.is_observed)
    trials = [
        *_trials_in_other_units(subset),
        _Trial(SlipKind.MIRRORED, "points", 1.0, mirrored),
        *_trials_with_other_bodies(subset),
    ]
    exchanged = exchanged_names(subset.targets, subset.survey, subset.points, subset.is_observed, plain, limit)
    trials += [_Trial(SlipKind.PARTS_EXCHANGED, quantity, 1.0, misfit) for quantity, misfit in exchanged]
    after = np.stack([trial.misfit for trial in trials])
    best, least = after.argmin(axis=0), after.min(axis=0)
    is_better = (plain > limit) & (least < _MOST_AFTER_SLIP * plain)
    typical = float(np.median(np.where(is_better, least, plain)))
    right = ~is_better & (plain <= max(limit, min(_AS_RIGHT * typical, _LARGEST_BEND * _size(subset.survey))))
    is_unit = np.array([trial.kind is SlipKind.UNIT for trial in trials])[best]
    # a factor of a thousand shows in the size alone: numbers in metres may be coarse
    slipped = is_better & (is_unit & (least <= _COARSE * plain) | (least <= max(_AS_OTHERS * typical, limit)))
    if not right.any() or not slipped.any():
        return (), concerned
    named = tuple(_slips(subset, trials, np.where(slipped, best, -1), plain, right))
    concerned[usable] = np.any([slip.rows for slip in named], axis=0) if named else False
    return tuple(slip.slip for slip in named), concerned


@dataclass(frozen=True)
class _Named:
    """A slip and the poses (B,) that fit better after it is undone."""

    slip: RecordSlip
    rows: Mask


def _slips(body: BodyPoints, trials: Sequence[_Trial], which: Index, plain: Array, right: Mask) -> Iterator[_Named]:
    for number, trial in enumerate(trials):
        rows = which == number
        if not rows.any() or (trial.kind is SlipKind.MIRRORED and _labels_explain(body, rows, trial.misfit)):
            continue
        # a pose with a gross error fits neither way; it counts as slipped like its neighbours if it fits better then
        unexplained_rows = right | (trial.misfit > _MOST_IN_POSE * plain) | ((which >= 0) & ~rows)
        axes = _changed_axes(body, rows, right) if trial.kind is SlipKind.MIRRORED else np.full(len(rows), -1)
        for change in dict.fromkeys(axes[rows].tolist()):
            slip = (
                AXES_CHANGES[change].slip if change >= 0 else RecordSlip(trial.kind, trial.quantity, (), trial.factor)
            )
            rows_of_axis = rows & (axes == change)
            where = row_places(rows_of_axis, unexplained_rows | (rows & ~rows_of_axis), body.poses, body.groups)
            yield _Named(replace(slip, subjects=(*where, body.name)), rows_of_axis | (~unexplained_rows & ~rows))


def _enough(count: Index) -> int:
    """Return the number of targets that a pose needs, from those seen in each pose (B,): four, if most poses have them.

    Three targets fit their mirror image as well, so such poses would look right even if all poses were mirrored.
    """
    return (
        _MIRROR_TARGETS if 2 * np.sum(count >= _MIRROR_TARGETS) >= np.sum(count >= _LEAST_TARGETS) else _LEAST_TARGETS
    )


def _fitted(survey: Array, points: Array, is_observed: Mask) -> Array:
    """Return the misfit (B,), m, of points to their survey; infinite where fewer than four were seen."""
    rms, _ = umeyama_misfit(survey, points, is_observed.astype(float))
    return np.where(np.isfinite(rms) & (is_observed.sum(axis=1) >= _LEAST_TARGETS), rms, np.inf)


def _trials_in_other_units(body: BodyPoints) -> Iterator[_Trial]:
    rms, scale = umeyama_misfit(body.survey, body.points, body.is_observed.astype(float), with_scale=True)
    enough = np.isfinite(rms) & (body.is_observed.sum(axis=1) >= _LEAST_TARGETS)
    with np.errstate(invalid="ignore", divide="ignore"):
        for factor in both_ways(LENGTH_FACTORS):
            near = np.abs(np.log(scale * factor)) < _SCALE
            yield _Trial(SlipKind.UNIT, "points", factor, np.where(enough & near, factor * rms, np.inf))


def _trials_with_other_bodies(body: BodyPoints) -> Iterator[_Trial]:
    for other in body.others:
        quantity = f"points of body {other.name} in place of those of another body"
        yield _Trial(SlipKind.MISLABELLED, quantity, 1.0, _fitted(other.survey, other.points, other.is_observed))


def _labels_explain(body: BodyPoints, rows: Mask, mirrored: Array) -> bool:
    """Return True if two exchanged labels explain a pose as well as a mirror image does, as for symmetric bodies."""
    row = int(np.flatnonzero(rows)[0])
    seen = np.flatnonzero(body.is_observed[row])
    if len(seen) > _MOST_TARGETS:
        return False
    pairs = list(combinations(range(len(seen)), 2))
    order = np.tile(np.arange(len(seen)), (len(pairs), 1))
    for at, (first, other) in enumerate(pairs):
        order[at, [first, other]] = [other, first]
    rms, _ = umeyama_misfit(body.survey[seen][order], np.broadcast_to(body.points[row][seen], (*order.shape, 3)))
    return bool(np.nanmin(rms) <= _AS_OTHERS * mirrored[row])


def _changed_axes(body: BodyPoints, rows: Mask, right: Mask) -> Index:
    """Return the change (B,) that brings mirrored poses to the place of the right ones; -1 where none clearly does.
    None does where the instrument was moved."""
    axis_of_row = np.full(len(rows), -1)
    points = np.where(body.is_observed[:, :, None], body.points, np.nan)
    known = np.isfinite(points[right]).any(axis=(0, 2))
    middle = np.full(points.shape[1:], np.nan)
    middle[known] = np.nanmedian(points[right][:, known], axis=0)
    spread = _WITHIN * float(np.nanmax(_rms_distance(points[right], middle)))
    at = np.flatnonzero(rows)
    rms_distance = np.array([_rms_distance(points[at] @ change.matrix, middle) for change in AXES_CHANGES]).T
    first, second = np.sort(rms_distance, axis=1)[:, :2].T
    clear = (first <= spread) & (second > _NEARER * first)
    axis_of_row[at[clear]] = rms_distance[clear].argmin(axis=1)
    if clear.any():
        # The other poses have the same change, unless it brings them clearly less near than another one.
        most = int(np.bincount(axis_of_row[at[clear]]).argmax())
        axis_of_row[at[~clear & (rms_distance[:, most] <= _NEARLY * first)]] = most
    return axis_of_row


def _rms_distance(points: Array, middle: Array) -> Array:
    """Return the root mean square distance (B,) of points (B, T, 3) from their median places."""
    square = np.sum((points - middle) ** 2, axis=2)
    known = np.isfinite(square)
    return np.asarray(np.sqrt(np.where(known, square, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)))


def relate_survey(body: BodyPoints) -> RelationTest:
    """Return the test of a body's points against its survey: not mirrored, and in the same unit."""
    count = body.is_observed.sum(axis=1)
    usable = count >= _enough(count)
    if not usable.any():
        return RelationTest(SURVEY, RelationState.NOT_TESTED, "few-targets", body.name)
    points, weight = body.points[usable], body.is_observed[usable].astype(float)
    scaled = umeyama(body.survey, points, weight, with_scale=True)
    mirrored = umeyama(body.survey * [-1.0, 1.0, 1.0], points, weight)
    before = _typical(umeyama_misfit(body.survey, points, weight)[0])
    if not np.isfinite(before):
        return RelationTest(SURVEY, RelationState.NOT_TESTED, "no-frame", body.name)
    tested = RelationTest(
        SURVEY, RelationState.OK, "agrees", body.name, 1e3 * before, unit="mm", limit=1e3 * _MISFIT * body.sigma
    )
    if slips := _slips_of_some(body, _MISFIT * body.sigma, is_surveyed=True):
        return replace(tested, state=RelationState.FAILS, reason="slip", misfit=None, slips=slips, tried=2)
    declared = body.sigma / body.noise_factor
    if (
        step := rounding(points[body.is_observed[usable]], before, declared)
    ) is not None and before < _ALL_ROUNDED * step:
        slip = RecordSlip(SlipKind.ROUNDED, "points of body", (body.name,), offset=1e3 * step)
        error, noise = 1e3 * step / np.sqrt(12.0), 1e3 * declared
        rounded = replace(tested, state=RelationState.ATTENTION, reason="rounded", misfit=float(error), limit=noise)
        return replace(rounded, slips=(slip,), tried=2)
    if before <= _MISFIT * body.sigma and _explains_most(scaled.rms, before, scaled.scale):
        return _test_other_scale(tested, body, scaled)
    if before <= _MISFIT * body.sigma:
        mirrored_slip = (RecordSlip(SlipKind.MIRRORED, "points or survey of body", (body.name,)),)
        return replace(tested, tried=2, hidden=mirrored_slip if is_flat(body.survey) else ())
    return _explain_misfit(tested, body, before, scaled, mirrored)


def _explain_misfit(
    tested: RelationTest, body: BodyPoints, before: float, scaled: RigidFit, mirrored: RigidFit
) -> RelationTest:
    """Return the failed test of a body with misfit ``before``, m, and the slip that explains it best, if any does."""
    trials = [(RecordSlip(SlipKind.MIRRORED, "points or survey of body", (body.name,)), _typical(mirrored.rms))]
    if (factor := _unit(scaled.scale)) is not None:
        trials.append((RecordSlip(SlipKind.UNIT, "points of body", (body.name,), factor), _typical(scaled.rms)))
    slip, after = min(trials, key=lambda trial: trial[1])
    if after > _MOST_AFTER_SLIP * before and _typical(scaled.rms) <= _MOST_AFTER_SLIP * before:
        return _test_other_scale(tested, body, scaled)
    if (
        after > _MOST_AFTER_SLIP * before
        and body.named is not None
        and (other_names := _under_other_names(body.named)) is not None
    ):
        order, renamed_misfit = other_names
        if renamed_misfit <= _MOST_AFTER_SLIP * before:
            slip = RecordSlip(SlipKind.RELABELLED, "targets", (*renamed(body.named, order), body.name))
            named = replace(tested, state=RelationState.FAILS, reason="slip", slips=(slip,), tried=3)
            return replace(named, misfit_explained=1e3 * renamed_misfit)
    if after > _MOST_AFTER_SLIP * before:
        state = RelationState.FAILS if before > _OTHER_BODY * _size(body.survey) else RelationState.ATTENTION
        return replace(tested, state=state, reason="no-fit", tried=2)
    return replace(
        tested, state=RelationState.FAILS, reason="slip", slips=(slip,), misfit_explained=1e3 * after, tried=2
    )


def _test_other_scale(tested: RelationTest, body: BodyPoints, scaled: RigidFit) -> RelationTest:
    """Return the test with the scale of the survey over that of the points as its explanation."""
    slip = RecordSlip(SlipKind.SCALE, "points of body", (body.name,), 1.0 / float(np.nanmedian(scaled.scale)))
    as_large = replace(tested, state=RelationState.ATTENTION, reason="scale", tried=3)
    return replace(as_large, slips=(slip,), misfit_explained=1e3 * _typical(scaled.rms))


def _explains_most(after: Array, before: float, scales: Array) -> bool:
    """Return True if equal scales in all poses (B,) explain most of a mean square misfit."""
    known = scales[np.isfinite(scales)]
    if len(known) < _FEWEST_COMPARED or _typical(after) ** 2 > _MOST_AFTER_SCALE * before**2:
        return False
    middle = float(np.median(known))
    spread = _SIGMA_OF_MAD * float(np.median(np.abs(known - middle)))
    return abs(middle - 1.0) > _SIGMAS_OF_SCALE * spread


def relate_poses(body: BodyPoints) -> RelationTest:
    """Return the test of the points of a body without a survey: does one shape, that of most poses (``survey``), fit
    all poses? A slip in all poses changes this shape as well, and stays hidden."""
    count = body.is_observed.sum(axis=1)
    usable = count >= _enough(count)
    if usable.sum() < _FEWEST_COMPARED:
        reason = "few-poses" if usable.any() else "few-targets"
        return RelationTest(POSES, RelationState.NOT_TESTED, reason, body.name)
    before, limit = _typical(_fitted(body.survey, body.points, body.is_observed)[usable]), _MISFIT * body.sigma
    tested = RelationTest(POSES, RelationState.OK, "agrees", body.name, 1e3 * before, unit="mm", limit=1e3 * limit)
    # A slip scatters all points alike where the shape comes from both sorts of poses: the declared noise shows it.
    if slips := _slips_of_some(body, limit / body.noise_factor, is_surveyed=False):
        rivals = _slips_of_the_others(body, slips, poses_with_slips(body))
        if rivals and slips[0].kind is SlipKind.UNIT and slips[0].factor < 1.0:  # most units are larger than mm
            slips, rivals = rivals, slips
        failed = replace(tested, state=RelationState.FAILS, reason="slip", misfit=None, tried=4)
        return replace(failed, slips=slips, rivals=rivals)
    if before > limit:
        return replace(tested, state=RelationState.ATTENTION, reason="no-shape", tried=4)
    alike = (
        RecordSlip(SlipKind.UNIT, "all points of body", (body.name,)),
        RecordSlip(SlipKind.MIRRORED, "all points of body", (body.name,)),
    )
    return replace(tested, tried=4, hidden=alike)


def _slips_of_the_others(body: BodyPoints, slips: tuple[RecordSlip, ...], concerned: Mask) -> tuple[RecordSlip, ...]:
    """Return the same slip in all other poses: without a survey it is unknown which poses are right, unless most of
    them agree."""
    if len(slips) != 1 or concerned.mean() < _NO_MAJORITY:
        return ()
    where = row_places(~concerned, concerned, body.poses, body.groups)
    return (replace(slips[0], factor=1.0 / slips[0].factor, subjects=(*where, body.name)),)


def _slips_of_some(body: BodyPoints, limit: float, *, is_surveyed: bool) -> tuple[RecordSlip, ...]:
    """Return the slips in some poses of a body, or in the rows of one of its targets."""
    if slips := slips_in_poses(body, limit)[0]:
        return slips
    if frozen := tuple(frozen_targets(body.targets, body.points, body.is_observed, limit / _MISFIT, body.poses)):
        return tuple(replace(slip, subjects=(*slip.subjects, body.name)) for slip in frozen)
    rows = rows_of_wrong_target(body, limit, is_surveyed=is_surveyed)
    slip = None if rows is None else slip_of_target(rows)
    return () if slip is None else (replace(slip, subjects=(*slip.subjects, body.name)),)


def _size(survey: Array) -> float:
    """Return the root mean square distance, m, of points (T, 3) from their middle."""
    return float(np.sqrt(np.mean(np.sum((survey - survey.mean(axis=0)) ** 2, axis=1))))


def _under_other_names(targets: NamedTargets) -> tuple[Index, float] | None:
    """Return the order of a body's targets in which its points fit the survey best, and their misfit, m."""
    if (order := meant_order(targets)) is None:
        return None
    return order, _typical(umeyama_misfit(targets.survey[order], targets.points, targets.is_observed.astype(float))[0])


def poses_with_slips(body: BodyPoints) -> Mask:
    """Return True for poses (B,) whose points hold a slip that the others do not."""
    return slips_in_poses(body, _MISFIT * body.sigma / body.noise_factor)[1]


def shifted_survey(
    survey: Array, names: Sequence[tuple[str, str]], bodies: Sequence[BodyPoints]
) -> RelationTest | None:
    """Return the test of all bodies with the rows of the survey (N, 3), m, shifted, if this explains every body.

    ``names``: body and target of each row of the survey.
    """
    for shift in (1, -1, 2, -2):
        points = dict(zip(names, np.roll(survey, -shift, axis=0), strict=True))
        before, after = [], []
        for body in bodies:
            weight = body.is_observed.astype(float)
            moved = np.array([points[body.name, target] for target in body.targets])
            before.append(_typical(umeyama_misfit(body.survey, body.points, weight)[0]))
            after.append(_typical(umeyama_misfit(moved, body.points, weight)[0]))
        if np.all(np.array(after) <= _MOST_AFTER_SLIP * np.array(before)):
            slip = RecordSlip(SlipKind.ROWS_SHIFTED, "places of the survey", shift=shift)
            tested = RelationTest(SURVEY, RelationState.FAILS, "slip", misfit=1e3 * max(before), unit="mm", tried=4)
            return replace(tested, slips=(slip,), misfit_explained=1e3 * max(after))
    return None


def joined_results(tested: tuple[RelationTest, ...]) -> Iterator[RelationTest]:
    """Yield one result for all bodies of the same state, reason and slip: that of the body that fits worst."""
    groups: dict[tuple[object, ...], list[RelationTest]] = {}
    for test in tested:
        alike = tuple(
            (slip.kind, slip.quantity, slip.kind is SlipKind.SCALE or slip.factor, slip.subjects[:-1])
            for slip in test.slips
        )
        groups.setdefault((test.state, test.reason, alike), []).append(test)
    for group in groups.values():
        worst = max(group, key=lambda one: one.misfit or 0.0)
        names = tuple(member.subject for member in group)
        slips = tuple(replace(slip, subjects=(*slip.subjects[:-1], *names)) for slip in worst.slips)
        hidden = tuple(slip for member in group for slip in member.hidden)
        yield replace(
            worst, subject=" ".join(names), slips=slips, hidden=hidden, tried=sum(member.tried for member in group)
        )


def _unit(scale: Array) -> float | None:
    """Return the factor between units that gives points of scales (B,) the size of their survey; None
    where none does."""
    if not np.isfinite(scale).any():
        return None
    factor, known = 1.0 / float(np.nanmedian(scale)), np.array(both_ways(LENGTH_FACTORS))
    nearest = float(known[np.argmin(np.abs(np.log(abs(factor) / known)))])
    return nearest if abs(np.log(abs(factor) / nearest)) < _SCALE else None


def is_flat(survey: Array) -> bool:
    """Return True if a body is its own mirror image within rounding."""
    size = np.linalg.svd(survey - survey.mean(axis=0), compute_uv=False)
    return bool(size[-1] <= _FLAT * size[0])


def _typical(rms: Array) -> float:
    """Return the median over poses; infinite where no pose was fitted."""
    known = rms[np.isfinite(rms)]
    return float(np.median(known)) if len(known) else float("inf")
