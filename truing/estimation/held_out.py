"""How well a fitted model predicts what was held out, against the noise, and which of several models to choose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Models within this factor of the best in marginal likelihood cannot be told from it.
INDISTINGUISHABLE = 20.0
# A model is out where it predicts worse than the best by more than this many standard errors, pose against pose.
_WORSE = 2.5


def held_out_misfit(
    value: NDArray, by_deviation: NDArray, by_values: NDArray, noise: NDArray, known: NDArray
) -> NDArray:
    """Return per pose the chi-square (B,) of equations (B, M) that hold but for noise and the parameters' errors.

    by_deviation (B, M, N), by_values (B, M, P): derivatives; noise (B, N, N): covariance of what was measured; known
    (P, P): covariance of parameters that the poses took no part in. M is its expectation where the model is right.
    """
    spread = by_deviation @ noise @ np.swapaxes(by_deviation, -1, -2)
    spread = spread + by_values @ known @ np.swapaxes(by_values, -1, -2)
    return np.einsum("bm,bm->b", value, np.linalg.solve(spread, value[..., None])[..., 0])


@dataclass(frozen=True)
class Contender:
    """A fitted model: chi-square (B,) of each held-out pose, log of its marginal likelihood, number of parameters."""

    squares: NDArray
    log_evidence: float
    parameters: int


@dataclass(frozen=True)
class Choice:
    """Which contender is chosen, and which others (N,) the data cannot tell from it."""

    chosen: int
    indistinguishable: NDArray


def choose_model(contenders: Sequence[Contender]) -> Choice:
    """Return the choice: of those that predict no worse than the best, the most probable, the simplest of equals.

    Simple means few parameters, then early in the given order. Raises ValueError without any contender.
    """
    if not contenders:
        raise ValueError("found no model to choose from, expected at least one")
    evidence = np.array([one.log_evidence for one in contenders])
    eligible = _predicting(contenders) & np.isfinite(evidence)
    if not eligible.any():
        eligible = np.isfinite(evidence) | ~np.isfinite(evidence).any()
    best = np.max(evidence[eligible])
    equal = eligible & (evidence >= best - np.log(INDISTINGUISHABLE))
    chosen = min(np.flatnonzero(equal).tolist(), key=lambda i: (contenders[i].parameters, i))
    return Choice(chosen, equal & (np.arange(len(contenders)) != chosen))


def _predicting(contenders: Sequence[Contender]) -> NDArray:
    """Return which (N,) predict held-out poses no worse than the one that predicts best."""
    squares = np.array([one.squares for one in contenders])
    if squares.shape[1] < 2:
        return np.ones(len(contenders), bool)
    best = squares[np.argmin(squares.mean(1))]
    worse = squares - best
    error = worse.std(1, ddof=1) / np.sqrt(worse.shape[1])
    return np.asarray(worse.mean(1) <= _WORSE * error)
