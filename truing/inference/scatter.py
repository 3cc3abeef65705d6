"""Causes without a mean effect, which make some inputs or observations scatter more than the rest of their kind.

Such a cause shows only in the squares of residuals, and changes their weights.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Generic

import numpy as np

from truing.inference.arrays import Array, Integers, Mask
from truing.inference.linear_problem import Whitened
from truing.inference.model import CauseT, ScatterCandidate
from truing.inference.noise import Driver, noise_dependence, variance_gain

# Least share of an input's redundancy that the inputs before must leave.
_LEAST_REDUNDANCY = 0.01
# Relative change below which a variance has converged.
SETTLED = 0.01
_TINY = 1e-12
_LEAST, _MOST = 0.5, 1e4
# Largest relative uncertainty for which the first-order correction of a scatter is valid; it is limited to this.
_ROUGH = 0.5
# A scatter remains if it is larger than this many standard deviations.
_REMAINS = 2.0


@dataclass(frozen=True)
class FoundScatter(Generic[CauseT]):
    """A cause by which inputs scatter, with a p-value corrected for all candidates tried.

    ``size``, with ``sigma``: scatter in SI, beyond the declared sigma of these inputs. ``doubt``: the reason why it is
    only suspected (a value of ``Reason``), empty where it is found.
    """

    candidate: ScatterCandidate[CauseT]
    p_value: float
    size: float
    sigma: float
    doubt: str = ""

    @property
    def remains(self) -> bool:
        """True if the inputs still scatter next to the causes found after their prior was widened."""
        return self.size > _REMAINS * self.sigma


@dataclass(frozen=True)
class InputResiduals:
    """Residuals of the inputs (B, H) in prior sigmas, and their redundancy (B, H, H).

    The redundancy is the covariance of the residuals if the inputs scatter by their prior sigmas.
    """

    rest: Array
    redundancy: Array
    _known: dict[bytes, Array] = field(default_factory=dict, repr=False)  # standardised, by the inputs that come first

    def standardised(self, selected: Mask) -> Array:
        """Return residuals (B, H, 1) of unit variance, uncorrelated within an epoch, those of inputs ``selected`` (B,
        H) first: these keep all that shows of their scatter.

        NaN where the inputs before leave nothing of an input. Shared alike, the scatter of one input would appear in
        all that move the observations alike.
        """
        first = selected.any(0)
        if first.tobytes() not in self._known:
            self._known[first.tobytes()] = self._after(np.argsort(~first, kind="stable"))
        return self._known[first.tobytes()]

    def _after(self, order: Integers) -> Array:
        """Return the residuals (B, H, 1), each without what those before it in the order (H,) predict of it."""
        residuals, redundancy = self.rest[:, order], self.redundancy[:, order][:, :, order]
        least = _LEAST_REDUNDANCY * np.diagonal(redundancy, axis1=1, axis2=2) + _TINY
        result = np.full(residuals.shape, np.nan)
        for index in range(len(order)):
            pivot = redundancy[:, index, index]
            enough = pivot > least[:, index]
            pivot = np.where(enough, pivot, np.inf)
            result[enough, order[index]] = (residuals[:, index] / np.sqrt(pivot))[enough]
            column = redundancy[:, :, index] / pivot[:, None]
            residuals = residuals - column * residuals[:, index, None]
            redundancy = redundancy - column[:, :, None] * redundancy[:, index, None, :]
        return result[..., None]

    def factor(self, selected: Mask) -> tuple[float, float]:
        """Return the scatter of inputs ``selected`` (B, H) over their prior sigmas, and its relative standard
        deviation."""
        both = np.sum(self.redundancy**2 * selected[:, :, None] * selected[:, None, :])
        share = np.diagonal(self.redundancy, axis1=1, axis2=2)
        excess = float(np.sum((self.rest**2 - share)[selected]) / both)
        factor = math.sqrt(min(max(1.0 + excess, _LEAST**2), _MOST**2))
        return factor, 1.0 / math.sqrt(2.0 * both)


def unbiased(size: float, sigma: float) -> tuple[float, float]:
    """Return a scatter and its sigma, corrected for the bias of the root of an unbiased variance.

    The root is low on average by half the square of its relative sigma, and where it is low its sigma is low too. Both
    are corrected to first order, so that intervals of two sigmas have their nominal coverage.
    """
    low = min(sigma / max(size, 1e-300), _ROUGH) ** 2
    return size * (1.0 + low / 2.0), sigma * (1.0 + 1.5 * low)


def input_residuals(whitened: Whitened, observed: int, inputs: slice) -> InputResiduals:
    """Return the residuals of the inputs, whose priors follow the first ``observed`` rows of every epoch."""
    epochs, height = len(whitened.problem.residual), observed + whitened.problem.local_value.shape[1]
    rows = np.s_[observed + inputs.start : observed + inputs.stop]
    residuals = whitened.rest[: epochs * height].reshape(epochs, height)[:, rows]
    return InputResiduals(residuals, np.eye(residuals.shape[1]) - whitened.taken(rows))


def drivers_of(candidates: Sequence[ScatterCandidate[CauseT]]) -> list[Driver]:
    """Return the candidates as drivers of noise, compared with the same input at other epochs.

    A candidate that covers an input at all epochs is compared with the other inputs.
    """
    drivers = []
    for candidate in candidates:
        selected = candidate.own
        always = bool(np.all(selected.all(0) | ~selected.any(0)))
        within = np.zeros(selected.shape[1], int) if always else np.arange(selected.shape[1])
        drivers.append(Driver("", selected, within, cause=candidate.cause))
    return drivers


def scattering(
    residuals: InputResiduals, candidates: Sequence[ScatterCandidate[CauseT]], level: float
) -> tuple[ScatterCandidate[CauseT], float] | None:
    """Return the candidate whose inputs scatter most significantly, and the familywise p-value; None where p exceeds
    the level.

    The p-value comes from the logarithms of squares, which a few large ones do not dominate. The candidate is chosen by
    the likelihood of a separate variance for its inputs.
    """
    p_value = 1.0
    for inputs in {candidate.own.any(0).tobytes() for candidate in candidates}:
        alike = [other for other in candidates if other.own.any(0).tobytes() == inputs]
        share = len(alike) / len(candidates)
        dependence = noise_dependence(residuals.standardised(alike[0].own), drivers_of(alike), level * share)
        p_value = min(p_value, 1.0 if dependence is None else dependence.p_value / share)
    return (likeliest_scatter(residuals, candidates), p_value) if p_value <= level else None


def likeliest_scatter(
    residuals: InputResiduals, candidates: Sequence[ScatterCandidate[CauseT]], factor: Array | float = 1.0
) -> ScatterCandidate[CauseT]:
    """Return the candidate with the largest likelihood of a separate variance; the fit widened prior sigmas by factors
    (B, H)."""
    gains = []
    for candidate in candidates:
        square = (residuals.standardised(candidate.own)[..., 0] * factor) ** 2
        gains.append(variance_gain(square, candidate.own))
    return candidates[int(np.argmax(gains))]


def overlapping_candidates(
    candidates: Sequence[ScatterCandidate[CauseT]], candidate: ScatterCandidate[CauseT]
) -> list[ScatterCandidate[CauseT]]:
    """Return the candidate first, then all that share at least half of their inputs with it."""
    selected = candidate.own
    return [
        candidate,
        *(other for other in candidates if 2 * (other.own & selected).sum() >= (other.own | selected).sum()),
    ]
