"""Do measured points belong to the survey of their body, and are all poses measurements of their own?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from truing.belonging.partial_slips import rounding
from truing.belonging.points_in_poses import BodyPoints, slips_in_poses
from truing.belonging.relation import LENGTH_FACTORS, Slip, SlipKind, State, Tested, both_ways
from truing.estimation.rigid_poses.umeyama import umeyama

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SURVEY, COPIES = "points-against-survey", "copied-poses"
_POSES_TO_COMPARE = 2
_LEAST_TARGETS = 4  # three points are congruent to their mirror image
_FLAT = 0.02  # thickness over length, below which a body is its own mirror image
_MISFIT = 10.0  # sigmas of a point, from which a body does not fit its survey
_FIFTH = 0.2  # the share of the misfit that a slip may leave
_OTHER_BODY = 0.05  # of a body's size (rms from its middle): by as much no body deforms
_SCALE = 0.02  # relative, to a factor between units
_ALL_ROUNDED = 1.0  # rms misfit of points over the step of their numbers; rounding three coordinates makes half of it
_CHANCE = 1e-6  # probability that two measurements of one campaign agree in every digit


def relate_survey(body: BodyPoints) -> Tested:
    """Return whether a body's points are its survey, moved: not mirrored, and in the same unit."""
    usable = body.seen.sum(axis=1) >= _LEAST_TARGETS
    if not usable.any():
        return Tested(SURVEY, State.NOT_TESTED, "few-targets", body.name)
    points, weight = body.points[usable], body.seen[usable].astype(float)
    plain = umeyama(body.survey, points, weight)
    scaled = umeyama(body.survey, points, weight, with_scale=True)
    mirrored = umeyama(body.survey * [-1.0, 1.0, 1.0], points, weight)
    before = _typical(plain.rms)
    if not np.isfinite(before):
        return Tested(SURVEY, State.NOT_TESTED, "no-frame", body.name)
    tested = Tested(SURVEY, State.OK, "agrees", body.name, 1e3 * before, unit="mm", limit=1e3 * _MISFIT * body.sigma)
    if slips := slips_in_poses(body, _MISFIT * body.sigma)[0]:
        return replace(tested, state=State.FAILS, reason="slip", misfit=None, slips=slips, tried=2)
    if (step := rounding(points[body.seen[usable]], before, body.sigma)) is not None and before < _ALL_ROUNDED * step:
        slip = Slip(SlipKind.ROUNDED, "points of body", (body.name,), offset=1e3 * step)
        error, noise = 1e3 * step / np.sqrt(12.0), 1e3 * body.sigma
        rounded = replace(tested, state=State.ATTENTION, reason="rounded", misfit=float(error), limit=noise)
        return replace(rounded, slips=(slip,), tried=2)
    if before <= _MISFIT * body.sigma:
        mirrored_slip = (Slip(SlipKind.MIRRORED, "points or survey of body", (body.name,)),)
        return replace(tested, tried=2, hidden=mirrored_slip if _is_flat(body.survey) else ())
    trials = [(Slip(SlipKind.MIRRORED, "points or survey of body", (body.name,)), _typical(mirrored.rms))]
    if (factor := _unit(scaled.scale)) is not None:
        trials.append((Slip(SlipKind.UNIT, "points of body", (body.name,), factor), _typical(scaled.rms)))
    slip, after = min(trials, key=lambda trial: trial[1])
    if after > _FIFTH * before:
        size = float(np.sqrt(np.mean(np.sum((body.survey - body.survey.mean(axis=0)) ** 2, axis=1))))
        state = State.FAILS if before > _OTHER_BODY * size else State.ATTENTION
        return replace(tested, state=state, reason="no-fit", tried=2)
    return replace(tested, state=State.FAILS, reason="slip", slips=(slip,), misfit_explained=1e3 * after, tried=2)


def poses_with_slips(body: BodyPoints) -> Mask:
    """Return the poses (B,) whose points hold a slip that those of others do not."""
    return slips_in_poses(body, _MISFIT * body.sigma)[1]


def together(tested: tuple[Tested, ...]) -> Iterator[Tested]:
    """Yield one result for all bodies of the same state, reason and slip: that of the body that fits worst."""
    groups: dict[tuple[object, ...], list[Tested]] = {}
    for one in tested:
        alike = tuple((slip.kind, slip.quantity, slip.factor, slip.subjects[:-1]) for slip in one.slips)
        groups.setdefault((one.state, one.reason, alike), []).append(one)
    for group in groups.values():
        worst = max(group, key=lambda one: one.misfit or 0.0)
        names = tuple(one.subject for one in group)
        slips = tuple(replace(slip, subjects=(*slip.subjects[:-1], *names)) for slip in worst.slips)
        hidden = tuple(slip for one in group for slip in one.hidden)
        yield replace(worst, subject=" ".join(names), slips=slips, hidden=hidden, tried=sum(one.tried for one in group))


def _unit(scale: Array) -> float | None:
    """The factor between units that makes points of scales (B,) as large as their survey; None where none does."""
    if not np.isfinite(scale).any():
        return None
    factor, known = 1.0 / float(np.nanmedian(scale)), np.array(both_ways(LENGTH_FACTORS))
    nearest = float(known[np.argmin(np.abs(np.log(abs(factor) / known)))])
    return nearest if abs(np.log(abs(factor) / nearest)) < _SCALE else None


def _is_flat(survey: Array) -> bool:
    """Whether a body is, but for rounding, its own mirror image."""
    size = np.linalg.svd(survey - survey.mean(axis=0), compute_uv=False)
    return bool(size[-1] <= _FLAT * size[0])


def _typical(rms: Array) -> float:
    """The median over poses; infinite where no pose was fitted."""
    known = rms[np.isfinite(rms)]
    return float(np.median(known)) if len(known) else float("inf")


def relate_copies(points: Array, seen: Mask, sigma: float, poses: tuple[str, ...]) -> Tested:
    """Return whether poses are measurements of their own: no two agree in every digit of points (B, T, 3), m.

    Not tested where a single pose was measured, or the file's resolution is so coarse, against the noise sigma, that
    chance could do it.
    """
    groups: dict[bytes, list[int]] = {}
    measured = np.flatnonzero(seen.any(axis=1))
    if len(measured) < _POSES_TO_COMPARE:
        return Tested(COPIES, State.NOT_TESTED, "one-pose")
    for pose in measured:
        key = points[pose][seen[pose]].round(12).tobytes() + seen[pose].tobytes()
        groups.setdefault(key, []).append(int(pose))
    alike = [group for group in groups.values() if len(group) > 1]
    if not alike:
        return Tested(COPIES, State.OK, "distinct", misfit=0.0, limit=0.0, unit="1")
    coordinates = 3 * int(min(seen[group[0]].sum() for group in alike))
    chance = min(_resolution(points[seen]) / (2.0 * np.sqrt(np.pi) * max(sigma, 1e-300)), 1.0) ** coordinates
    if chance * len(points) ** 2 > _CHANCE:
        return Tested(COPIES, State.NOT_TESTED, "coarse")
    slips = tuple(Slip(SlipKind.COPIED, "points of poses", tuple(poses[pose] for pose in group)) for group in alike)
    return Tested(COPIES, State.FAILS, "slip", misfit=float(sum(map(len, alike))), limit=0.0, unit="1", slips=slips)


def _resolution(values: Array) -> float:
    """The smallest step, m, between different numbers of a file."""
    steps = np.diff(np.unique(values.round(12)))
    return float(steps.min()) if len(steps) else float("inf")
