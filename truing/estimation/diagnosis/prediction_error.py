"""What a model of points gets wrong when it predicts from readings alone, and what pure noise would leave there.

Removed from measured minus predicted are only one motion per pose common to all bodies, and local unknowns that the
model does not claim to predict (the roll of a leg about its own axis).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.estimation.diagnosis.point_fit import Frames, MeasuredPoints, Model, PointFit, linearise
from truing.estimation.diagnosis.whitening import Whitened

# Newton on frames and rolls: after two rounds from a pose's own fit, nothing is left to gain.
_ROUNDS = 2
_FLOOR_DRAWS = 24
# A cause is rejected where held-out poses are predicted worse, by so much that chance does it this rarely; how much
# chance does is known from the noise as well as from so many poses.
_WORSE, _POSES_OF_NOISE = 0.006, 10


_BY_POSE = ("gap", "whitened", "local", "by_shared", "by_fitted")


@dataclass(frozen=True)
class PredictionError:
    """Measured minus predicted points (B, K, 3), in m in the measurement's axes, zero where unseen.

    ``frames``, ``local`` (B, H) and the derivatives by the shared unknowns (B, M, G) and by what is fitted to each pose
    (B, M, h) are those at the prediction, whitened; ``model`` predicted, with ``shared`` unknowns (G,).
    """

    gap: NDArray
    measured: MeasuredPoints
    whitened: NDArray  # (B, K, 3) the same in units of the noise
    frames: Frames
    local: NDArray
    by_shared: NDArray
    by_fitted: NDArray
    model: Any
    shared: NDArray

    @cached_property
    def channels(self) -> Mapping[str, NDArray]:
        """Return how the points (B, K, 3, C), m, follow each channel at the prediction."""
        return self.model.channels(self.shared, self.local)  # type: ignore[no-any-return]

    @cached_property
    def designer(self) -> Callable[[Any], Mapping[str, NDArray]]:
        """Return what tells a cause's change of each channel at the prediction."""
        return self.model.designer(self.shared, self.local)  # type: ignore[no-any-return]

    @property
    def seen(self) -> NDArray:
        """Return which points (B, K) were measured."""
        return self.measured.seen

    def less(self, columns: NDArray) -> PredictionError:
        """Return the error where the prediction moves by columns (B, M), whitened, and each pose is fitted anew."""
        left = self.whitened.reshape(columns.shape) - columns
        left = left - np.einsum("bmh,bh->bm", self.by_fitted, _fit(self.by_fitted, left[..., None])[..., 0])
        return replace(self, gap=_unwhitened(self.measured, left), whitened=left.reshape(self.whitened.shape))

    @property
    def squares(self) -> NDArray:
        """Return the whitened sum of squares of each pose (B,)."""
        return np.sum(self.whitened**2, (1, 2))

    @property
    def rms_by_pose(self) -> NDArray:
        """Return the root mean square per coordinate of each pose (B,) in m, zero where nothing was seen."""
        return np.asarray(np.sqrt(np.sum(self.gap**2, (1, 2)) / np.maximum(3 * self.seen.sum(1), 1)))

    @property
    def largest_by_pose(self) -> NDArray:
        """Return the largest distance of a point in each pose (B,) in m."""
        return np.asarray(np.sqrt(np.max(np.sum(self.gap**2, -1), 1)))

    @property
    def rms(self) -> float | None:
        """Return the root mean square per coordinate in m, None where nothing was seen."""
        count = 3 * int(self.seen.sum())
        return float(np.sqrt(np.sum(self.gap**2) / count)) if count else None

    @property
    def largest(self) -> float | None:
        """Return the largest distance of a point in m, None where nothing was seen."""
        return float(self.largest_by_pose.max()) if self.seen.any() else None


def merged(errors: Sequence[PredictionError], block: NDArray, measured: MeasuredPoints) -> PredictionError:
    """Return the error of every pose as it is in the one of errors that block (B,) names."""
    each = np.arange(len(block))

    def chosen(arrays: list[NDArray]) -> NDArray:
        return np.asarray(np.stack(arrays)[block, each])

    turned, moved = (chosen([getattr(e.frames, name) for e in errors]) for name in ("R", "t"))
    frames = replace(errors[0].frames, R=turned, t=moved)
    parts = {name: chosen([getattr(e, name) for e in errors]) for name in _BY_POSE}
    return replace(errors[0], measured=measured, frames=frames, **parts)


def prediction_error(
    model: Model,
    measured: MeasuredPoints,
    frames: Frames,
    shared: NDArray,
    unpredicted: NDArray,
    by_shared: bool = True,
) -> PredictionError:
    """Return the error of the prediction from readings; unpredicted (H,) marks local unknowns that are fitted.

    Derivatives by the shared unknowns are left out (G = 0) where they are not asked for.
    """
    kept = np.concatenate([np.ones(6, bool), unpredicted])
    local = np.zeros((len(measured.points), len(unpredicted)))
    for _ in range(_ROUNDS):
        at = linearise(model, measured, frames, shared, local, by_shared=False)
        step = _fit(at.by_local[..., kept], at.residual[..., None])[..., 0]
        frames = frames.moved(step[:, :6])
        local[:, unpredicted] += step[:, 6:]
    at = linearise(model, measured, frames, shared, local, by_shared)
    whitened = at.residual.reshape(*measured.seen.shape, 3)
    gap = _unwhitened(measured, at.residual)
    fitted = at.by_local[..., kept]
    return PredictionError(gap, measured, whitened, frames, local, at.by_shared, fitted, model, shared)


def predicts_worse(before: PredictionError | None, after: PredictionError | None, covered: NDArray) -> bool:
    """Return whether held-out poses that a cause covers (B,) are predicted significantly worse, pose against pose."""
    if before is None or after is None or covered.sum() < 2:
        return False
    from scipy.special import stdtrit

    whitener = before.measured.whitener * after.seen[..., None, None]  # after another fit the noise is told anew
    former, latter = (np.einsum("bkij,bkj->bki", whitener, error.gap)[covered] for error in (before, after))
    worse = np.sum(latter**2 - former**2, (1, 2))
    of_noise = 4.0 * np.sum((latter - former) ** 2, (1, 2)).mean()
    freedom = len(worse) - 1 + _POSES_OF_NOISE
    variance = (np.sum((worse - worse.mean()) ** 2) + _POSES_OF_NOISE * of_noise) / freedom
    return bool(worse.mean() > stdtrit(freedom, 1.0 - _WORSE) * np.sqrt(variance / len(worse)))


def _unwhitened(measured: MeasuredPoints, rows: NDArray) -> NDArray:
    """Return whitened rows (B, M) as distances (B, K, 3) in m, zero where a point is missing."""
    gap = np.linalg.solve(_square(measured), rows.reshape(*measured.seen.shape, 3, 1))[..., 0]
    return np.where(measured.seen[..., None], gap, 0.0)


def noise_floor(fit: PointFit, measured: MeasuredPoints, unpredicted: NDArray, rng: np.random.Generator) -> float:
    """Return the rms, in m, that declared noise alone leaves in the prediction error of a fitted model.

    Draws of all noise (points, survey, actuators, geometry) go through the linearised fit.
    """
    whitened, problem = fit.whitened, fit.whitened.problem
    poses, count = problem.residual.shape
    noise = rng.standard_normal((poses, count, _FLOOR_DRAWS)) * problem.present[..., None]
    prior = rng.standard_normal((*problem.local_value.shape, _FLOOR_DRAWS)) * problem.local_known[:, None]
    error = _shared_error(whitened, noise, prior, rng)
    left = noise - problem.by_shared @ error
    actuators = np.concatenate([np.zeros(6, bool), ~unpredicted])
    left -= problem.by_local[..., actuators] @ prior[:, actuators]
    free = problem.by_local[..., ~actuators]
    left -= free @ _fit(free, left)
    gap = np.linalg.solve(_square(measured), left.reshape(*measured.seen.shape, 3, _FLOOR_DRAWS))
    return float(np.sqrt(np.mean(gap[measured.seen] ** 2)))


def _shared_error(whitened: Whitened, noise: NDArray, prior: NDArray, rng: np.random.Generator) -> NDArray:
    """Return the errors (G, D) of the shared unknowns that noise (B, M, D) and prior noise (B, H, D) lead to."""
    own = whitened.without_local(np.concatenate([noise, prior], 1)).reshape(-1, noise.shape[-1])
    others = rng.standard_normal((len(whitened.rows) - len(own), noise.shape[-1]))
    others *= whitened.present[len(own) :, None]
    return whitened.fitted(np.concatenate([own, others]))


def _fit(columns: NDArray, rows: NDArray) -> NDArray:
    """Return coefficients (B, h, D) of rows (B, M, D) on columns (B, M, h), held finite where a pose lacks targets."""
    basis, factor = np.linalg.qr(
        np.concatenate(
            [columns, np.broadcast_to(np.eye(columns.shape[-1]), (len(columns), *(columns.shape[-1],) * 2))], 1
        )
    )
    return np.linalg.solve(factor, np.swapaxes(basis[:, : columns.shape[1]], 1, 2) @ rows)


def _square(measured: MeasuredPoints) -> NDArray:
    """Return the whitener (B, K, 3, 3) with the identity where a point is missing."""
    return np.where(measured.seen[..., None, None], measured.whitener, np.eye(3))
