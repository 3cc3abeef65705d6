"""Causes without a mean effect, which make some inputs or observations scatter more than the rest of their kind.

Such a cause shows only in the squares of residuals, and changes their weights.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic

import numpy as np

from truing.inference.arrays import Array, Mask
from truing.inference.linear_problem import Whitened
from truing.inference.model import CauseT, ScatterCandidate
from truing.inference.noise import Driver, noise_dependence, variance_gain

# Least redundancy of an input, relative to the largest one.
_LEAST_REDUNDANCY = 0.01
# Relative change below which a variance has converged.
SETTLED = 0.01
_TINY = 1e-12
_LEAST, _MOST = 0.5, 1e4
# Largest relative uncertainty for which the first-order correction of a scatter is valid; it is limited to this.
_ROUGH = 0.5


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


@dataclass(frozen=True)
class InputResiduals:
    """Residuals of the inputs (B, H) in prior sigmas, and their redundancy (B, H, H).

    The redundancy is the covariance of the residuals if the inputs scatter by their prior sigmas.
    """

    rest: Array
    redundancy: Array

    @property
    def standardised(self) -> Array:
        """Residuals (B, H, 1) of unit variance, uncorrelated within an epoch; NaN where the redundancy is too small."""
        amount, axes = np.linalg.eigh(self.redundancy)
        least = max(_LEAST_REDUNDANCY * float(amount.max(initial=0.0)), _TINY)
        enough = amount > least
        root = np.where(enough, 1.0 / np.sqrt(np.maximum(amount, least)), 0.0)
        unit = np.einsum("bik,bk,bjk,bj->bi", axes, root, axes, self.rest)
        share = np.einsum("bik,bk,bik->bi", axes, enough, axes)
        return np.where(share > 0.5, unit / np.sqrt(np.maximum(share, 0.5)), np.nan)[..., None]

    def factor(self, own: Mask) -> tuple[float, float]:
        """Return the scatter of inputs ``own`` (B, H) over their prior sigmas, and its relative standard deviation."""
        both = np.sum(self.redundancy**2 * own[:, :, None] * own[:, None, :])
        share = np.diagonal(self.redundancy, axis1=1, axis2=2)
        excess = float(np.sum((self.rest**2 - share)[own]) / both)
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
    rest = whitened.rest[: epochs * height].reshape(epochs, height)[:, rows]
    return InputResiduals(rest, np.eye(rest.shape[1]) - whitened.taken(rows))


def drivers_of(candidates: Sequence[ScatterCandidate[CauseT]]) -> list[Driver]:
    """Return the candidates as drivers of noise, compared with the same input at other epochs.

    A candidate that covers an input at all epochs is compared with the other inputs.
    """
    found = []
    for candidate in candidates:
        own = candidate.own
        always = bool(np.all(own.all(0) | ~own.any(0)))
        within = np.zeros(own.shape[1], int) if always else np.arange(own.shape[1])
        found.append(Driver("", own.astype(float), within, cause=candidate.cause))
    return found


def scattering(
    residuals: InputResiduals, candidates: Sequence[ScatterCandidate[CauseT]], level: float
) -> tuple[ScatterCandidate[CauseT], float] | None:
    """Return the candidate whose inputs scatter most significantly, and the familywise p-value; None where p exceeds
    the level.

    The p-value comes from the logarithms of squares, which a few large ones do not dominate. The candidate is chosen by
    the likelihood of a separate variance for its inputs.
    """
    found = noise_dependence(residuals.standardised, drivers_of(candidates), level)
    if found is None:
        return None
    return likeliest_scatter(residuals, candidates), found.p_value


def likeliest_scatter(
    residuals: InputResiduals, candidates: Sequence[ScatterCandidate[CauseT]], factor: Array | float = 1.0
) -> ScatterCandidate[CauseT]:
    """Return the candidate with the largest likelihood of a separate variance; the fit widened prior sigmas by factors
    (B, H)."""
    square = (residuals.standardised[..., 0] * factor) ** 2
    return candidates[int(np.argmax([variance_gain(square, candidate.own) for candidate in candidates]))]


def overlapping_candidates(
    candidates: Sequence[ScatterCandidate[CauseT]], candidate: ScatterCandidate[CauseT]
) -> list[ScatterCandidate[CauseT]]:
    """Return the candidate first, then all that share at least half of their inputs with it."""
    own = candidate.own
    return [candidate, *(one for one in candidates if 2 * (one.own & own).sum() >= (one.own | own).sum())]
