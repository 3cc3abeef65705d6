"""Observations of all groups at some epochs, and the frame in which each epoch is measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, Self

import numpy as np

from truing.estimation.patterns import InputGroups, patterns
from truing.estimation.rotation import exp_so3, rigid_motions
from truing.inference.arrays import Array, Integers, Mask
from truing.inference.blocks import BlockKind
from truing.inference.model import ConditionsT_co

_SPACE, _FRAME = 3, 6
# Prior sigmas of an unknown frame. They only keep the equations scaled, and bias a frame by parts in 1e8.
_FRAME_SIGMA = np.array([0.1] * 3 + [0.1] * 3)  # m, rad


@dataclass(frozen=True)
class Observations:
    """Observations (B, K, d), SI, each epoch in its own frame, with covariance (B, K, d, d); ``is_observed`` (B, K)."""

    values: Array
    covariance: Array
    is_observed: Mask

    @property
    def size(self) -> int:
        """Number of coordinates d of an observation."""
        return int(self.values.shape[-1])

    @cached_property
    def whitener(self) -> Array:
        """Matrices (B, K, d, d) that make the noise unit and white; zero where an observation is missing."""
        covariance = np.where(self.is_observed[..., None, None], self.covariance, np.eye(self.size))
        return np.linalg.inv(np.linalg.cholesky(covariance)) * self.is_observed[..., None, None]

    def with_observed(self, is_observed: Mask) -> Observations:
        """Return them with other observations marked as is_observed (B, K)."""
        return replace(self, is_observed=is_observed)


@dataclass(frozen=True)
class Frames:
    """Frames of the epochs: R (B, d, d) and t (B, d) in m, from the model's frame to that of the measurement.

    They are fitted if ``free``; otherwise the measurement has one frame for the campaign, which is the model's.
    """

    R: Array
    t: Array
    free: bool = True

    @classmethod
    def of_numbers(cls, epochs: int) -> Frames:
        """Return empty frames for observations that are numbers, d = 1."""
        return cls(np.ones((epochs, 1, 1)), np.zeros((epochs, 1)), free=False)

    @property
    def size(self) -> int:
        """Number of unknowns of a frame: six, or none where frames are not fitted or observations are numbers."""
        return _FRAME if self.free and self.t.shape[1] == _SPACE else 0

    def columns(self, arms: Array) -> Array:
        """Return the derivatives (B, K, d, size) of observations by their frames, in units of the frame's scale.

        ``arms`` (B, K, d) are the observations relative to their frame's origin, in the measurement's axes.
        """
        if not self.size:
            return np.zeros((*arms.shape, 0))
        moved = rigid_motions(arms)
        return np.asarray(moved * _FRAME_SIGMA)

    def moved(self, step: Array) -> Frames:
        """Return the frames after a step (B, size) in units of the frame's scale."""
        if not self.size:
            return self
        motion = step * _FRAME_SIGMA
        return Frames(exp_so3(motion[:, 3:]) @ self.R, self.t + motion[:, :3], self.free)


@dataclass(frozen=True)
class Epochs(Generic[ConditionsT_co]):
    """Measured observations of some epochs, the conditions that the model needs there, and initial frames.

    ``kept`` (B, K): observations that a person declared correct, so they are never screened; ``repeats`` (B,): numbers
    of commands that were given more than once, -1 for the others; ``groupings`` (B,): group numbers of the epochs by
    kind, -1 for none; ``inputs``: groups of epochs that share an input. Each is None where it is unknown.
    """

    measured: Observations
    conditions: ConditionsT_co
    frames: Frames
    kept: Mask | None = None
    repeats: Integers | None = None
    groupings: Mapping[BlockKind, Integers] | None = None
    inputs: InputGroups | None = None

    def patterned(self, wrong: Mask, rest: Array) -> Mask:
        """Return the mask of suspected gross errors (B, K) that form a pattern where epochs share an input, from
        whitened residuals (B, K, 1): they are an effect."""
        effect = np.zeros(wrong.shape, bool)
        if self.inputs is None or rest.shape[-1] != 1:
            return effect
        for k in np.flatnonzero(wrong.any(axis=0)).tolist():
            rows = np.flatnonzero(wrong[:, k])
            observed = np.flatnonzero(self.measured.is_observed[:, k] | wrong[:, k])
            for pattern in patterns(self.inputs, observed, rows, rest[rows, k, 0]):
                effect[pattern.rows, k] = True
        return effect

    def removable(self, wrong: Mask) -> Mask:
        """Return the gross errors (B, K) that may be excluded, of those suspected."""
        return wrong if self.kept is None else wrong & ~self.kept

    def without(self, wrong: Mask) -> Self:
        """Return the epochs without some observations (B, K)."""
        return replace(self, measured=self.measured.with_observed(self.measured.is_observed & ~wrong))

    def with_kept(self, more: Mask) -> Self:
        """Return the epochs with some more observations (B, K), which are never screened again."""
        if not more.any():
            return self
        declared_correct = more if self.kept is None else self.kept | more
        return replace(
            self, measured=self.measured.with_observed(self.measured.is_observed | more), kept=declared_correct
        )


def whitened_columns(measured: Observations, frames: Frames, columns: Array) -> Array:
    """Return motions of the observations (B, K, d, P), in the model's frame, as whitened rows (B, d K, P)."""
    epochs, count, size, parameters = columns.shape
    return (measured.whitener @ frames.R[:, None] @ columns).reshape(epochs, count * size, parameters)
