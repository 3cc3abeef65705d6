"""What scatters more than the rest of its kind: inputs of some epochs, or all that was observed for a while.

Such a cause moves nothing on average. It shows in the squares of residuals alone, and changes what these count.
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

# Of an input a fit has to tell this share of what it tells of the one that it tells most of.
_TOLD = 0.01
# A variance is settled within this share of itself.
SETTLED = 0.01
_TINY = 1e-12
_LEAST, _MOST = 0.5, 1e4
# A scatter that is known worse than this is mended as if it were known so well: the correction is one of first order.
_ROUGH = 0.5


@dataclass(frozen=True)
class FoundScatter(Generic[CauseT]):
    """A cause by which inputs scatter; its p-value, corrected for all that was tried; and how much: in SI, beyond the
    prior sigma of these inputs, with one sigma. ``doubt``: why it is only suspected (a value of ``Reason``), empty
    where it is found."""

    candidate: ScatterCandidate[CauseT]
    p_value: float
    size: float
    sigma: float
    doubt: str = ""


@dataclass(frozen=True)
class InputResiduals:
    """What a fit makes of the inputs (B, H), in prior sigmas, and how much of them it tells (B, H, H): the covariance
    of that where inputs scatter by their prior sigmas."""

    rest: Array
    redundancy: Array

    @property
    def standardised(self) -> Array:
        """Return the residuals (B, H, 1) brought to unit variance, without correlation within an epoch; NaN where a fit
        tells next to nothing."""
        amount, axes = np.linalg.eigh(self.redundancy)
        least = max(_TOLD * float(amount.max(initial=0.0)), _TINY)
        enough = amount > least
        root = np.where(enough, 1.0 / np.sqrt(np.maximum(amount, least)), 0.0)
        unit = np.einsum("bik,bk,bjk,bj->bi", axes, root, axes, self.rest)
        share = np.einsum("bik,bk,bik->bi", axes, enough, axes)
        return np.where(share > 0.5, unit / np.sqrt(np.maximum(share, 0.5)), np.nan)[..., None]

    def factor(self, own: Mask) -> tuple[float, float]:
        """Return by how much inputs own (B, H) scatter more than their prior sigmas, and the share of it that is one
        sigma."""
        both = np.sum(self.redundancy**2 * own[:, :, None] * own[:, None, :])
        share = np.diagonal(self.redundancy, axis1=1, axis2=2)
        excess = float(np.sum((self.rest**2 - share)[own]) / both)
        factor = math.sqrt(min(max(1.0 + excess, _LEAST**2), _MOST**2))
        return factor, 1.0 / math.sqrt(2.0 * both)


def unbiased(size: float, sigma: float) -> tuple[float, float]:
    """A scatter and its sigma, from the root of an unbiased variance.

    The root is low on average, by half the square of its relative sigma, and told too surely where it came out low: to
    that order both are mended, so that intervals of two sigmas cover what they say.
    """
    low = min(sigma / max(size, 1e-300), _ROUGH) ** 2
    return size * (1.0 + low / 2.0), sigma * (1.0 + 1.5 * low)


def input_residuals(whitened: Whitened, observed: int, inputs: slice) -> InputResiduals:
    """Return what a fit makes of the inputs, whose priors follow the first ``observed`` rows of every epoch."""
    epochs, height = len(whitened.problem.residual), observed + whitened.problem.local_value.shape[1]
    rows = np.s_[observed + inputs.start : observed + inputs.stop]
    rest = whitened.rest[: epochs * height].reshape(epochs, height)[:, rows]
    basis = whitened.basis[: epochs * height].reshape(epochs, height, -1)[:, rows]
    local = whitened.local_basis[:, rows]
    taken = local @ np.swapaxes(local, 1, 2) + basis @ np.swapaxes(basis, 1, 2)
    return InputResiduals(rest, np.eye(rest.shape[1]) - taken)


def drivers_of(candidates: Sequence[ScatterCandidate[CauseT]]) -> list[Driver]:
    """Return the candidates as what noise may follow: larger where they say, beside the same inputs elsewhere, or
    beside the others where it is all of an input."""
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
    """Return the candidate whose inputs scatter most clearly, and the p-value of any; None where p exceeds the level.

    Whether any do is asked of the logarithms of squares, which a few large ones do not sway; which do, of the
    likelihood that inputs have one variance here and another one elsewhere.
    """
    found = noise_dependence(residuals.standardised, drivers_of(candidates), level)
    if found is None:
        return None
    return likeliest(residuals, candidates), found.p_value


def likeliest(
    residuals: InputResiduals, candidates: Sequence[ScatterCandidate[CauseT]], factor: Array | float = 1.0
) -> ScatterCandidate[CauseT]:
    """Return the candidate with the largest likelihood of a variance of its own; inputs have prior sigmas that are
    larger by factors (B, H) in the fit."""
    square = (residuals.standardised[..., 0] * factor) ** 2
    return candidates[int(np.argmax([variance_gain(square, candidate.own) for candidate in candidates]))]


def nearby(
    candidates: Sequence[ScatterCandidate[CauseT]], candidate: ScatterCandidate[CauseT]
) -> list[ScatterCandidate[CauseT]]:
    """Return the candidate first, then those that have half of their inputs or more in common with it."""
    own = candidate.own
    return [candidate, *(one for one in candidates if 2 * (one.own & own).sum() >= (one.own | own).sum())]
