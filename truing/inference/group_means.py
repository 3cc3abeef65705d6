"""Residuals of epochs group by group: how far their means are from zero, against their scatter within a group.

Of epochs that repeat one another the scatter is pure error, whatever the model; what they have in common is lack of
fit (the F test of ANOVA; Draper and Smith, Applied Regression Analysis, 2.1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.inference.arrays import Array, Integers, Mask
from truing.inference.linear_problem import Whitened
from truing.inference.observations import Frames, Observations


@dataclass(frozen=True)
class EpochResiduals:
    """Residuals (B, N) of unit noise in axes that all epochs share: of observations, then of inputs.

    ``seen`` (B, N): which say something; ``told`` (B, N): the share of each that its epoch's own unknowns leave;
    ``basis`` (B, N, G): orthonormal, over all epochs, with what shared unknowns explain.
    """

    values: Array
    seen: Mask
    redundancy: Array
    basis: Array


@dataclass(frozen=True)
class MeansAgainstScatter:
    """Mean squares of group means over those within groups, and the degrees of freedom of both."""

    ratio: float
    of_means: float
    within: float

    @property
    def p_value(self) -> float:
        """The chance of as large a ratio where groups have nothing in common."""
        from scipy.special import fdtrc

        return float(fdtrc(self.of_means, self.within, self.ratio))


def epoch_residuals(whitened: Whitened, measured: Observations, frames: Frames, inputs: slice) -> EpochResiduals:
    """Return what a fit leaves of each epoch, turned from the measurement's axes into those of the model."""
    epochs, count, size = measured.values.shape
    height = count * size + whitened.problem.local_value.shape[1]
    rows = slice(0, epochs * height)
    turn = _rotations(measured.whitener @ frames.R[:, None])
    rest = whitened.rest[rows].reshape(epochs, height, 1)
    present = whitened.present[rows].reshape(epochs, height)
    basis = whitened.basis[rows].reshape(epochs, height, -1)
    local = np.sum((_turned(turn, whitened.local_basis, inputs, count * size)) ** 2, -1)
    seen = _chosen(present, inputs, count * size)
    return EpochResiduals(
        np.where(seen, _turned(turn, rest, inputs, count * size)[..., 0], 0.0),
        seen,
        np.where(seen, 1.0 - local, 0.0),
        np.where(seen[..., None], _turned(turn, basis, inputs, count * size), 0.0),
    )


def _rotations(matrices: Array) -> Array:
    """Return the rotations (B, K, d, d) next to matrices, by which whitened rows come into the model's axes."""
    left, _, right = np.linalg.svd(matrices)
    return np.asarray(np.swapaxes(left @ right, -1, -2))


def _turned(turn: Array, rows: Array, inputs: slice, observed: int) -> Array:
    """Return rows (B, H, P) of observations, turned, and of inputs."""
    epochs, count, size = turn.shape[:3]
    own = rows[:, :observed].reshape(epochs, count, size, rows.shape[-1])
    own = own if size == 1 else turn @ own
    of_inputs = rows[:, observed + inputs.start : observed + inputs.stop]
    return np.concatenate([own.reshape(epochs, observed, -1), of_inputs], 1)


def _chosen(rows: Mask, inputs: slice, observed: int) -> Mask:
    return np.concatenate([rows[:, :observed], rows[:, observed + inputs.start : observed + inputs.stop]], 1)


def means_against_scatter(residuals: EpochResiduals, groups: Integers, fewest: float) -> MeansAgainstScatter | None:
    """Return how far the means of groups (B,), by number, -1 for none, are from zero, residual by residual.

    Only what several epochs of a group have seen counts. None with fewer than so many epochs beyond one per group.
    """
    squares, freedom, beyond = np.zeros(2), np.zeros(2), 0
    for number in np.unique(groups[groups >= 0]):
        own = np.flatnonzero(groups == number)
        seen = residuals.seen[own]
        count = seen.sum(0)
        redundancy = np.where(count > 1, residuals.redundancy[own], 0.0)
        weight = np.where(count > 1, 1.0 / np.maximum(count, 1), 0.0)  # of a mean's square, over that of the sum
        of_mean = weight * residuals.values[own].sum(0) ** 2
        whole = np.where(count > 1, residuals.values[own] ** 2, 0.0).sum()
        explained = weight[:, None] * residuals.basis[own].sum(0) ** 2
        basis = np.where((count > 1)[:, None], residuals.basis[own] ** 2, 0.0).sum()
        squares += of_mean.sum(), whole - of_mean.sum()
        own_freedom = (weight * redundancy).sum() - explained.sum()
        freedom += own_freedom, redundancy.sum() - basis - own_freedom
        beyond += len(own) - 1
    if beyond < fewest or not (freedom > 1.0).all():
        return None
    mean = squares / freedom
    return MeansAgainstScatter(float(mean[0] / max(mean[1], 1e-300)), float(freedom[0]), float(freedom[1]))
