"""Prediction error of fitted models on held-out poses relative to the noise, and choice between models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Models within this factor of the best marginal likelihood count as equal.
INDISTINGUISHABLE = 20.0
# A model is refuted if its held-out misfit and its deficit to the best model are both less probable than this.
_UNLIKELY = 1e-3


def held_out_misfit(
    value: NDArray, by_deviation: NDArray, by_values: NDArray, noise: NDArray, known: NDArray
) -> NDArray:
    """Return the chi-square (B,) of each pose's equations, given measurement noise and parameter errors.

    by_deviation (B, M, N), by_values (B, M, P): derivatives; noise (B, N, N): covariance of the measurements; known (P,
    P): covariance of parameters from other poses. The expectation is M if the model is right.
    """
    spread = by_deviation @ noise @ np.swapaxes(by_deviation, -1, -2)
    spread = spread + by_values @ known @ np.swapaxes(by_values, -1, -2)
    return np.einsum("bm,bm->b", value, np.linalg.solve(spread, value[..., None])[..., 0])


@dataclass(frozen=True)
class Contender:
    """A fitted model: chi-square (B,) of each held-out pose with its freedom, one for all or (B,); log marginal
    likelihood; number of parameters; whether the fit converged."""

    squares: NDArray
    freedom: int | NDArray
    log_evidence: float
    parameters: int
    converged: bool = True


@dataclass(frozen=True)
class ContenderChoice:
    """Chosen contender, and the mask (N,) of others that the data cannot distinguish from it."""

    chosen: int
    indistinguishable: NDArray


def choose_model(contenders: Sequence[Contender]) -> ContenderChoice:
    """Return the choice: the most probable model that held-out poses do not refute; the simplest among equals.

    Simple means few parameters, then early in the given order. Raises ValueError without contenders.
    """
    if not contenders:
        raise ValueError("found no model to choose from, expected at least one")
    settled_state = np.array([contender.converged for contender in contenders])
    evidence = np.array([contender.log_evidence for contender in contenders])
    evidence = np.where(settled_state | ~settled_state.any(), evidence, np.nan)
    possible = np.array([not np.isinf(contender.squares).any() for contender in contenders])
    refuted = ~possible  # held-out poses are impossible under these models
    refuted[possible] = _refuted(
        [contender for contender, reported in zip(contenders, possible, strict=True) if reported]
    )
    eligible = ~refuted & np.isfinite(evidence)
    if not eligible.any():
        eligible = np.isfinite(evidence) | ~np.isfinite(evidence).any()
    best = np.max(evidence[eligible])
    equal = eligible & (evidence >= best - np.log(INDISTINGUISHABLE))
    chosen = min(np.flatnonzero(equal).tolist(), key=lambda i: (contenders[i].parameters, i))
    return ContenderChoice(chosen, equal & (np.arange(len(contenders)) != chosen))


def _refuted(contenders: Sequence[Contender]) -> NDArray:
    """Return the mask (N,) of models that miss held-out poses by more than the noise and by more than the best model,
    pose by pose. A model at the noise floor is not refuted by a slightly better one; if all models miss, only the
    comparison counts."""
    from scipy.special import chdtrc, stdtrit

    if not contenders:
        return np.zeros(0, bool)
    squares = np.array([contender.squares for contender in contenders])
    poses = squares.shape[1]
    if poses < 2:
        return np.zeros(len(contenders), bool)
    freedom = np.array([np.broadcast_to(contender.freedom, poses) for contender in contenders])
    missed = chdtrc(freedom.sum(1), squares.sum(1)) < _UNLIKELY
    # in the freedom of each pose, so that a pose with many equations does not dominate
    worse = (squares - squares[np.argmin(squares.mean(1))]) / freedom
    error = worse.std(1, ddof=1) / np.sqrt(poses)
    return np.asarray(missed & (worse.mean(1) > stdtrit(poses - 1, 1.0 - _UNLIKELY) * error))
