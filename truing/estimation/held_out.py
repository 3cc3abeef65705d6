"""How well a fitted model predicts what was held out, against the noise, and which of several models to choose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Models within this factor of the best in marginal likelihood cannot be told from it.
INDISTINGUISHABLE = 20.0
# A model is out where its held-out misfit, and its being worse than the best, are both less likely than this.
_UNLIKELY = 1e-3


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
    """A fitted model: chi-square (B,) of each held-out pose and its freedom, one for all or (B,), log of the marginal
    likelihood, number of parameters, and whether the fit has settled."""

    squares: NDArray
    freedom: int | NDArray
    log_evidence: float
    parameters: int
    converged: bool = True


@dataclass(frozen=True)
class ContenderChoice:
    """Which contender is chosen, and which others (N,) the data cannot tell from it."""

    chosen: int
    indistinguishable: NDArray


def choose_model(contenders: Sequence[Contender]) -> ContenderChoice:
    """Return the choice: of those that held-out poses do not refute, the most probable, the simplest of equals.

    Simple means few parameters, then early in the given order. Raises ValueError without any contender.
    """
    if not contenders:
        raise ValueError("found no model to choose from, expected at least one")
    settled_state = np.array([one.converged for one in contenders])
    evidence = np.array([one.log_evidence for one in contenders])
    evidence = np.where(settled_state | ~settled_state.any(), evidence, np.nan)
    possible = np.array([not np.isinf(one.squares).any() for one in contenders])
    refuted = ~possible  # a model to which what was held out is impossible
    refuted[possible] = _refuted([one for one, reported in zip(contenders, possible, strict=True) if reported])
    eligible = ~refuted & np.isfinite(evidence)
    if not eligible.any():
        eligible = np.isfinite(evidence) | ~np.isfinite(evidence).any()
    best = np.max(evidence[eligible])
    equal = eligible & (evidence >= best - np.log(INDISTINGUISHABLE))
    chosen = min(np.flatnonzero(equal).tolist(), key=lambda i: (contenders[i].parameters, i))
    return ContenderChoice(chosen, equal & (np.arange(len(contenders)) != chosen))


def _refuted(contenders: Sequence[Contender]) -> NDArray:
    """Return which (N,) miss held-out poses by more than the noise, and are worse at it than the best, pose by pose.

    A model at the noise floor is not refuted by another that happens to lie a little lower; where all miss it, because
    something else is wrong, only the comparison is left.
    """
    from scipy.special import chdtrc, stdtrit

    if not contenders:
        return np.zeros(0, bool)
    squares = np.array([one.squares for one in contenders])
    poses = squares.shape[1]
    if poses < 2:
        return np.zeros(len(contenders), bool)
    freedom = np.array([np.broadcast_to(one.freedom, poses) for one in contenders])
    missed = chdtrc(freedom.sum(1), squares.sum(1)) < _UNLIKELY
    # counted in each pose's own freedom, so that a pose with many equations does not hide the others
    worse = (squares - squares[np.argmin(squares.mean(1))]) / freedom
    error = worse.std(1, ddof=1) / np.sqrt(poses)
    return np.asarray(missed & (worse.mean(1) > stdtrit(poses - 1, 1.0 - _UNLIKELY) * error))
