"""Points of all bodies at some poses, and the frame that each pose is measured in."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3, skew

_SPACE, _FRAME = 3, 6
# Nothing is known of a pose's frame; these keep the equations scaled, and bend it by parts in 1e8.
_FRAME_SIGMA = np.array([0.1] * 3 + [0.1] * 3)  # m, rad


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


@dataclass(frozen=True)
class Poses:
    """Measured points of some poses, the conditions that the model needs there, and frames to start from.

    ``kept`` (B, K): points that are no gross errors, for a person says so.
    """

    measured: MeasuredPoints
    conditions: Any
    frames: Frames
    kept: NDArray | None = None

    def judged(self, wrong: NDArray) -> NDArray:
        """Return which points (B, K) are to be taken out, of those that look grossly wrong."""
        return wrong if self.kept is None else wrong & ~self.kept

    def without(self, wrong: NDArray) -> Poses:
        """Return the poses without some points (B, K)."""
        return replace(self, measured=replace(self.measured, seen=self.measured.seen & ~wrong))


def whitened_columns(measured: MeasuredPoints, frames: Frames, columns: NDArray) -> NDArray:
    """Return motions of the points (B, K, d, P), in the model's frame, as whitened rows (B, d K, P)."""
    poses, count, size, parameters = columns.shape
    return (measured.whitener @ frames.R[:, None] @ columns).reshape(poses, count * size, parameters)
