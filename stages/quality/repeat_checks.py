"""Quality of repeats: do poses and single reflectors come out again as their uncertainty says, group by group?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.quality import Scatter
from truing.estimation.repeatability import at_one_reading, equal_scatter
from truing.quality.bodies import BodyView, Surroundings
from truing.report.numbers import count as counted
from truing.stages.common.repeats import DECLARED
from truing.stages.quality.check import FAIL, PASS, WARN, Check, without

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
_NOTED, _TOLERATED = 1.5, 3.0  # times what is stated
_UNEQUAL = 1e-3
_FRAME = 3  # targets that make a pose


@dataclass(frozen=True)
class _Repeated:
    """What is seen again: its name, positions (B, 3) with covariances (B, 3, 3) in m, and where they are known (B,)."""

    name: str
    position: Array
    cov: Array
    known: Mask


def repeatability(
    bodies: Sequence[BodyView],
    around: Surroundings,
    groups: Sequence[Index],
    how: str,
    share: float,
    *,
    instrument_stood: bool = False,
) -> Iterator[Check]:
    """Poses that repeat one another, groups of their numbers: their scatter against their stated uncertainty.

    ``instrument_stood``: bodies need no other body to be seen from.
    """
    if not groups:
        why = "no configuration was measured twice; measure three of them again at the end"
        yield without("repeatability", "repeatability", "", why)
        return
    seen = list(_seen_again(bodies, instrument_stood=instrument_stood))
    if not seen:
        why = "no body is seen from another; give the body that stands still three targets"
        yield without("repeatability", "repeatability", "", why)
    for one in seen:
        position = one.position
        if how == DECLARED:
            position = at_one_reading(np.where(one.known[:, None], position, np.nan), around.settings, groups)
        parts = [part for group in groups if len(part := group[one.known[group]]) > 1]
        squares = np.array([_spread(position[part], one.cov[part]) for part in parts])
        names = [str(around.poses[int(part[0])]) for part in parts]
        freedom = np.array([3.0 * (len(part) - 1) for part in parts])
        yield _check(one.name, Scatter(squares, freedom), names, how, share / len(seen))


def _seen_again(bodies: Sequence[BodyView], *, instrument_stood: bool) -> Iterator[_Repeated]:
    """Bodies seen from the first, and each target of bodies that have too few for a pose; legs move by themselves.

    Where no body has a pose, or the instrument stood still, they are seen from the instrument: single reflectors alone
    mean nothing in a frame that changes from pose to pose.
    """
    reference = bodies[0] if len(bodies[0].survey.targets) >= _FRAME and not instrument_stood else None
    for body in bodies:
        if body is reference or body.name.startswith("leg"):
            continue
        if len(body.survey.targets) < _FRAME:
            yield from _reflectors(reference, body)
        elif reference is not None:
            yield _Repeated(body.name, *_relative_position(reference, body), reference.fit.ok & body.fit.ok)
        elif instrument_stood:
            cov = np.nan_to_num(_measured_cov(body)[:, :3, :3])
            yield _Repeated(body.name, np.nan_to_num(body.fit.t), cov, body.fit.ok)


def _reflectors(reference: BodyView | None, body: BodyView) -> Iterator[_Repeated]:
    for k, target in enumerate(body.survey.targets):
        points, cov, known = body.points.points[:, k], body.points.cov[:, k], body.points.seen[:, k]
        if reference is not None:
            points, cov = _in_frame(reference, points, cov)
            known = known & reference.fit.ok
        yield _Repeated(f"{body.name} {target}", points, cov, known)


def _check(name: str, scatter: Scatter, poses: Sequence[str], how: str, share: float) -> Check:
    """The verdict of one subject, of all groups together and of each: groups that differ are never told as one."""
    count = len(poses)
    if not count:
        why = f"no repeat of {name} was seen twice in a way that tells its place; measure three poses twice"
        return without("repeatability", "repeatability", name, why)
    pooled = Scatter(scatter.chi_square.sum(keepdims=True), scatter.dof.sum(keepdims=True))
    verdicts = [
        (pooled.p_above(times)[0] < 0.5 * share or bool((scatter.p_above(times) < 0.5 * share / count).any()))
        for times in (_NOTED, _TOLERATED)
    ]
    verdict = FAIL if verdicts[1] else WARN if verdicts[0] else PASS
    ratio, repeats = float(pooled.ratio[0]), int(pooled.dof[0] / 3)
    apart = equal_scatter(scatter.chi_square, scatter.dof)
    said = f"{name}: repeated poses scatter {ratio:.2f} times as much as their noise says "
    if apart is not None and apart.p_value < _UNEQUAL:
        ratio = float(scatter.ratio[apart.worst])
        verdict = WARN if verdict == PASS else verdict
        said = f"{name}: repeats of pose {poses[apart.worst]} scatter {ratio:.2f} times as much as their noise says, "
        said += f"those of all others {apart.others:.2f} times: no one number holds for all "
    said += f"({counted(repeats, 'repeat')} of {counted(count, 'pose')}, known by {how})."
    return Check("repeatability", name, ratio, _TOLERATED, "1", verdict, said)


def _relative_position(reference: BodyView, body: BodyView) -> tuple[Array, Array]:
    """(B, 3) position of the body from the reference body, and its covariance to first order."""
    return _in_frame(reference, body.fit.t, _measured_cov(body)[:, :3, :3])


def _measured_cov(body: BodyView) -> Array:
    """Covariances (B, 6, 6) of a body's poses by the measurement alone: the survey's errors are the same each time."""
    used = body.good & body.frame
    measured, both = (
        np.where(used[..., None], sigma**2, 0.0).sum(axis=(1, 2)) for sigma in (body.measured_sigma, body.sigma)
    )
    share = np.divide(measured, both, out=np.ones_like(both), where=both > 0.0)
    return np.asarray(body.fit.covariance * share[:, None, None])


def _in_frame(reference: BodyView, points: Array, cov: Array) -> tuple[Array, Array]:
    """Points (B, 3) with covariances (B, 3, 3) in the frame of a body, its own covariance added to first order."""
    turn = np.swapaxes(np.nan_to_num(reference.fit.R), 1, 2)
    offset = np.nan_to_num(points - reference.fit.t)
    arm = np.cross(np.eye(3)[None], offset[:, None])
    jacobian = np.concatenate([-np.broadcast_to(np.eye(3), arm.shape), arm], axis=2)
    cov = np.nan_to_num(cov)
    cov = cov + np.einsum("bij,bjk,blk->bil", jacobian, np.nan_to_num(_measured_cov(reference)), jacobian)
    return np.einsum("bij,bj->bi", turn, offset), np.einsum("bij,bjk,blk->bil", turn, cov, turn)


def _spread(values: Array, cov: Array) -> float:
    """Chi-square of a group's values (G, 3) about their weighted mean."""
    weight = np.linalg.inv(cov)
    mean = np.linalg.solve(weight.sum(axis=0), np.einsum("gij,gj->i", weight, values))
    return float(np.einsum("gi,gij,gj->", values - mean, weight, values - mean))
