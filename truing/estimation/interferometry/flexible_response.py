"""Residuals of a channel after removing everything that follows loads, load history or time.

The only assumption is equal response to equal loads with equal history. The response to each axis, its asymmetry,
curve, hysteresis, play and creep are free, and so are zero and drift of every run. The residuals are instrument noise,
jumps and gross errors.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from truing.arrays import Array, Index, Mask

_CREEP_PACES = (2.0, 10.0)  # time constants in steps: faster or slower creep is covered by these or by the drift
_MOST_COLUMNS = 0.6  # share of the readings
_GROSS = 6.0
_NORMAL_MEDIAN = 0.6745
_ROUNDS, _L1_ROUNDS = 3, 15
_SHORTEST = 6  # rows of a run in which a jump is searched
_MOST_JUMPS = 10  # per channel
_FEWEST = 3  # readings on either side of a jump
_JUMP, _BEYOND_ONE = 1e-4, 1.5
_LITTLE = 1e-6
_CLOSE = 0.1  # sigmas: smaller residuals gain no more weight
_OPEN = 1e-9  # share of the largest eigenvalue below which one is zero
_LOST = 1e-6


@dataclass(frozen=True)
class ChannelFit:
    """N readings of a channel with all allowed effects removed.

    residual (N,), sigma (N,) including uncertain loads; kept (N,): without gross errors; ``dof``: freedom corrected for
    leverage; drift, drift_sigma (R,): of each run over its duration, NaN if undetermined; jump_row (R,): row before
    which a run jumps (-1: none), jump_size and jump_p (R,).
    """

    residual: Array
    sigma: Array
    kept: Mask
    dof: int
    drift: Array
    drift_sigma: Array
    jump_row: Index
    jump_size: Array
    jump_p: Array

    @property
    def chi_square(self) -> float:
        """Sum of squares of the kept residuals, in units of sigma."""
        return float(np.sum((self.residual[self.kept] / self.sigma[self.kept]) ** 2))


def response_columns(load: Array, run: Index, time_s: Array, surroundings: Array) -> list[Array]:
    """Return groups of columns (N, P) that readings may follow, the most important first.

    load (N, 6), run (N,), surroundings (N, C), all in the order of time within runs.
    """
    largest = np.abs(load).max(axis=0, initial=0.0)
    share = load[:, largest > 0.0] / largest[largest > 0.0]
    size, sign = np.abs(share), np.sign(share)
    way = _unloading(size, run)
    pauses = np.diff(time_s)[np.diff(run) == 0]
    pace = float(np.median(pauses)) if len(pauses) else 1.0
    since = np.column_stack([_since_start(column, run) for column in surroundings.T] or [np.zeros((len(run), 0))])
    creeping = [_lagged(share, run, time_s, paces * pace) for paces in _CREEP_PACES] if pace > 0.0 else []
    back = np.column_stack([way * share, way * share * size])  # spans F (F_max - F) for any F_max
    return [share, since, size, share * size**2, back, sign, *creeping]


def _runs(run: Index) -> Iterator[Index]:
    return iter(np.split(np.arange(len(run)), np.flatnonzero(np.diff(run)) + 1)) if len(run) else iter(())


def _unloading(size: Array, run: Index) -> Array:
    """Return 1 where loads of sizes (N, A) are decreasing, else 0: smaller than at the step before, or held since
    then."""
    change = np.sign(np.diff(size, axis=0, prepend=size[:1]))
    change[np.flatnonzero(np.diff(run)) + 1] = 1.0  # a new run starts
    change[:1] = 1.0
    step = np.arange(len(size))[:, None]
    last = np.maximum.accumulate(np.where(change != 0.0, step, 0), axis=0)
    return (np.take_along_axis(change, last, axis=0) < 0.0).astype(float)


def _since_start(values: Array, run: Index) -> Array:
    """Return values (N,) minus the first known one of their run; zero if unknown."""
    out = np.zeros(len(values))
    for rows in _runs(run):
        known = rows[np.isfinite(values[rows])]
        if len(known):
            out[known] = values[known] - values[known[0]]
    return out


def _lagged(share: Array, run: Index, time_s: Array, tau: float) -> Array:
    """Return loads (N, A) filtered with a time constant, each held until its reading."""
    elapsed = np.maximum(np.diff(time_s, prepend=time_s[:1]), 0.0)  # at the start of a run, time may go back
    fraction = 1.0 - np.exp(-elapsed / tau)
    out = np.zeros(share.shape)
    for n in range(1, len(share)):
        if run[n] == run[n - 1]:
            out[n] = out[n - 1] + fraction[n] * (share[n] - out[n - 1])
    return out


def fitted_columns(groups: list[Array], run: Index, time_s: Array) -> Array:
    """Return all columns (N, P) that `fit_channel` removes: the affordable groups, a zero and a drift of each run."""
    frame = run_frame(run, time_s)
    count = len(frame.starts)
    of_runs = (run[:, None] == np.arange(count)).astype(float)
    shared = _affordable(groups, len(run) - 2 * count, len(run))
    return np.column_stack([shared, of_runs, of_runs * frame.way[:, None]])


def fit_channel(
    reading: Array, sigma: Array, groups: list[Array], run: Index, time_s: Array, load: Array, load_sigma: Array
) -> ChannelFit:
    """Return the fit of readings (N,) by groups of columns (N, P); run (N,) from 0, load (N, 6) with its standard
    deviation (6,).

    sigma (N,): NaN if not declared, then estimated from the scatter of the readings. Single readings beyond six sigmas
    are excluded, and a run with a jump gets a step, found in the residuals.
    """
    frame = run_frame(run, time_s)
    count = len(frame.starts)
    shared = _affordable(groups, len(reading) - 2 * count, len(reading))
    of_loads = _load_noise(reading, frame, load, load_sigma)
    noise = np.where(np.isfinite(sigma), np.hypot(sigma, of_loads), 1.0)
    is_jump = np.zeros(count, dtype=bool)
    jumps = _Jumps(np.full(count, -1), np.zeros(count), np.zeros(count), np.ones(count))
    for _ in range(_MOST_JUMPS + 1):  # the clearest first: it disturbs the residuals of other runs with its load
        residual, scale = _robust(frame, shared, reading, noise)
        single = _single_outliers(np.abs(residual) > _GROSS * scale * noise)
        now = _jumps(frame, shared, reading, scale * noise, ~single)
        jumps = _Jumps(*(np.where(is_jump, old, new) for old, new in zip(jumps, now, strict=True)))
        clear = np.where(~is_jump & (now.p_value < _JUMP), now.gain, 0.0)
        worst = int(clear.argmax())
        if clear[worst] == 0.0:
            break
        is_jump[worst] = True
        step = (np.arange(len(run)) >= jumps.row[worst]) & (run == worst)
        shared = np.column_stack([shared, step.astype(float)])
    mask = np.abs(residual) <= _GROSS * scale * noise
    for _ in range(_ROUNDS):
        fit = fit_within_runs(frame, shared, reading, noise, mask)
        noise = np.where(np.isfinite(sigma), np.hypot(sigma, of_loads), _scale(fit.residual, mask, fit.dof))
        inflation = len(reading) / max(fit.dof, 1)
        mask = np.abs(fit.residual) <= _GROSS * np.maximum(noise, _spread(fit.residual, inflation))
    fit = fit_within_runs(frame, shared, reading, noise, mask)
    return ChannelFit(
        fit.residual, noise, mask, fit.dof, fit.drift, fit.drift_sigma, jumps.row, jumps.size, jumps.p_value
    )


def _affordable(groups: list[Array], most: int, count: int) -> Array:
    """Return the first groups of columns (N, P) that leave enough readings for a test."""
    affordable = [np.zeros((count, 0))]
    for group in groups:
        moving = group[:, np.ptp(group, axis=0) > 0.0] if len(group) else group
        if sum(one.shape[1] for one in affordable) + moving.shape[1] > min(most, _MOST_COLUMNS * count):
            break
        affordable.append(moving)
    return np.column_stack(affordable)


def _robust(frame: RunFrame, shared: Array, reading: Array, noise: Array) -> tuple[Array, float]:
    """Return residuals (N,) of a robust fit (least absolute deviations, by reweighting), and their scatter over the
    noise, at least 1."""
    weight, everything = np.ones(len(reading)), np.ones(len(reading), dtype=bool)
    for _ in range(_L1_ROUNDS):
        fit = fit_within_runs(frame, shared, reading, noise / np.sqrt(weight), everything)
        scale = _spread(fit.residual / noise, len(reading) / max(fit.dof, 1))
        weight = 1.0 / np.maximum(np.abs(fit.residual) / noise / max(scale, _CLOSE), _CLOSE)
    return fit.residual, max(scale, 1.0)


def _scale(residual: Array, mask: Mask, dof: int) -> float:
    """Return the noise of the residuals, if none is declared."""
    scatter = float(np.sqrt(np.sum(residual[mask] ** 2) / max(dof, 1)))
    return scatter if scatter > 0.0 else 1.0


def _load_noise(reading: Array, frame: RunFrame, load: Array, load_sigma: Array) -> Array:
    """Return the noise (N,) of readings due to uncertain loads (6,), by a linear response; zero without load."""
    loaded = np.ptp(load, axis=0) > 0.0
    if not loaded.any() or not load_sigma.any():
        return np.zeros(len(load))
    about = np.column_stack([reading, load[:, loaded]])
    about = about - (frame.sums(about) / np.bincount(frame.run)[:, None])[frame.run]
    slope = np.linalg.lstsq(about[:, 1:], about[:, 0], rcond=None)[0]
    return np.sqrt(np.sum((load[:, loaded] != 0.0) * (slope * load_sigma[loaded]) ** 2, axis=1))


def _spread(residual: Array, inflation: float) -> float:
    """Return the robust standard deviation of residuals, corrected for the freedom of the fit."""
    return float(np.median(np.abs(residual)) / _NORMAL_MEDIAN * np.sqrt(inflation))


def _single_outliers(far: Mask) -> Mask:
    """Return the mask of single outlying readings, with normal ones before and after: gross errors, not a jump."""
    beside = np.zeros(len(far), dtype=bool)
    beside[1:] |= far[:-1]
    beside[:-1] |= far[1:]
    return far & ~beside


class _Jumps(NamedTuple):
    """Likeliest jump of each run (R,): row after it, size, decrease of chi-square, and p-value."""

    row: Index
    size: Array
    gain: Array
    p_value: Array


def _jumps(frame: RunFrame, shared: Array, reading: Array, noise: Array, mask: Mask) -> _Jumps:
    """Return the likeliest jumps; row -1 if a run is too short. A step at every row is tested by its gain in the joint
    fit of all runs. If excluding a single reading gains nearly as much, it is no jump."""
    from scipy.special import chdtrc

    residual = fit_within_runs(frame, shared, reading, noise, mask).residual
    root = mask / noise
    runs = np.split(np.arange(len(reading)), frame.starts[1:])
    bases = [
        np.linalg.qr(root[rows, None] * np.column_stack([np.ones(len(rows)), frame.way[rows]]))[0] for rows in runs
    ]
    whites = [
        _without_projection(basis, root[rows, None] * shared[rows]) for basis, rows in zip(bases, runs, strict=True)
    ]
    normal = sum((white.T @ white for white in whites), np.zeros((shared.shape[1], shared.shape[1])))
    inverse = np.asarray(np.linalg.pinv(normal, rcond=_OPEN, hermitian=True), np.float64)
    jumps = _Jumps(np.full(len(runs), -1), np.zeros(len(runs)), np.zeros(len(runs)), np.ones(len(runs)))
    for here, (rows, basis, white) in enumerate(zip(runs, bases, whites, strict=True)):
        if len(rows) < _SHORTEST:
            continue
        left, steps = root[rows] * residual[rows], root[rows]
        # the product with a step before row k + 1 is the sum from there on
        parts = (steps**2, left * steps, basis * steps[:, None], white * steps[:, None])
        squares, products, by_basis, by_shared = (np.cumsum(part[::-1], axis=0)[::-1][1:] for part in parts)
        gain = _chi_square_gain(squares - np.sum(by_basis**2, axis=1), products, by_shared, inverse)
        before = np.cumsum(mask[rows])[:-1]
        gain = np.where((before >= _FEWEST) & (mask[rows].sum() - before >= _FEWEST), gain, 0.0)
        best = int(gain.argmax())
        jumps.row[here], jumps.gain[here] = rows[best + 1], gain[best]
        jumps.size[here] = gain[best] / products[best] if gain[best] > 0.0 else 0.0
        if gain[best] > _BEYOND_ONE * _chi_square_gain(1.0 - np.sum(basis**2, axis=1), left, white, inverse).max():
            jumps.p_value[here] = min(1.0, np.count_nonzero(gain) * float(chdtrc(1, gain[best])))
    return jumps


def _without_projection(basis: Array, columns: Array) -> Array:
    """Return columns (N, K) minus their projection on a basis (N, 2) of orthonormal columns."""
    return columns - basis @ (basis.T @ columns)


def _chi_square_gain(squares: Array, products: Array, by_shared: Array, inverse: Array) -> Array:
    """Return the decrease of chi-square by each of K columns: from its square (K,) within its run and its product (K,)
    with the residuals. Products (K, P) are with the shared columns, whose normal matrix over all runs has the given
    inverse."""
    energy = squares - np.sum((by_shared @ inverse) * by_shared, axis=1)
    reported = energy > _LITTLE * np.maximum(squares, np.finfo(float).tiny)
    return np.where(reported, products**2 / np.where(reported, energy, 1.0), 0.0)


@dataclass(frozen=True)
class RunFrame:
    """Rows (N,) of consecutive runs: start of each run (R,), and relative time (N,) within the run from -1/2 to 1/2."""

    starts: Index
    run: Index
    way: Array

    def sums(self, values: Array) -> Array:
        """Return the sums over each run (R, ...) of values (N, ...)."""
        return np.add.reduceat(values, self.starts, axis=0)


@dataclass(frozen=True)
class WithinRuns:
    """Residuals (N,), their freedom, and the drift (R,) of each run over its duration with its standard deviation.

    The standard deviation is infinite if the drift cannot be separated from shared columns; both are NaN for a run
    without duration.
    """

    residual: Array
    dof: int
    drift: Array
    drift_sigma: Array


def run_frame(run: Index, time_s: Array) -> RunFrame:
    """Return the frame of rows whose run (N,) counts up from 0, in the order of time."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(run)) + 1])
    ends = np.concatenate([starts[1:], [len(run)]]) - 1
    length = (time_s[ends] - time_s[starts])[run]
    progress = np.where(length > 0.0, (time_s - time_s[starts][run]) / np.where(length > 0.0, length, 1.0) - 0.5, 0.0)
    return RunFrame(starts, run, progress)


def fit_within_runs(frame: RunFrame, shared: Array, reading: Array, noise: Array, mask: Mask) -> WithinRuns:
    """Return the fit of readings (N,) by a zero and a drift per run and columns (N, P) shared by all runs; noise (N,).

    Linearly dependent columns are left out.
    """
    weight = mask / noise**2
    mass = frame.sums(weight)
    middle = frame.sums(weight * frame.way) / np.where(mass > 0.0, mass, 1.0)
    progress = frame.way - middle[frame.run]
    spread = frame.sums(weight * progress**2)
    moving = spread > _OPEN * np.maximum(mass, np.finfo(float).tiny)
    safe_mass, safe_spread = np.where(mass > 0.0, mass, 1.0), np.where(moving, spread, 1.0)

    def about(values: Array) -> tuple[Array, Array]:
        """Return values (N, ...) minus their zero and drift in each run, and that drift (R, ...)."""
        tall = (slice(None),) + (None,) * (values.ndim - 1)
        zero = frame.sums(weight[tall] * values) / safe_mass[tall]
        drift = np.where(moving[tall], frame.sums((weight * progress)[tall] * values) / safe_spread[tall], 0.0)
        return values - zero[frame.run] - progress[tall] * drift[frame.run], drift

    columns, drift_of_columns = about(shared)
    left, drift = about(reading)
    root = np.sqrt(weight)
    size = np.linalg.norm(root[:, None] * shared, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    white = root[:, None] * columns / size
    values, vectors = np.linalg.eigh(white.T @ white)
    good = values > _OPEN * max(float(values.max(initial=0.0)), 1.0)
    inverse = (vectors[:, good] / values[good]) @ vectors[:, good].T
    theta = inverse @ (white.T @ (root * left))
    along = drift_of_columns / size
    variance = 1.0 / safe_spread + np.einsum("rp,pq,rq->r", along, inverse, along)
    lost = np.abs(along @ vectors[:, ~good]).max(axis=1, initial=0.0) > _LOST * np.abs(along).max(initial=0.0)
    sigma = np.where(moving, np.where(lost, np.inf, np.sqrt(variance)), np.nan)
    freedom = int(mask.sum() - good.sum() - np.sum(mass > 0.0) - moving.sum())
    drifts = np.where(moving, drift - along @ theta, np.nan)
    return WithinRuns(left - columns @ (theta / size), freedom, drifts, sigma)
