"""Gauss-Newton fit of a model of points to points of all bodies and poses, each pose in a frame of its own.

Knows no mechanism: the model is a function of shared and local unknowns that returns points and derivatives. A point
has d coordinates: three, or one where an instrument reads a number; numbers have no frame.
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

_SPACE, _FRAME = 3, 6
# Nothing is known of a pose's frame; these keep the equations scaled, and bend it by parts in 1e8.
_FRAME_SIGMA = np.array([0.1] * 3 + [0.1] * 3)  # m, rad
_MAX_ITERATIONS = 25
# A step that makes things worse, far from the optimum, is halved until it does not.
_MOST_HALVINGS = 8
# A fit has settled when its next step would lower the sum of squares by less than this: nothing moves by more than a
# hundredth of its standard deviation then.
_SETTLED = 1e-4


class Predicted(Protocol):
    """What a model returns: points (B, K, d), SI, in its own frame, derivatives, whitened rows that concern no pose."""

    points: NDArray
    by_shared: NDArray  # (B, K, d, G)
    by_local: NDArray  # (B, K, d, H)
    survey_residual: NDArray  # (E,)
    survey_by_shared: NDArray  # (E, G)
    shared_known: NDArray  # (G,) whose prior is knowledge
    local_known: NDArray  # (H,)


class Model(Protocol):
    """A model of points; unknowns are counted in standard deviations of their priors."""

    @property
    def zeros(self) -> NDArray | None:
        """Return which readings (B, K) share a zero, by number, -1 for none; None where points have frames."""

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> Predicted:
        """Return points and derivatives at shared (G,) and local (B, H) unknowns; by the shared ones if asked for."""


@dataclass(frozen=True)
class MeasuredPoints:
    """Points (B, K, d), SI, each pose in its own frame, with covariance (B, K, d, d); seen (B, K)."""

    points: NDArray
    covariance: NDArray
    seen: NDArray

    @property
    def size(self) -> int:
        """Return the number of coordinates d of a point."""
        return int(self.points.shape[-1])

    @cached_property
    def whitener(self) -> NDArray:
        """Return the matrices (B, K, d, d) that make the noise unit and white; zero where a point is missing."""
        covariance = np.where(self.seen[..., None, None], self.covariance, np.eye(self.size))
        return np.linalg.inv(np.linalg.cholesky(covariance)) * self.seen[..., None, None]


@dataclass(frozen=True)
class Frames:
    """Frames of the poses: R (B, d, d) and t (B, d) in m, from the model's frame to that of the measurement.

    They are fitted unless ``free`` is false: then the measurement has one frame for the campaign, the model's.
    """

    R: NDArray
    t: NDArray
    free: bool = True

    @classmethod
    def of_numbers(cls, poses: int) -> Frames:
        """Return the frames of readings that are numbers, d = 1: none."""
        return cls(np.ones((poses, 1, 1)), np.zeros((poses, 1)), free=False)

    @property
    def size(self) -> int:
        """Return how many unknowns a frame is: six, or none where points are numbers."""
        return _FRAME if self.t.shape[1] == _SPACE else 0

    def columns(self, arms: NDArray) -> NDArray:
        """Return how points (B, K, d) move with their frames, (B, K, d, size), in units of the frame's scale; arms are
        the points from their frame's origin, in the measurement's axes."""
        if not self.size:
            return np.zeros((*arms.shape, 0))
        moved = np.concatenate([np.broadcast_to(np.eye(_SPACE), (*arms.shape, _SPACE)), -skew(arms)], -1)
        return np.asarray(moved * _FRAME_SIGMA * self.free)

    def moved(self, step: NDArray) -> Frames:
        """Return the frames after a step (B, size) in units of the frame's scale."""
        if not self.size:
            return self
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
    problem = linearise(model, measured, frames, shared, local)
    for iteration in range(_MAX_ITERATIONS):
        whitened = whiten(problem)
        if whitened.explained < _SETTLED:
            return PointFit(shared, local, frames, whitened, FitState.SETTLED, iteration)
        of_shared, of_local = whitened.step()
        for halved in range(_MOST_HALVINGS):
            part = 0.5**halved
            own = shared + part * of_shared, local + part * of_local[:, frames.size :]
            moved = frames.moved(part * of_local[:, : frames.size])
            problem = linearise(model, measured, moved, *own)
            if problem.squares <= whitened.problem.squares:
                break
        (shared, local), frames = own, moved
    return PointFit(shared, local, frames, whiten(problem), FitState.NOT_SETTLED, _MAX_ITERATIONS)


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
    by_local = np.concatenate([measured.whitener @ frames.columns(arms), turned @ found.by_local], -1)
    poses, height = len(arms), arms.shape[1] * arms.shape[2]
    return Linearised(
        residual=(measured.whitener @ gap[..., None]).reshape(poses, -1),
        by_local=by_local.reshape(poses, height, by_local.shape[-1]),
        by_shared=(turned @ found.by_shared).reshape(poses, height, -1 if by_shared else 0),
        local_value=np.concatenate([np.zeros((poses, frames.size)), local], 1),
        shared_value=shared,
        extra_residual=found.survey_residual,
        extra_by_shared=found.survey_by_shared,
        present=np.repeat(measured.seen, measured.size, axis=1),
        local_known=np.concatenate([np.zeros(frames.size, bool), found.local_known]),
        shared_known=found.shared_known,
    )


def whitened_columns(measured: MeasuredPoints, frames: Frames, columns: NDArray) -> NDArray:
    """Return motions of the points (B, K, d, P), in the model's frame, as whitened rows (B, d K, P)."""
    poses, count, size, parameters = columns.shape
    return (measured.whitener @ frames.R[:, None] @ columns).reshape(poses, count * size, parameters)
