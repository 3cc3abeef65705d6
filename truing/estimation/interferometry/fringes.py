"""From phase to length: fringes counted, steps that a count may have got wrong, and fringes slipped in a log."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_TURN = 2.0 * np.pi


@dataclass(frozen=True)
class Count:
    """Phases (..., N) followed through whole turns, in rad.

    risk (..., N): the probability that the step to a sample, and so everything after it, is a turn off, if the motion
    itself stays below half a turn.
    """

    phase: Array
    risk: Array

    @property
    def doubtful(self) -> Mask:
        """(..., N) steps of which more than one in a thousand such is wrong."""
        return self.risk > 1e-3


def count_fringes(phase: ArrayLike, sigma: ArrayLike, *, steady: bool = False) -> Count:
    """Follow phases (..., N), known within a turn to sigma rad (..., N) or one number, through whole turns.

    Each step is taken as the shortest one; where ``steady``, as the one nearest to the step before, so that
    motion of more than half a turn a sample is followed while its speed changes by less than that. A sample that is
    missing (NaN) loses the count: what follows is missing too.
    """
    phase = np.asarray(phase, float)
    sigma = np.broadcast_to(np.asarray(sigma, float), phase.shape)
    step = _nearest(np.diff(phase, axis=-1))
    noise = np.hypot(sigma[..., 1:], sigma[..., :-1])
    left = step
    if steady:  # the changes of the step are followed like a phase, and their sum is the step
        left = np.concatenate([step[..., :1], _nearest(np.diff(step, axis=-1))], axis=-1)
        step = np.cumsum(left, axis=-1)
        noise = _noise_of_changes(sigma)
    risk = _risk(left, noise)
    followed = np.concatenate([phase[..., :1], phase[..., :1] + np.cumsum(step, axis=-1)], axis=-1)
    return Count(followed, np.concatenate([np.zeros_like(phase[..., :1]), risk], axis=-1))


def _nearest(step: Array) -> Array:
    """Steps less the whole turns in them: from -pi to pi."""
    return step - _TURN * np.round(step / _TURN)


def _noise_of_changes(sigma: Array) -> Array:
    """Standard deviation (..., N - 1) of the change from one step to the next; of the first step, its own."""
    first = np.hypot(sigma[..., 1:2], sigma[..., :1])
    later = np.sqrt(sigma[..., 2:] ** 2 + 4.0 * sigma[..., 1:-1] ** 2 + sigma[..., :-2] ** 2)
    return np.concatenate([first, later], axis=-1)


def _risk(left: Array, noise: Array) -> Array:
    """Probability that noise took a step over half a turn, so that it was found as ``left``: all true steps up to half
    a turn being as likely."""
    from scipy.special import ndtr

    with np.errstate(divide="ignore", invalid="ignore"):
        room = (np.pi - np.abs(left)) / noise
    return np.asarray(ndtr(-np.where(np.isnan(room), 0.0, room)))


def misstep_probability(step: ArrayLike, sigma: ArrayLike) -> Array:
    """Return the probability that a true step in rad is counted wrong, sigma rad the noise of each phase."""
    from scipy.special import ndtr

    step, noise = np.asarray(step, float), np.sqrt(2.0) * np.asarray(sigma, float)
    return np.asarray(ndtr((step - np.pi) / noise) + ndtr((-step - np.pi) / noise))


def length_per_turn(wavelength_m: ArrayLike, index: ArrayLike = 1.0, passes: int = 2) -> Array:
    """Return the length in m that a turn of phase stands for.

    Light goes the way to the mirror ``passes`` times, back and forth: 2 for a plain interferometer, 4 for one with
    plane mirrors.
    """
    return np.asarray(wavelength_m, float) / np.asarray(index, float) / passes


def length_from_phase(phase: ArrayLike, wavelength_m: ArrayLike, index: ArrayLike = 1.0, passes: int = 2) -> Array:
    """Return lengths in m of followed phases in rad, the index of air being that of each sample."""
    return np.asarray(phase, float) / _TURN * length_per_turn(wavelength_m, index, passes)


@dataclass(frozen=True)
class Jump:
    """The likeliest jump in each of G series: before which sample, how large, its sigma, and the p-value.

    p_value (G,): over all onsets; left (G, N): what the design does not explain, with the jump taken out.
    """

    onset: NDArray[np.int64]
    size: Array
    sigma: Array
    p_value: Array
    left: Array


def find_jump(values: Array, sigma: ArrayLike, design: Array, shortest: int = 2) -> Jump:
    """Find the likeliest jump in series (G, N), beside the columns of a design (N, P) or (G, N, P) that each follows.

    sigma one number or (G, N). The jump is fitted together with the design at every onset that leaves
    ``shortest`` samples on either side; Bonferroni over the onsets. NaN values take no part.
    """
    from scipy.special import chdtrc

    values = np.atleast_2d(np.asarray(values, float))
    count, length = values.shape
    seen = np.isfinite(values)
    weight = np.where(seen, 1.0 / np.broadcast_to(np.asarray(sigma, float), values.shape), 0.0)
    white = weight * np.where(seen, values, 0.0)
    columns = weight[..., None] * np.broadcast_to(design, (count, length, np.shape(design)[-1]))
    basis, size, _ = np.linalg.svd(columns, full_matrices=False)
    basis = basis * (size > 1e-10 * size[:, :1])[:, None, :]
    after = np.tril(np.ones((length, length)))[:, 1:]  # column k: a jump before sample k + 1
    steps = weight[..., None] * after
    steps = steps - basis @ (np.swapaxes(basis, 1, 2) @ steps)
    residual = white - np.einsum("gnp,gp->gn", basis, np.einsum("gnp,gn->gp", basis, white))
    energy = np.sum(steps**2, axis=1)
    before = np.cumsum(seen, axis=1)[:, :-1]
    whole = np.sum(weight[..., None] ** 2 * after, axis=1)
    open_ = (before >= shortest) & (seen.sum(1, keepdims=True) - before >= shortest) & (energy > 1e-9 * whole)
    along = np.einsum("gnk,gn->gk", steps, residual)
    gain = np.where(open_, along**2 / np.where(open_, energy, 1.0), -1.0)
    best = gain.argmax(1)
    row = np.arange(count)
    found = gain[row, best] >= 0.0
    size_at = np.where(found, along[row, best] / np.where(found, energy[row, best], 1.0), 0.0)
    spread = np.where(found, 1.0 / np.sqrt(np.where(found, energy[row, best], 1.0)), np.inf)
    p_value = np.minimum(1.0, open_.sum(1) * chdtrc(1, np.maximum(gain[row, best], 0.0)))
    left = residual - size_at[:, None] * steps[row, :, best]
    with np.errstate(divide="ignore", invalid="ignore"):
        left = np.where(seen, left / weight, np.nan)
    return Jump(best + 1, size_at, spread, np.where(found, p_value, 1.0), left)


@dataclass(frozen=True)
class Slip:
    """Fringes slipped in each of G series: from which sample on, and how many quanta; zero where none did.

    size and sigma (G,) of the likeliest jump; p_value (G,) of there being no jump at all; off (G,): how far the jump is
    from a whole number of quanta, in its sigmas; detectable (G,): the fewest quanta that would be found in half of
    such series.
    """

    onset: NDArray[np.int64]
    count: NDArray[np.int64]
    size: Array
    sigma: Array
    p_value: Array
    off: Array
    detectable: Array


def find_slips(
    values: Array, sigma: ArrayLike, design: Array, quantum: float, false_alarm: float = 0.01, largest_off: float = 3.0
) -> Slip:
    """Find a jump by a whole number of quanta (half a wavelength over the passes) in each series, as ``find_jump``.

    The count is zero where there is no jump at ``false_alarm`` per series, or one that is no whole number.
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
    return Slip(jump.onset, np.where(real, nearest, 0), jump.size, jump.sigma, jump.p_value, off, detectable)
