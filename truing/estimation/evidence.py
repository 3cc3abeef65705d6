"""Which of several candidate effects the residual of a whitened problem speaks for, and how sure that is.

A candidate is a set of columns, its signature, scaled so that its parameters are plausibly of size one. The statistic
is the smallest p-value over the candidates; its null distribution comes from simulated residuals and from sign-flipped
ones, both pushed through the same search. The noise level is estimated, with the declared one as prior.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truing.estimation.whitening import Whitened

# How many observations the declared noise level counts for: known to about 10 %.
NOISE_PRIOR_FREEDOM = 50.0
# Directions in which a plausible effect stays below this many sigma carry no test.
_INFORMATIVE = 0.3
_FLIP_BLOCK = 256
# Effects may be this many times as large as plausible, all equally likely beforehand.
SIZES = (3.0, 1.0, 1 / 3, 1 / 10, 1 / 30)


@dataclass(frozen=True)
class Signature:
    """A candidate's signature after projection: orthonormal directions (N, r), strengths (r,), parameters' side (P, r).

    A strength is the signal-to-noise ratio of a plausible effect along its direction.
    """

    directions: NDArray
    strengths: NDArray
    loadings: NDArray


@dataclass(frozen=True)
class Score:
    """What the data say of one candidate."""

    p_value: float  # against the model without it, corrected for all candidates tried
    log_evidence: float  # marginal likelihood over that of the model without it
    freedom: int  # independent directions that the campaign sees of it
    signal_to_noise: float  # root of the reduction of the sum of squares
    detectable: float | None = None  # size, in plausible scales, that would be found with 80 % probability


def project(whitened: Whitened, columns: NDArray) -> Signature:
    """Return the signature of whitened columns (B, M, P) after all unknowns were projected out."""
    rest = whitened.without_shared(whitened.lifted(columns))
    directions, strengths, loadings = np.linalg.svd(rest, full_matrices=False)
    kept = strengths > _INFORMATIVE
    return Signature(directions[:, kept], strengths[kept], loadings[kept].T)


@dataclass(frozen=True)
class Search:
    """The search over all candidates on one residual."""

    whitened: Whitened
    signatures: Mapping[str, Signature]
    draws: int
    rng: np.random.Generator

    @cached_property
    def _joint(self) -> NDArray:
        """Return an orthonormal basis (N, r) of all signatures together."""
        everything = np.concatenate([found.directions for found in self.signatures.values()], 1)
        directions, strengths, _ = np.linalg.svd(everything, full_matrices=False)
        return directions[:, strengths > 1e-6]

    @cached_property
    def _shares(self) -> dict[str, NDArray]:
        return {name: self._joint.T @ found.directions for name, found in self.signatures.items()}

    def scores(self) -> dict[str, Score]:
        """Return every candidate's score; one that the campaign cannot see has p-value 1 and evidence 1."""
        rest, freedom = self.whitened.rest, self.whitened.freedom
        total = float(rest @ rest)
        along = (self._joint.T @ rest)[None]
        single = self._p_values(along, np.array([total]), freedom)
        smallest = self._null_minima()
        return {
            name: Score(
                _corrected(single[name][0] * len(self.signatures), smallest),
                float(log_evidence(found.directions.T @ rest, found.strengths, total, freedom)),
                len(found.strengths),
                float(np.linalg.norm(found.directions.T @ rest)),
            )
            for name, found in self.signatures.items()
        }

    def _p_values(self, along: NDArray, total: NDArray, freedom: float) -> dict[str, NDArray]:
        """Return each candidate's F test for residuals given by their parts along the joint basis (D, r)."""
        from scipy.special import fdtrc

        found = {}
        for name, share in self._shares.items():
            count = share.shape[1]
            if count == 0:
                found[name] = np.ones(len(along))
                continue
            squares = np.sum((along @ share) ** 2, -1)
            left = freedom + NOISE_PRIOR_FREEDOM - count
            noise = (NOISE_PRIOR_FREEDOM + np.maximum(total - squares, 0.0)) / left
            found[name] = fdtrc(count, left, squares / count / noise)
        return found

    def _null_minima(self) -> tuple[NDArray, NDArray]:
        """Return the smallest p-values, times the number of candidates, of drawn and of flipped residuals."""
        freedom, size = self.whitened.freedom, self._joint.shape[1]
        drawn = self.rng.standard_normal((self.draws, size))
        total = np.sum(drawn**2, -1) + self.rng.chisquare(max(freedom - size, 1.0), self.draws)
        flipped, level = self._flipped()
        return (
            self._minimum(drawn, total, freedom),
            self._minimum(flipped, np.full(len(flipped), level * freedom), freedom),
        )

    def _minimum(self, along: NDArray, total: NDArray, freedom: float) -> NDArray:
        tested = self._p_values(along, total, freedom)
        return np.min(np.stack(list(tested.values())), 0) * len(self.signatures)

    def _flipped(self) -> tuple[NDArray, float]:
        """Return sign-flipped standardised residuals' parts along the joint basis (D, r), and their mean square.

        The candidates' own best fit is taken out first, so that an effect does not widen its own null distribution.
        """
        rest = self.whitened.rest - self._joint @ (self._joint.T @ self.whitened.rest)
        leverage = self.whitened.leverage + np.sum(self._joint**2, -1)
        standard = np.where(leverage < 0.999, rest / np.sqrt(np.maximum(1.0 - leverage, 1e-3)), 0.0)
        weighted = self._joint * standard[:, None]
        blocks = []
        for start in range(0, self.draws, _FLIP_BLOCK):
            count = min(_FLIP_BLOCK, self.draws - start)
            blocks.append(_signs(self.rng, count, len(standard)) @ weighted)
        level = float(rest @ rest) / max(self.whitened.freedom - self._joint.shape[1], 1.0)
        return np.concatenate(blocks), level


def log_evidence(along: NDArray, strengths: NDArray, total: NDArray | float, freedom: float) -> NDArray:
    """Return the log ratio of marginal likelihoods with and without an effect; parameters N(0, size^2).

    ``along`` (..., r) are a residual's parts along a signature of strengths (r,), ``total`` (...) its squares.
    The size is shared by the parameters and marginalised over `SIZES`, so that the answer hangs on no one scale; the
    noise level is free.
    """
    power = np.multiply.outer(np.square(SIZES), strengths**2)
    before = NOISE_PRIOR_FREEDOM + np.asarray(total)[..., None]
    after = before - np.square(along) @ (power / (1.0 + power)).T
    weight = (freedom + NOISE_PRIOR_FREEDOM) / 2.0
    logs = -0.5 * np.sum(np.log1p(power), -1) - weight * np.log(after / before)
    largest = logs.max(-1, keepdims=True)
    return np.asarray(largest[..., 0] + np.log(np.mean(np.exp(logs - largest), -1)))


def _signs(rng: np.random.Generator, count: int, size: int) -> NDArray:
    bits = np.unpackbits(rng.integers(0, 256, (count, (size + 7) // 8), np.uint8), axis=1, count=size)
    return bits.astype(np.float64) * 2.0 - 1.0


def _corrected(smallest: float, null: tuple[NDArray, NDArray]) -> float:
    """Return the larger share of null searches that look as good; drawn ones beyond their reach by the union bound."""
    drawn, flipped = (float((1 + np.sum(minima <= smallest)) / (1 + len(minima))) for minima in null)
    if np.all(null[0] > smallest):
        drawn = min(drawn, smallest)
    return float(min(1.0, max(drawn, flipped)))


def probabilities(log_evidence: Mapping[str, float]) -> dict[str, float]:
    """Return the probability of each candidate, and of none of them, all equally likely beforehand."""
    values = np.array([0.0, *log_evidence.values()])
    weights = np.exp(values - values.max())
    return dict(zip(log_evidence, (float(w) for w in weights[1:] / weights.sum()), strict=True))
