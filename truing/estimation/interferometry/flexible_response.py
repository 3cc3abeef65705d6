"""What a channel's readings leave over once everything that follows loads, their history or time has been taken out.

Nothing is assumed of the platform but that it answers equal loads with equal history alike: the response to each axis,
its asymmetry, curve, hysteresis, play and creep are free, and so are zero and drift of every run. What is left is noise
of the instrument, jumps and gross errors.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.fringes import find_jump
from truing.estimation.interferometry.within_runs import RunFrame, fit_within_runs, run_frame

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

_CREEP_PACES = (2.0, 10.0)  # time constants in steps: what creeps faster or slower shows in these or in the drift
_MOST_COLUMNS = 0.6  # of the readings
_GROSS = 6.0
_NORMAL_MEDIAN = 0.6745
_ROUNDS, _L1_ROUNDS = 3, 15
_SHORTEST, _LONGEST = 6, 3000  # rows of a run that a jump is looked for in: time and memory go with their square
_JUMP, _BEYOND_ONE = 1e-4, 1.5
_CLOSE = 0.1  # sigmas: residuals nearer than that do not gain more weight


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
    fraction = 1.0 - np.exp(-np.diff(time_s, prepend=time_s[:1]) / tau)
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
    residual, scale = _robust(frame, shared, reading, noise)
    row, size, p_value = _jumps(residual, scale * noise, run, time_s, shared)
    steps = [((np.arange(len(run)) >= row[k]) & (run == k)).astype(float) for k in range(count) if p_value[k] < _JUMP]
    if steps:
        shared = np.column_stack([shared, *steps])
        residual, scale = _robust(frame, shared, reading, noise)
    kept = np.abs(residual) <= _GROSS * scale * noise
    for _ in range(_ROUNDS):
        fit = fit_within_runs(frame, shared, reading, noise, kept)
        noise = np.where(np.isfinite(sigma), np.hypot(sigma, of_loads), _scale(fit.residual, kept, fit.dof))
        inflation = len(reading) / max(fit.dof, 1)
        kept = np.abs(fit.residual) <= _GROSS * np.maximum(noise, _spread(fit.residual, inflation))
    fit = fit_within_runs(frame, shared, reading, noise, kept)
    return ChannelFit(fit.residual, noise, kept, fit.dof, fit.drift, fit.drift_sigma, row, size, p_value)


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


def _jumps(residual: Array, noise: Array, run: Index, time_s: Array, shared: Array) -> tuple[Index, Array, Array]:
    """Of each run, before which row it jumps, how far, and the p-value over its rows; -1 where too short or long.

    Beside the shared columns too: they may have taken up a part of the jump already. What a single reading explains
    nearly as well is no jump.
    """
    count = int(run.max(initial=-1)) + 1
    row, size, p_value = np.full(count, -1), np.zeros(count), np.ones(count)
    for rows in _runs(run):
        if not _SHORTEST <= len(rows) <= _LONGEST:
            continue
        design = np.column_stack([np.ones(len(rows)), time_s[rows] - time_s[rows[0]], shared[rows]])
        found = find_jump(residual[rows], noise[rows], design, shortest=3)
        here = run[rows[0]]
        row[here], size[here] = rows[found.onset[0]], found.size[0]
        if (found.size[0] / found.sigma[0]) ** 2 > _BEYOND_ONE * _of_one(
            residual[rows] / noise[rows], design, noise[rows]
        ):
            p_value[here] = found.p_value[0]
    return row, size, p_value


def _of_one(white: Array, design: Array, noise: Array) -> float:
    """By how much chi-square falls where the one reading is left out that makes it fall most."""
    basis, size, _ = np.linalg.svd(design / noise[:, None], full_matrices=False)
    basis = basis[:, size > 1e-10 * size[0]]
    left = white - basis @ (basis.T @ white)
    free = 1.0 - np.sum(basis**2, axis=1)
    return float(np.max(np.where(free > 1e-6, left**2 / np.where(free > 1e-6, free, 1.0), 0.0)))
