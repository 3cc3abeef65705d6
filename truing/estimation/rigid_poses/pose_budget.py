"""What the points of a body, its survey, and their scatter beyond what was declared give to its poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.estimation.covariance import survey_frame_covariance
from truing.estimation.rigid_poses.points import PosePoints, SurveyPoints
from truing.estimation.uncertainty_budget import Source

Array = NDArray[np.float64]
_BY_CHANCE = 0.01  # a scatter that declared noise would exceed so often is not called larger


def _frame(survey: SurveyPoints) -> NDArray[np.bool_]:
    """(T,) which targets make the body's frame: those away from the legs, or all where these are too few."""
    away = survey.leg == 0
    return away if away.sum() >= 3 or away.all() else np.ones_like(away)


def _scatter(residual: Array, used: NDArray[np.bool_], R: Array, points: PosePoints) -> tuple[float, float]:
    """How much residuals scatter about their targets' means, over the declared noise of the points, and its freedom;
    1 where it is no larger than chance makes it.

    The error of the survey is the same in all poses, and goes with the means.
    """
    from scipy.special import chdtrc

    kept = used & np.isfinite(residual).all(-1)
    count = kept.sum(0)
    mean = np.where(kept[..., None], residual, 0.0).sum(0) / np.maximum(count, 1)[:, None]
    apart = np.einsum("bij,bnj->bni", R, np.where(kept[..., None], residual - mean, 0.0))
    cov = np.where(kept[..., None, None], points.cov, np.eye(3))
    squares = float(np.einsum("bni,bni->", apart, np.linalg.solve(cov, apart[..., None])[..., 0]))
    poses = int(kept.any(1).sum())
    dof = float(3 * kept.sum() - 6 * poses - max(3 * int((count > 0).sum()) - 6, 0))
    if dof <= 0 or chdtrc(dof, squares) > _BY_CHANCE:
        return 1.0, max(dof, 0.0)
    return float(np.sqrt(squares / dof)), dof


def body_parts(
    name: str, survey: SurveyPoints, points: PosePoints, R: Array, used: NDArray[np.bool_], residual: Array
) -> dict[Source, Array] | None:
    """Return covariances (B, 6, 6) of a body's poses by its points, its survey, and the scatter beyond them.

    R (B, 3, 3) from the body to the measurement, NaN where it was not found; used (B, T); residual (B, T, 3), m, in the
    body's axes. None where no point was used, or the noise of one is not declared.
    """
    ok: NDArray[np.bool_] = np.asarray(np.isfinite(R).all((1, 2)))
    used = used & ok[:, None]
    declared = np.trace(points.cov, axis1=-2, axis2=-1) > 0.0
    if not used.any() or not declared[used].all() or not np.isfinite(points.cov[used]).all():
        return None
    turn, source_cov = np.where(ok[:, None, None], R, np.eye(3)), np.nan_to_num(survey.cov)
    target_cov = np.where(used[..., None, None], points.cov, np.eye(3))
    turned = turn[:, None] @ source_cov @ np.swapaxes(turn, 1, 2)[:, None]
    noise = target_cov + np.where(used[..., None, None], turned, 0.0)
    W = used[..., None, None] * np.linalg.inv(noise)
    frame = _frame(survey)
    none = np.zeros_like(source_cov), np.zeros_like(target_cov)
    by_points = survey_frame_covariance(turn, survey.points, W, none[0], target_cov, frame, ok)
    by_survey = survey_frame_covariance(turn, survey.points, W, source_cov, none[1], frame, ok)
    parts = {
        Source(f"points of {name}, as declared", "B"): by_points,
        Source(f"survey of {name}, as declared", "B"): by_survey,
    }
    ratio, dof = _scatter(residual, used, turn, points)
    if ratio > 1.0:
        parts[Source(f"scatter of the points of {name} beyond that", "A", dof)] = (ratio**2 - 1.0) * by_points
    return parts
