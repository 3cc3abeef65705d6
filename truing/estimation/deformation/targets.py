"""Shifts of targets in their bodies, and their models by the drives of a campaign."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.estimation.response import ResponseFit, fit_models, keep_consistent
from truing.estimation.rigid_poses.frame import residual_covariance
from truing.estimation.rigid_poses.points import PosePoints

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BodyShifts:
    """One body: poses, targets, residuals (B, T, 3) in m in its own frame, NaN where not seen, and their covariance."""

    body: str
    poses: tuple[int | str, ...]
    targets: tuple[str, ...]
    shift: Array
    noise: Array

    @property
    def flat(self) -> Array:
        """(B, 3T) target by target, x y z."""
        return self.shift.reshape(len(self.shift), -1)


def body_shifts(body: str, observed: PosePoints, shift: Array, used: NDArray[np.bool_], rotation: Array) -> BodyShifts:
    """Return a body's shifts (B, T, 3) with the covariance that its points and its frame give them, one by one.

    used (B, T): targets that made the frame; rotation (B, 3, 3) from the body to the measurement.
    """
    noise = np.einsum("bji,btjk,bkl->btil", rotation, observed.cov, rotation)
    seen = np.isfinite(shift[:, :, 2])
    place = _mean_shape(observed.points, observed.seen & seen, rotation, shift)
    return BodyShifts(
        body, observed.poses, observed.targets, shift, residual_covariance(place, noise, used & seen, seen)
    )


def with_common_errors(
    found: BodyShifts, every: tuple[int | str, ...], noise: Array, there: NDArray[np.bool_]
) -> BodyShifts:
    """The shifts with the covariance of points that have errors in common, in poses where bodies had a joint fit."""
    rows = np.array([every.index(pose) for pose in found.poses])
    return replace(found, noise=np.where(there[rows, None, None], noise[rows], found.noise))


def _mean_shape(points: Array, seen: NDArray[np.bool_], rotation: Array, shift: Array) -> Array:
    """(T, 3) targets in the body's axes, up to a common shift: enough for how a frame's error reaches them."""
    weight = seen.astype(float)
    local = np.einsum("bji,btj->bti", rotation, points) - np.nan_to_num(shift)
    centre = (local * weight[..., None]).sum(axis=1) / np.maximum(weight.sum(axis=1), 1.0)[:, None]
    centred = (local - centre[:, None]) * weight[..., None]
    whole = weight.min(axis=1) > 0.0
    chosen = whole if whole.any() else np.ones(len(whole), bool)
    return centred[chosen].sum(axis=0) / np.maximum(weight[chosen].sum(axis=0), 1.0)[:, None]


def target_models(found: BodyShifts, u: Array, fitted: NDArray[np.bool_]) -> dict[str, ResponseFit]:
    """Return the models of a body's shifts by drives u (B, D), none and matrix, over the poses fitted (B,)."""
    y, cov = found.flat[fitted], found.noise[fitted]
    kept = keep_consistent(u[fitted], y, cov)
    return fit_models(u[fitted], np.where(kept, y, np.nan), cov, ("none", "matrix"))
