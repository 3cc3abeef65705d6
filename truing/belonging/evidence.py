"""Evidence of a hypothesis on data with roughly known physics and unknown noise level."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.arrays import Array

# Noise levels tried, as shares of the span of their logarithms, in which the evidence is smooth.
_SHARES = np.linspace(0.0, 1.0, 48)


@dataclass(frozen=True)
class Physics:
    """Effects that a model may lack, as columns scaled by one prior standard deviation, in factored form.

    ``left`` (N, K) orthonormal, ``size`` (K,) singular values of the scaled columns, in units of the data.
    """

    left: Array
    size: Array


def physics(columns: Array) -> Physics:
    """Return effects (N, K), each column scaled by one standard deviation of its coefficient, in factored form."""
    return physics_of_each(columns[None])[0]


def physics_of_each(columns: Array) -> list[Physics]:
    """Return the effects (L, N, K) on each of L quantities, scaled in the same way, in factored form."""
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    is_observable = size > 1e-12 * np.maximum(size.max(-1, initial=0.0), 1e-300)[:, None]
    return [Physics(left[n][:, own], size[n][own]) for n, own in enumerate(is_observable)]


def log_evidence(misfit: Array, known: Physics, floor: float, ceiling: float = np.inf) -> Array:
    """Return the log marginal likelihood of misfits (..., N) with known physics and white noise of unknown level.

    The noise level is the most likely one between ``floor`` and ``ceiling`` (unit of the misfit, positive). Constants
    are kept, so evidences of hypotheses about the same N numbers are comparable.
    """
    explained = misfit @ known.left
    squares = np.sum(misfit**2, -1)
    rest = np.maximum(squares - np.sum(explained**2, -1), 0.0)
    count, free = misfit.shape[-1], misfit.shape[-1] - len(known.size)
    top = max(float(np.sqrt(squares.max(initial=0.0) / max(count, 1))), floor) * 2.0
    levels = floor * (min(max(top, 2.0 * floor), ceiling) / floor) ** _SHARES  # as geomspace, without checks
    variance = known.size[:, None] ** 2 + levels**2  # (K, levels)
    fixed = -0.5 * (np.log(variance).sum(0) + 2.0 * free * np.log(levels) + count * np.log(2.0 * np.pi))
    spent = explained**2 @ (1.0 / variance) + rest[..., None] / levels**2
    return np.asarray((fixed - 0.5 * spent).max(-1))
