"""Gauss-Newton fit of a model of points to points of all bodies and poses, each pose in a frame of its own.

Knows no mechanism: the model is a function of shared and local unknowns that returns points and derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from truing.estimation.diagnosis.whitening import Linearised, Whitened, whiten
from truing.estimation.rotation import exp_so3, skew

# Nothing is known of a pose's frame; these keep the equations scaled, and bend it by parts in 1e8.
_FRAME_SIGMA = np.array([0.1] * 3 + [0.1] * 3)  # m, rad
_MAX_ITERATIONS = 25
# A fit has settled when its next step would lower the sum of squares by less than this: nothing moves by more than a
# hundredth of its standard deviation then.
_SETTLED = 1e-4


class Predicted(Protocol):
    """What a model returns: points (B, K, 3) in m in its own frame, derivatives, whitened rows that concern no pose."""

    points: NDArray
    by_shared: NDArray  # (B, K, 3, G)
    by_local: NDArray  # (B, K, 3, H)
    survey_residual: NDArray  # (E,)
    survey_by_shared: NDArray  # (E, G)
    shared_known: NDArray  # (G,) whose prior is knowledge
    local_known: NDArray  # (H,)


class Model(Protocol):
    """A model of points; unknowns are counted in standard deviations of their priors."""

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> Predicted:
        """Return points and derivatives at shared (G,) and local (B, H) unknowns; by the shared ones if asked for."""


@dataclass(frozen=True)
class MeasuredPoints:
    """Points (B, K, 3) in m, each pose in its own frame, with covariance (B, K, 3, 3) in m^2; seen (B, K)."""

    points: NDArray
    covariance: NDArray
    seen: NDArray

    @cached_property
    def whitener(self) -> NDArray:
        """Return the matrices (B, K, 3, 3) that make the noise unit and white; zero where a point is missing."""
        covariance = np.where(self.seen[..., None, None], self.covariance, np.eye(3))
        return np.linalg.inv(np.linalg.cholesky(covariance)) * self.seen[..., None, None]


@dataclass(frozen=True)
class Frames:
    """Frames of the poses: R (B, 3, 3) and t (B, 3) in m, from the model's frame to that of the measurement.

    They are fitted unless ``free`` is false: then the measurement has one frame for the campaign, the model's.
    """

    R: NDArray
    t: NDArray
    free: bool = True

    def moved(self, step: NDArray) -> Frames:
        """Return the frames after a step (B, 6) in units of the frame's scale."""
        motion = step * _FRAME_SIGMA
        return Frames(exp_so3(motion[:, 3:]) @ self.R, self.t + motion[:, :3], self.free)


class FitState(StrEnum):
    """How a fit ended."""

    SETTLED = "settled"
    NOT_SETTLED = "not-settled"


@dataclass(frozen=True)
class PointFit:
    """The unknowns at the optimum, in prior sigmas, the frames, and the whitened problem there."""

    shared: NDArray  # (G,)
    local: NDArray  # (B, H) without the frames
    frames: Frames
    whitened: Whitened
    state: FitState
    iterations: int


def fit_points(model: Model, measured: MeasuredPoints, frames: Frames, shared: NDArray, local: NDArray) -> PointFit:
    """Return the maximum of posterior probability over shared (G,) and local (B, H) unknowns and frames."""
    for iteration in range(_MAX_ITERATIONS):
        whitened = whiten(linearise(model, measured, frames, shared, local))
        if whitened.explained < _SETTLED:
            return PointFit(shared, local, frames, whitened, FitState.SETTLED, iteration)
        shared_step, local_step = whitened.step()
        shared, local = shared + shared_step, local + local_step[:, 6:]
        frames = frames.moved(local_step[:, :6])
    return PointFit(shared, local, frames, whitened, FitState.NOT_SETTLED, _MAX_ITERATIONS)


def linearise(
    model: Model, measured: MeasuredPoints, frames: Frames, shared: NDArray, local: NDArray, by_shared: bool = True
) -> Linearised:
    """Return the whitened problem at some values of the unknowns; the frames' six come first among the local ones.

    Derivatives by the shared unknowns are many, and left out (G = 0) where they are not asked for.
    """
    found = model.predict(shared, local, by_shared)
    arms = found.points @ np.swapaxes(frames.R, 1, 2)
    gap = measured.points - arms - frames.t[:, None]
    turned = measured.whitener @ frames.R[:, None]
    framed = measured.whitener @ np.concatenate([np.broadcast_to(np.eye(3), (*arms.shape, 3)), -skew(arms)], -1)
    by_local = np.concatenate([framed * _FRAME_SIGMA * frames.free, turned @ found.by_local], -1)
    poses = len(arms)
    return Linearised(
        residual=(measured.whitener @ gap[..., None]).reshape(poses, -1),
        by_local=by_local.reshape(poses, -1, by_local.shape[-1]),
        by_shared=(turned @ found.by_shared).reshape(poses, 3 * arms.shape[1], -1 if by_shared else 0),
        local_value=np.concatenate([np.zeros((poses, 6)), local], 1),
        shared_value=shared,
        extra_residual=found.survey_residual,
        extra_by_shared=found.survey_by_shared,
        present=np.repeat(measured.seen, 3, axis=1),
        local_known=np.concatenate([np.zeros(6, bool), found.local_known]),
        shared_known=found.shared_known,
    )


def whitened_columns(measured: MeasuredPoints, frames: Frames, columns: NDArray) -> NDArray:
    """Return motions of the points (B, K, 3, P), in m in the model's frame, as whitened rows (B, 3K, P)."""
    return (measured.whitener @ frames.R[:, None] @ columns).reshape(len(columns), -1, columns.shape[-1])
