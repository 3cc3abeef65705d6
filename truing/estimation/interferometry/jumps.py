"""Jumps in series of readings, and jumps by whole quanta (slipped fringes)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from truing.arrays import Array, Index


@dataclass(frozen=True)
class Jump:
    """The likeliest jump in each of G series: sample after it, size, sigma, and p-value.

    p_value (G,): corrected for all onsets; left (G, N): residuals of the design with the jump removed.
    """

    onset: Index
    size: Array
    sigma: Array
    p_value: Array
    left: Array


def find_jump(values: Array, sigma: ArrayLike, design: Array, shortest: int = 2) -> Jump:
    """Return the likeliest jump in series (G, N), fitted together with a design (N, P) or (G, N, P).

    sigma: one number or (G, N). Every onset with ``shortest`` samples on either side is tried; Bonferroni over the
    onsets. NaN values are ignored.
    """
    from scipy.special import chdtrc

    values = np.atleast_2d(np.asarray(values, float))
    count, length = values.shape
    is_observed = np.isfinite(values)
    weight = np.where(is_observed, 1.0 / np.broadcast_to(np.asarray(sigma, float), values.shape), 0.0)
    white = weight * np.where(is_observed, values, 0.0)
    columns = weight[..., None] * np.broadcast_to(design, (count, length, np.shape(design)[-1]))
    basis, size, _ = np.linalg.svd(columns, full_matrices=False)
    basis = basis * (size > 1e-10 * size[:, :1])[:, None, :]
    after = np.tril(np.ones((length, length)))[:, 1:]  # column k: a jump before sample k + 1
    steps = weight[..., None] * after
    steps = steps - basis @ (np.swapaxes(basis, 1, 2) @ steps)
    residual = white - np.einsum("gnp,gp->gn", basis, np.einsum("gnp,gn->gp", basis, white))
    energy = np.sum(steps**2, axis=1)
    before = np.cumsum(is_observed, axis=1)[:, :-1]
    information = np.sum(weight[..., None] ** 2 * after, axis=1)
    open_ = (
        (before >= shortest) & (is_observed.sum(1, keepdims=True) - before >= shortest) & (energy > 1e-9 * information)
    )
    along = np.einsum("gnk,gn->gk", steps, residual)
    gain = np.where(open_, along**2 / np.where(open_, energy, 1.0), -1.0)
    best = gain.argmax(1)
    row = np.arange(count)
    mask = gain[row, best] >= 0.0
    size_at = np.where(mask, along[row, best] / np.where(mask, energy[row, best], 1.0), 0.0)
    spread = np.where(mask, 1.0 / np.sqrt(np.where(mask, energy[row, best], 1.0)), np.inf)
    p_value = np.minimum(1.0, open_.sum(1) * chdtrc(1, np.maximum(gain[row, best], 0.0)))
    left = residual - size_at[:, None] * steps[row, :, best]
    with np.errstate(divide="ignore", invalid="ignore"):
        left = np.where(is_observed, left / weight, np.nan)
    return Jump(best + 1, size_at, spread, np.where(mask, p_value, 1.0), left)


@dataclass(frozen=True)
class SlippedFringes:
    """Slipped fringes in each of G series: first sample after the slip, and number of quanta, zero without a slip.

    size and sigma (G,) of the likeliest jump; p_value (G,) of no jump; off (G,): distance of the jump from a whole
    number of quanta, in its sigmas; detectable (G,): smallest number of quanta found with probability one half.
    """

    onset: Index
    count: Index
    size: Array
    sigma: Array
    p_value: Array
    off: Array
    detectable: Array


def find_slips(
    values: Array, sigma: ArrayLike, design: Array, quantum: float, false_alarm: float = 0.01, largest_off: float = 3.0
) -> SlippedFringes:
    """Return jumps by a whole number of quanta (half a wavelength over the passes) in each series, as ``find_jump``.

    The count is zero without a jump at ``false_alarm`` per series, or if the jump is no whole number of quanta.
    """
    from scipy.special import ndtri

    jump = find_jump(values, sigma, design)
    nearest = np.round(jump.size / quantum).astype(np.int64)
    finite = np.isfinite(jump.sigma)
    off = np.where(finite, np.abs(jump.size - nearest * quantum) / np.where(finite, jump.sigma, 1.0), np.inf)
    real = (jump.p_value <= false_alarm) & (off <= largest_off)
    onsets = max(jump.left.shape[1] - 3, 1)
    limit = -ndtri(0.5 * false_alarm / onsets)
    detectable = np.ceil(np.where(finite, limit * jump.sigma / quantum, np.inf))
    return SlippedFringes(jump.onset, np.where(real, nearest, 0), jump.size, jump.sigma, jump.p_value, off, detectable)
