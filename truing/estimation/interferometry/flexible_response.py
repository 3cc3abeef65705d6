"""What a channel's readings leave over once everything that follows loads, their history or time has been taken out.

Nothing is assumed of the platform but that it answers equal loads with equal history alike: the response to each axis,
its asymmetry, curve, hysteresis, play and creep are free, and so are zero and drift of every run. What is left is noise
of the instrument, jumps and gross errors.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from truing.arrays import Array, Index, Mask

_CREEP_PACES = (2.0, 10.0)  # time constants in steps: what creeps faster or slower shows in these or in the drift
_MOST_COLUMNS = 0.6  # of the readings
_GROSS = 6.0
_NORMAL_MEDIAN = 0.6745
_ROUNDS, _L1_ROUNDS = 3, 15
_SHORTEST = 6  # rows of a run that a jump is looked for in
_MOST_JUMPS = 10  # of a channel
_FEWEST = 3  # readings on either side of a jump
_JUMP, _BEYOND_ONE = 1e-4, 1.5
_LITTLE = 1e-6
_CLOSE = 0.1  # sigmas: residuals nearer than that do not gain more weight
_OPEN = 1e-9  # share of the largest eigenvalue that is no zero
_LOST = 1e-6


@dataclass(frozen=True)
class ChannelFit:
    """N readings of a channel less everything that they may follow.

    residual (N,), sigma (N,) with what uncertain loads add; kept (N,) without gross errors; leverage-corrected freedom
    ``dof``; drift, drift_sigma (R,) of each run over its duration, NaN where open; jump_row (R,) before which row a run
    jumps (-1: nowhere), jump_size and jump_p (R,).
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
        """Sum of squares of the residuals that were kept, in units of sigma."""
        return float(np.sum((self.residual[self.kept] / self.sigma[self.kept]) ** 2))


def response_columns(load: Array, run: Index, time_s: Array, surroundings: Array) -> list[Array]:
    """Groups of columns (N, P) that readings may follow, those first that matter most.

    load (N, 6), run (N,), surroundings (N, C), all in the order of time within runs.
    """
    largest = np.abs(load).max(axis=0, initial=0.0)
    share = load[:, largest > 0.0] / largest[largest > 0.0]
    size, sign = np.abs(share), np.sign(share)
    way = _unloading(size, run)
    pauses = np.diff(time_s)[np.diff(run) == 0]
    pace = float(np.median(pauses)) if len(pauses) else 1.0
    since = np.column_stack([_since_start(column, run) for column in surroundings.T] or [np.zeros((len(run), 0))])
    creeping = [_crept(share, run, time_s, paces * pace) for paces in _CREEP_PACES] if pace > 0.0 else []
    back = np.column_stack([way * share, way * share * size])  # any F (F_max - F), whatever F_max
    return [share, since, size, share * size**2, back, sign, *creeping]


def _runs(run: Index) -> Iterator[Index]:
    return iter(np.split(np.arange(len(run)), np.flatnonzero(np.diff(run)) + 1)) if len(run) else iter(())


def _unloading(size: Array, run: Index) -> Array:
    """Whether loads of sizes (N, A) are on their way back, 1 or 0: smaller than at the step before, or held since."""
    change = np.sign(np.diff(size, axis=0, prepend=size[:1]))
    change[np.flatnonzero(np.diff(run)) + 1] = 1.0  # a run begins afresh
    change[:1] = 1.0
    step = np.arange(len(size))[:, None]
    last = np.maximum.accumulate(np.where(change != 0.0, step, 0), axis=0)
    return (np.take_along_axis(change, last, axis=0) < 0.0).astype(float)


def _since_start(values: Array, run: Index) -> Array:
    """Values (N,) less the first known of their run; zero where unknown."""
    out = np.zeros(len(values))
    for rows in _runs(run):
        known = rows[np.isfinite(values[rows])]
        if len(known):
            out[known] = values[known] - values[known[0]]
    return out


def _crept(share: Array, run: Index, time_s: Array, tau: float) -> Array:
    """Loads (N, A) as a platform feels them that follows with a time constant, each held until its reading."""
    elapsed = np.maximum(np.diff(time_s, prepend=time_s[:1]), 0.0)  # where a run begins, time may go back
    fraction = 1.0 - np.exp(-elapsed / tau)
    out = np.zeros(share.shape)
    for n in range(1, len(share)):
        if run[n] == run[n - 1]:
            out[n] = out[n - 1] + fraction[n] * (share[n] - out[n - 1])
    return out


def fit_channel(
    reading: Array, sigma: Array, groups: list[Array], run: Index, time_s: Array, load: Array, load_sigma: Array
) -> ChannelFit:
    """Fit readings (N,) by groups of columns (N, P); run (N,) from 0, load (N, 6) with its standard deviation (6,).

    sigma (N,) NaN where none is declared: then that of the readings' own scatter. Single readings beyond six sigmas are
    kept out, and a run that jumps gets a step, found in what the others leave.
    """
    frame = run_frame(run, time_s)
    count = len(frame.starts)
    shared = _affordable(groups, len(reading) - 2 * count, len(reading))
    of_loads = _of_loads(reading, frame, load, load_sigma)
    noise = np.where(np.isfinite(sigma), np.hypot(sigma, of_loads), 1.0)
    taken = np.zeros(count, dtype=bool)
    jumps = _Jumps(np.full(count, -1), np.zeros(count), np.zeros(count), np.ones(count))
    for _ in range(_MOST_JUMPS + 1):  # the clearest first: it bends what the other runs of its load leave
        residual, scale = _robust(frame, shared, reading, noise)
        single = _single(np.abs(residual) > _GROSS * scale * noise)
        now = _jumps(frame, shared, reading, scale * noise, ~single)
        jumps = _Jumps(*(np.where(taken, old, new) for old, new in zip(jumps, now, strict=True)))
        clear = np.where(~taken & (now.p_value < _JUMP), now.gain, 0.0)
        worst = int(clear.argmax())
        if clear[worst] == 0.0:
            break
        taken[worst] = True
        step = (np.arange(len(run)) >= jumps.row[worst]) & (run == worst)
        shared = np.column_stack([shared, step.astype(float)])
    kept = np.abs(residual) <= _GROSS * scale * noise
    for _ in range(_ROUNDS):
        fit = fit_within_runs(frame, shared, reading, noise, kept)
        noise = np.where(np.isfinite(sigma), np.hypot(sigma, of_loads), _scale(fit.residual, kept, fit.dof))
        inflation = len(reading) / max(fit.dof, 1)
        kept = np.abs(fit.residual) <= _GROSS * np.maximum(noise, _spread(fit.residual, inflation))
    fit = fit_within_runs(frame, shared, reading, noise, kept)
    return ChannelFit(
        fit.residual, noise, kept, fit.dof, fit.drift, fit.drift_sigma, jumps.row, jumps.size, jumps.p_value
    )


def _affordable(groups: list[Array], room: int, count: int) -> Array:
    """The first groups of columns (N, P) that leave readings enough to judge by."""
    taken = [np.zeros((count, 0))]
    for group in groups:
        moving = group[:, np.ptp(group, axis=0) > 0.0] if len(group) else group
        if sum(one.shape[1] for one in taken) + moving.shape[1] > min(room, _MOST_COLUMNS * count):
            break
        taken.append(moving)
    return np.column_stack(taken)


def _robust(frame: RunFrame, shared: Array, reading: Array, noise: Array) -> tuple[Array, float]:
    """Residuals (N,) of a fit that gross errors do not bend, and their scatter over the noise, 1 at least.

    Least absolute deviations, by reweighting.
    """
    weight, everything = np.ones(len(reading)), np.ones(len(reading), dtype=bool)
    for _ in range(_L1_ROUNDS):
        fit = fit_within_runs(frame, shared, reading, noise / np.sqrt(weight), everything)
        scale = _spread(fit.residual / noise, len(reading) / max(fit.dof, 1))
        weight = 1.0 / np.maximum(np.abs(fit.residual) / noise / max(scale, _CLOSE), _CLOSE)
    return fit.residual, max(scale, 1.0)


def _scale(residual: Array, kept: Mask, dof: int) -> float:
    """The noise of residuals themselves, where none is declared."""
    own = float(np.sqrt(np.sum(residual[kept] ** 2) / max(dof, 1)))
    return own if own > 0.0 else 1.0


def _of_loads(reading: Array, frame: RunFrame, load: Array, load_sigma: Array) -> Array:
    """What uncertain loads (6,) add to the noise (N,) of readings, by a linear response; none where unloaded."""
    loaded = np.ptp(load, axis=0) > 0.0
    if not loaded.any() or not load_sigma.any():
        return np.zeros(len(load))
    about = np.column_stack([reading, load[:, loaded]])
    about = about - (frame.sums(about) / np.bincount(frame.run)[:, None])[frame.run]
    slope = np.linalg.lstsq(about[:, 1:], about[:, 0], rcond=None)[0]
    return np.sqrt(np.sum((load[:, loaded] != 0.0) * (slope * load_sigma[loaded]) ** 2, axis=1))


def _spread(residual: Array, inflation: float) -> float:
    """Robust standard deviation of residuals, for the freedom that the fit took."""
    return float(np.median(np.abs(residual)) / _NORMAL_MEDIAN * np.sqrt(inflation))


def _single(far: Mask) -> Mask:
    """Readings that are far off while those before and after are not: gross errors, not what follows a jump."""
    beside = np.zeros(len(far), dtype=bool)
    beside[1:] |= far[:-1]
    beside[:-1] |= far[1:]
    return far & ~beside


class _Jumps(NamedTuple):
    """The likeliest jump of each run (R,): before which row, how far, what it takes off chi-square, and its p-value."""

    row: Index
    size: Array
    gain: Array
    p_value: Array


def _jumps(frame: RunFrame, shared: Array, reading: Array, noise: Array, kept: Mask) -> _Jumps:
    """The likeliest jumps; row -1 where a run is too short.

    A step at every row is asked what it adds to the fit of all runs together. What leaving out a single reading adds
    nearly as much to is no jump.
    """
    from scipy.special import chdtrc

    residual = fit_within_runs(frame, shared, reading, noise, kept).residual
    root = kept / noise
    runs = np.split(np.arange(len(reading)), frame.starts[1:])
    bases = [
        np.linalg.qr(root[rows, None] * np.column_stack([np.ones(len(rows)), frame.way[rows]]))[0] for rows in runs
    ]
    whites = [_less(basis, root[rows, None] * shared[rows]) for basis, rows in zip(bases, runs, strict=True)]
    normal = sum((white.T @ white for white in whites), np.zeros((shared.shape[1], shared.shape[1])))
    inverse = np.asarray(np.linalg.pinv(normal, rcond=_OPEN, hermitian=True), np.float64)
    found = _Jumps(np.full(len(runs), -1), np.zeros(len(runs)), np.zeros(len(runs)), np.ones(len(runs)))
    for here, (rows, basis, white) in enumerate(zip(runs, bases, whites, strict=True)):
        if len(rows) < _SHORTEST:
            continue
        left, steps = root[rows] * residual[rows], root[rows]
        # a step before row k + 1, times anything, is the sum from there on
        parts = (steps**2, left * steps, basis * steps[:, None], white * steps[:, None])
        whole, along, own, beside = (np.cumsum(part[::-1], axis=0)[::-1][1:] for part in parts)
        gain = _added(whole - np.sum(own**2, axis=1), along, beside, inverse)
        before = np.cumsum(kept[rows])[:-1]
        gain = np.where((before >= _FEWEST) & (kept[rows].sum() - before >= _FEWEST), gain, 0.0)
        best = int(gain.argmax())
        found.row[here], found.gain[here] = rows[best + 1], gain[best]
        found.size[here] = gain[best] / along[best] if gain[best] > 0.0 else 0.0
        if gain[best] > _BEYOND_ONE * _added(1.0 - np.sum(basis**2, axis=1), left, white, inverse).max():
            found.p_value[here] = min(1.0, np.count_nonzero(gain) * float(chdtrc(1, gain[best])))
    return found


def _less(basis: Array, columns: Array) -> Array:
    """Columns (N, K) less what a basis (N, 2) of orthonormal columns makes of them."""
    return columns - basis @ (basis.T @ columns)


def _added(whole: Array, along: Array, beside: Array, inverse: Array) -> Array:
    """What each of K columns takes off chi-square: by its square (K,) within its run, its product (K,) with the
    residuals and those (K, P) with the shared columns, whose normal matrix over all runs has this inverse."""
    energy = whole - np.sum((beside @ inverse) * beside, axis=1)
    reported = energy > _LITTLE * np.maximum(whole, np.finfo(float).tiny)
    return np.where(reported, along**2 / np.where(reported, energy, 1.0), 0.0)


@dataclass(frozen=True)
class RunFrame:
    """Rows (N,) of runs that follow each other: where each run starts (R,), and how far along it each row is (N,),
    from -1/2 to 1/2 in time."""

    starts: Index
    run: Index
    way: Array

    def sums(self, values: Array) -> Array:
        """Sums over each run (R, ...) of values (N, ...)."""
        return np.add.reduceat(values, self.starts, axis=0)


@dataclass(frozen=True)
class WithinRuns:
    """Residuals (N,), their freedom, and each run's drift (R,) over its duration with its standard deviation, which is
    infinite where it cannot be told from what all runs share; NaN where a run has no duration."""

    residual: Array
    dof: int
    drift: Array
    drift_sigma: Array


def run_frame(run: Index, time_s: Array) -> RunFrame:
    """The frame of rows whose run (N,) counts up from 0, in the order of time."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(run)) + 1])
    ends = np.concatenate([starts[1:], [len(run)]]) - 1
    length = (time_s[ends] - time_s[starts])[run]
    way = np.where(length > 0.0, (time_s - time_s[starts][run]) / np.where(length > 0.0, length, 1.0) - 0.5, 0.0)
    return RunFrame(starts, run, way)


def fit_within_runs(frame: RunFrame, shared: Array, reading: Array, noise: Array, kept: Mask) -> WithinRuns:
    """Fit readings (N,) by a zero and a drift of each run and columns (N, P) that all runs share; noise (N,).

    Columns that the others make up are left out of the fit.
    """
    weight = kept / noise**2
    mass = frame.sums(weight)
    middle = frame.sums(weight * frame.way) / np.where(mass > 0.0, mass, 1.0)
    way = frame.way - middle[frame.run]
    spread = frame.sums(weight * way**2)
    moving = spread > _OPEN * np.maximum(mass, np.finfo(float).tiny)
    safe_mass, safe_spread = np.where(mass > 0.0, mass, 1.0), np.where(moving, spread, 1.0)

    def about(values: Array) -> tuple[Array, Array]:
        """Values (N, ...) less their zero and drift in each run, and that drift (R, ...)."""
        tall = (slice(None),) + (None,) * (values.ndim - 1)
        zero = frame.sums(weight[tall] * values) / safe_mass[tall]
        drift = np.where(moving[tall], frame.sums((weight * way)[tall] * values) / safe_spread[tall], 0.0)
        return values - zero[frame.run] - way[tall] * drift[frame.run], drift

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
    freedom = int(kept.sum() - good.sum() - np.sum(mass > 0.0) - moving.sum())
    drifts = np.where(moving, drift - along @ theta, np.nan)
    return WithinRuns(left - columns @ (theta / size), freedom, drifts, sigma)
