"""What a model of points gets wrong when it predicts from readings alone, and what pure noise would leave there.

Removed from measured minus predicted are only one motion per pose common to all bodies, and local unknowns that the
model does not claim to predict (the roll of a leg about its own axis).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.point_fit import Frames, MeasuredPoints, Model, PointFit, linearise
from truing.estimation.whitening import Whitened

# Newton on frames and rolls: after two rounds from a pose's own fit, nothing is left to gain.
_ROUNDS = 2
_FLOOR_DRAWS = 24


@dataclass(frozen=True)
class PredictionError:
    """Measured minus predicted points (B, K, 3), in m in the measurement's axes, zero where unseen."""

    gap: NDArray
    seen: NDArray  # (B, K)
    whitened: NDArray  # (B, K, 3) the same in units of the noise

    @property
    def squares(self) -> NDArray:
        """Return the whitened sum of squares of each pose (B,)."""
        return np.sum(self.whitened**2, (1, 2))

    @property
    def rms(self) -> float | None:
        """Return the root mean square per coordinate in m, None where nothing was seen."""
        count = 3 * int(self.seen.sum())
        return float(np.sqrt(np.sum(self.gap**2) / count)) if count else None

    @property
    def largest(self) -> float | None:
        """Return the largest distance of a point in m, None where nothing was seen."""
        return float(np.sqrt(np.max(np.sum(self.gap**2, -1)))) if self.seen.any() else None


def prediction_error(
    model: Model, measured: MeasuredPoints, frames: Frames, shared: NDArray, unpredicted: NDArray
) -> PredictionError:
    """Return the error of the prediction from readings; unpredicted (H,) marks local unknowns that are fitted."""
    kept = np.concatenate([np.ones(6, bool), unpredicted])
    local = np.zeros((len(measured.points), len(unpredicted)))
    for _ in range(_ROUNDS):
        at = linearise(model, measured, frames, shared, local)
        step = _fit(at.by_local[..., kept], at.residual[..., None])[..., 0]
        frames = frames.moved(step[:, :6])
        local[:, unpredicted] += step[:, 6:]
    at = linearise(model, measured, frames, shared, local)
    gap = np.linalg.solve(_square(measured), at.residual.reshape(*measured.seen.shape, 3, 1))[..., 0]
    gap = np.where(measured.seen[..., None], gap, 0.0)
    return PredictionError(gap, measured.seen, at.residual.reshape(*measured.seen.shape, 3))


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
