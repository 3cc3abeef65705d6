"""Quality of the noise: is it what was declared, in every body, axis and pose?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from truing.estimation.quality import (
    Scatter,
    unexplained_scatter,
)
from truing.estimation.rigid_poses.frame import redundancy
from truing.quality.bodies import BodyView, Surroundings
from truing.report.numbers import count as counted
from truing.stages.quality.check import FAIL, PASS, WARN, Check, without
from truing.stages.quality.unit_slips import unit_slip

_NOISE_TOLERATED = 1.5  # beyond this multiple of the declared noise the declaration is unusable
_AXIS_NOISE_TOLERATED = 2.5  # photogrammetry is worse in depth, and one declared number stands for all axes
_NOISE_NOTED = 1.1
_POSE_NOISE_TOLERATED = 3.0
_ODD_POSE = 1e-6
_ODD_POSES_FAIL = 0.1


def noise(body: BodyView, around: Surroundings, share: float) -> Iterator[Check]:
    """Estimated against declared noise per axis, of what follows neither drives, time nor temperature."""
    good = body.good & body.frame & ~_odd_poses(_scatter_by_pose(body))[:, None]
    if good.sum() < 12:
        yield without(f"noise of {body.name}", "noise", body.name, "too few readings")
        return
    part = redundancy(body.survey.points[body.frame], good[:, body.frame])
    scatter = unexplained_scatter(
        body.residuals[:, body.frame], body.measured_sigma[:, body.frame], part, around.covariates
    )
    whole = _pooled(scatter)
    if whole.dof[0] < 1.0:
        why = "a single pose without a survey leaves no residual"
        yield without(f"noise of {body.name}", "noise", body.name, why)
        return
    declared = 1e3 * float(np.median(body.measured_sigma[good]))
    first = _noise_check(body.name, "", whole, _NOISE_TOLERATED, share / 2, around.shared)
    slip = unit_slip(float(whole.ratio[0]), declared, "mm")
    is_warned = slip and first.verdict == PASS
    yield replace(first, message=first.message + slip, verdict=WARN if is_warned else first.verdict)
    for k, axis in enumerate("xyz"):
        one = Scatter(scatter.chi_square[k : k + 1], scatter.dof[k : k + 1])
        yield _noise_check(body.name, axis, one, _AXIS_NOISE_TOLERATED, share / 6, around.shared)


def _pooled(scatter: Scatter) -> Scatter:
    return Scatter(scatter.chi_square.sum(keepdims=True), scatter.dof.sum(keepdims=True))


def _noise_check(body: str, axis: str, scatter: Scatter, tolerated: float, share: float, shared: bool) -> Check:
    ratio = float(scatter.ratio[0])
    failing = scatter.p_above(tolerated)[0] < share
    # What all points of a pose share of their errors moves or scales them together: the declared is more than scatters.
    below = not shared and scatter.p_below(1.0 / _NOISE_NOTED)[0] < share
    noted = below or scatter.p_above(_NOISE_NOTED)[0] < share
    where = f"the scatter along {axis}" if axis else "the scatter"
    noise = "standard deviations, errors that points share among them" if shared else "declared noise"
    sentence = (
        f"{body}: {where} is {ratio:.2f} times the {noise} ({counted(round(scatter.dof[0]), 'degree')} of freedom)."
    )
    verdict = FAIL if failing else WARN if noted else PASS
    return Check("noise", f"{body} {axis}".strip(), ratio, tolerated, "1", verdict, sentence)


def noise_by_pose(body: BodyView, around: Surroundings, share: float) -> Iterator[Check]:
    """Poses whose residuals are larger than the body's own scatter: one is a pose to look at, many are no campaign."""
    scatter = _scatter_by_pose(body)
    judged = scatter.dof > 0.0
    if judged.sum() < 3:
        yield without(f"noise by pose of {body.name}", "noise-by-pose", body.name, "too few targets per pose")
        return
    odd = _odd_poses(scatter)
    much = scatter.p_above(_POSE_NOISE_TOLERATED) < share / judged.sum()
    worst = int(np.argmax(np.where(judged, np.nan_to_num(scatter.ratio), -1.0)))
    failing = much.sum() > _ODD_POSES_FAIL * judged.sum()
    yield Check(
        "noise-by-pose",
        f"{body.name} pose {around.poses[worst]}",
        float(scatter.ratio[worst]),
        _POSE_NOISE_TOLERATED,
        "1",
        FAIL if failing else WARN if odd.any() else PASS,
        f"{body.name}: the noisiest pose is {around.poses[worst]}, {scatter.ratio[worst]:.2f} times the ordinary "
        f"scatter; {int(odd.sum())} of {int(judged.sum())} poses stand out.",
    )


def _scatter_by_pose(body: BodyView) -> Scatter:
    """Chi-square of each pose's residuals in units of the body's ordinary scatter, the median over its poses."""
    good = body.good & body.frame
    dof = np.maximum(3.0 * good.sum(axis=1) - 6.0, 0.0)
    square = np.where(good[..., None], (body.residuals / body.sigma) ** 2, 0.0).sum(axis=(1, 2))
    judged = dof > 0.0
    level = max(1.0, float(np.median(square[judged] / dof[judged]))) if judged.any() else 1.0
    return Scatter(np.where(judged, square / level, 0.0), dof)


def _odd_poses(scatter: Scatter) -> NDArray[np.bool_]:
    """Poses that chance makes as noisy once in a million: a gross error that its few neighbours hid, most often."""
    return (scatter.p_above(1.0) < _ODD_POSE) & (np.nan_to_num(scatter.ratio) > 1.5)
