"""F test of group means of residuals against the scatter within the groups.

Where the epochs of a group repeat one another, the scatter is pure error, whatever the model, and the means are lack of
fit (ANOVA; Draper and Smith, Applied Regression Analysis, 2.1).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from truing.inference.arrays import Array, Integers, Mask
from truing.inference.linear_problem import Whitened
from truing.inference.observations import Frames, Observations

Rows = TypeVar("Rows", Array, Mask)


@dataclass(frozen=True)
class EpochResiduals:
    """Residuals (B, N) of unit noise in axes that all epochs share: of observations, then of inputs.

    ``is_observed`` (B, N) marks valid residuals; ``redundancy`` (B, N) is the share of each that its epoch's own
    unknowns leave. Rows (B, N, G), orthonormal over all epochs, span what the shared unknowns explain: ``explained``
    (B, N) are their squares before the rotation, which leaves the sum over a place as it is; ``summed`` returns their
    sums (N, G) over some epochs.
    """

    values: Array
    is_observed: Mask
    redundancy: Array
    explained: Array
    summed: Callable[[Integers], Array]


@dataclass(frozen=True)
class MeansAgainstScatter:
    """F ratio: mean square of group means over that within groups, and the degrees of freedom of both."""

    ratio: float
    of_means: float
    within: float

    @property
    def p_value(self) -> float:
        """Probability of a ratio at least as large where all means are zero."""
        from scipy.special import fdtrc

        return float(fdtrc(self.of_means, self.within, self.ratio))


def epoch_residuals(whitened: Whitened, measured: Observations, frames: Frames, inputs: slice) -> EpochResiduals:
    """Return the residuals of a fit by epoch, rotated from the measurement's axes into those of the model."""
    epochs, count, size = measured.values.shape
    height = count * size + whitened.problem.local_value.shape[1]
    rows = slice(0, epochs * height)
    turn = _rotations(measured.whitener @ frames.R[:, None])
    rest = whitened.rest[rows].reshape(epochs, height, 1)
    present = whitened.present[rows].reshape(epochs, height)
    local = np.sum((_rotated_rows(turn, whitened.local_basis, inputs, count * size)) ** 2, -1)
    is_observed = _observed_and_inputs(present, inputs, count * size)
    explained = _observed_and_inputs(whitened.leverage_of_shared[rows].reshape(epochs, height), inputs, count * size)

    def summed(group: Integers) -> Array:
        return whitened.basis_summed(
            group, lambda basis: _rotated_rows(turn[group], basis, inputs, count * size) * is_observed[group, :, None]
        )

    return EpochResiduals(
        np.where(is_observed, _rotated_rows(turn, rest, inputs, count * size)[..., 0], 0.0),
        is_observed,
        np.where(is_observed, 1.0 - local, 0.0),
        np.where(is_observed, explained, 0.0),
        summed,
    )


def _rotations(matrices: Array) -> Array:
    """Return the rotations (B, K, d, d) from whitened rows to the model's axes: the transposed polar factors of
    matrices."""
    left, _, right = np.linalg.svd(matrices)
    return np.asarray(np.swapaxes(left @ right, -1, -2))


def _rotated_rows(turn: Array, rows: Array, inputs: slice, observed: int) -> Array:
    """Return rows (B, H, P) of observations, rotated, followed by those of inputs."""
    epochs, count, size = turn.shape[:3]
    of_observations = rows[:, :observed].reshape(epochs, count, size, rows.shape[-1])
    of_observations = of_observations if size == 1 else turn @ of_observations
    of_inputs = rows[:, observed + inputs.start : observed + inputs.stop]
    return np.concatenate([of_observations.reshape(epochs, observed, -1), of_inputs], 1)


def _observed_and_inputs(rows: Rows, inputs: slice, observed: int) -> Rows:
    """Return the columns of observations, followed by those of inputs, of values (B, H) of rows."""
    return np.concatenate([rows[:, :observed], rows[:, observed + inputs.start : observed + inputs.stop]], 1)


def means_against_scatter(residuals: EpochResiduals, groups: Integers, fewest: float) -> MeansAgainstScatter | None:
    """Return the F ratio of the means of groups (B,) of epochs, by number, -1 for none, residual by residual.

    Only residuals seen in several epochs of a group count. None where there are fewer than ``fewest`` epochs beyond one
    per group.
    """
    squares, freedom, beyond = np.zeros(2), np.zeros(2), 0
    for number in np.unique(groups[groups >= 0]):
        index = np.flatnonzero(groups == number)
        is_observed = residuals.is_observed[index]
        count = is_observed.sum(0)
        redundancy = np.where(count > 1, residuals.redundancy[index], 0.0)
        weight = np.where(count > 1, 1.0 / np.maximum(count, 1), 0.0)  # sum of squares of a mean over the squared sum
        of_mean = weight * residuals.values[index].sum(0) ** 2
        sum_of_squares = np.where(count > 1, residuals.values[index] ** 2, 0.0).sum()
        explained = residuals.explained[index][:, count > 1].sum()
        squares += of_mean.sum(), sum_of_squares - of_mean.sum()
        own_freedom = (weight * redundancy).sum() - (weight @ residuals.summed(index) ** 2).sum()
        freedom += own_freedom, redundancy.sum() - explained - own_freedom
        beyond += len(index) - 1
    if beyond < fewest or not (freedom > 1.0).all():
        return None
    mean = squares / freedom
    return MeansAgainstScatter(float(mean[0] / max(mean[1], 1e-300)), float(freedom[0]), float(freedom[1]))


def means_of_columns(values: Array) -> MeansAgainstScatter | None:
    """Return the F ratio of the means of columns of values (B, N), NaN where unknown; None where the scatter within the
    columns cannot be estimated."""
    known = np.isfinite(values)
    count = known.sum(0)
    values, known, count = values[:, count > 1], known[:, count > 1], count[count > 1]
    freedom = float(len(count)), float((count - 1).sum())
    if min(freedom) <= 1.0:
        return None
    of_means = np.where(known, values, 0.0).sum(0) ** 2 / count
    within = np.where(known, values, 0.0) ** 2
    mean_squares = of_means.sum() / freedom[0], (within.sum() - of_means.sum()) / freedom[1]
    return MeansAgainstScatter(float(mean_squares[0] / max(mean_squares[1], 1e-300)), *freedom)
