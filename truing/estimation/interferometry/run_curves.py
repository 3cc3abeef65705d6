"""Gross errors of readings, as outliers from a smooth curve of load and time through every run of a channel.

The curves include asymmetry, hysteresis and clearance of elastic sensors, so that outliers are no property of
the sensor. A lasting jump is not a single gross error, and stays in. So do outliers that are effects of loads or runs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.interferometry.load_run import branches
from truing.estimation.interferometry.shared_inputs import LoadCourse, SharedInput, shared_inputs

_FALSE_REJECTIONS = 0.05  # expected number in a whole campaign
_NORMAL_MEDIAN = 0.6745
_L1_ROUNDS, _FIXPOINT_ROUNDS = 30, 20
_CLOSE = 0.05  # sigmas; smaller residuals gain no more weight
_SPARE = 4  # least number of readings of a run beyond the terms of its curve
_LASTS = 3  # consecutive readings on one side that form a jump
_MOST = 6  # gross errors of a run that are searched one after the other
_RIDGE = 1e-10


@dataclass(frozen=True)
class RunCurves:
    """Residuals of steps (B, K channels), NaN without a reading or with too few for a curve, and the mask of rejected
    ones.

    sigma (B, K): declared, or else the scatter about the curves. shared: outliers that are effects, and stay in.
    """

    residual: Array
    rejected: Mask
    sigma: Array
    shared: tuple[SharedInput, ...] = ()


def run_curves(load: Array, time_s: Array, run: Index, reading: Array, sigma: Array) -> RunCurves:
    """Return a curve for every run and channel of readings (B, K) under loads (B, 6); sigma NaN if not declared.

    The expected number of good readings rejected in a campaign is at most 0.05.
    """
    pieces = [(np.flatnonzero(run == r), k) for r in np.unique(run) for k in range(reading.shape[1])]
    pieces = [(rows[np.isfinite(reading[rows, k])], k) for rows, k in pieces]
    pieces = [(rows, k) for rows, k in pieces if len(rows)]
    columns = [curve_columns(load[rows], time_s[rows]) for rows, _ in pieces]
    batch = _Batch.of(pieces, columns, reading)
    noise = _noise(batch, reading, sigma)
    limit = _gross_limit(batch)
    rejected_of = _rejected(batch, np.stack([_padded(noise[rows, k], batch.width) for rows, k in pieces]), limit)
    left, _ = batch.solved(np.where(batch.is_observed & ~rejected_of, 1.0, 0.0))
    off = np.zeros(reading.shape)
    for piece, (rows, k) in enumerate(pieces):
        off[rows, k] = np.where(rejected_of[piece], left[piece], 0.0)[: len(rows)] / noise[rows, k]
    shared = shared_inputs(LoadCourse(load, run), reading, noise, off, limit)
    _readmit(shared, pieces, rejected_of)
    left, _ = batch.solved(np.where(batch.is_observed & ~rejected_of, 1.0, 0.0))
    noise = _with_estimated_noise(batch, left, rejected_of, reading, sigma, noise)
    residual, rejected = np.full(reading.shape, np.nan), np.zeros(reading.shape, bool)
    for piece, (rows, k) in enumerate(pieces):
        residual[rows, k], rejected[rows, k] = left[piece, : len(rows)], rejected_of[piece, : len(rows)]
        if batch.terms[piece] == 0:
            residual[rows, k] = np.nan
    return RunCurves(residual, rejected, noise, tuple(shared))


def _readmit(shared: list[SharedInput], pieces: list[tuple[Index, int]], rejected_of: Mask) -> None:
    """Take outliers that are effects out of the mask (M, N) of all pieces."""
    for one in shared:
        for piece, (rows, k) in enumerate(pieces):
            if k == one.channel:
                rejected_of[piece, : len(rows)] &= ~np.isin(rows, one.rows)


def curve_columns(load: Array, time_s: Array) -> Array:
    """Return the columns (N, P) of a run's curve, with as many kinds of terms as its readings (N,) allow.

    In this order: zero; load F of each loaded axis; time; |F| and F^3; sign F and hysteresis loop. (N, 0) if there
    are too few readings for zero and load.
    """
    moved = np.flatnonzero(np.ptp(load, axis=0) > 0.0)
    F = load[:, moved] / np.abs(load[:, moved]).max(axis=0, initial=0.0)
    sense = np.stack([branches(one) for one in F.T], axis=1) if len(moved) else np.zeros(F.shape)
    share = np.abs(F)
    kinds = [
        [np.ones((len(F), 1)), F],
        [(time_s - time_s[0])[:, None] / max(float(np.ptp(time_s)), 1e-9)],
        [share, F**3],
        [np.sign(F), (sense < 0) * share * (1.0 - share) * np.sign(F)],
    ]
    columns_kept: list[Array] = []
    for kind in kinds:
        more = np.concatenate([*columns_kept, *kind], axis=1)
        if more.shape[1] > len(F) - _SPARE:
            break
        columns_kept = [more]
    return columns_kept[0] if columns_kept else np.empty((len(F), 0))


def _padded(values: Array, width: int) -> Array:
    return np.concatenate([values, np.ones(width - len(values))])


@dataclass(frozen=True)
class _Batch:
    """M pieces of up to N readings with up to P columns each, padded: columns (M, N, P) of unit length, y (M, N)."""

    columns: Array
    y: Array
    is_observed: Mask
    terms: Index
    channel: Index

    @classmethod
    def of(cls, pieces: list[tuple[Index, int]], columns: list[Array], reading: Array) -> _Batch:
        width = max((len(rows) for rows, _ in pieces), default=0)
        size = max((column.shape[1] for column in columns), default=0)
        columns_of_curve, y = np.zeros((len(pieces), width, size)), np.zeros((len(pieces), width))
        is_observed = np.zeros(y.shape, bool)
        for piece, ((rows, k), one) in enumerate(zip(pieces, columns, strict=True)):
            length = np.linalg.norm(one, axis=0)
            columns_of_curve[piece, : len(rows), : one.shape[1]] = one / np.where(length > 0.0, length, 1.0)
            y[piece, : len(rows)] = reading[rows, k]
            is_observed[piece, : len(rows)] = True
        terms = np.array([column.shape[1] for column in columns], np.int64)
        return cls(columns_of_curve, y, is_observed, terms, np.array([k for _, k in pieces], np.int64))

    @property
    def width(self) -> int:
        return self.y.shape[1]

    @property
    def has_curve(self) -> Mask:
        """Mask (M,) of pieces with a curve."""
        return self.terms > 0

    def solved(self, weight: Array) -> tuple[Array, Array]:
        """Return residuals (M, N) of weighted fits, and the leverage (M, N) of each reading."""
        weighted = self.columns * weight[..., None]
        normal = np.swapaxes(weighted, 1, 2) @ self.columns
        size = np.maximum(np.einsum("mpp->mp", normal).max(1, initial=0.0), 1e-300)
        normal = normal + _RIDGE * size[:, None, None] * np.eye(normal.shape[1])
        inverse = np.linalg.inv(normal)
        beta = inverse @ np.einsum("mnp,mn->mp", weighted, self.y)[..., None]
        left = np.where(self.is_observed, self.y - (self.columns @ beta)[..., 0], 0.0)
        return left, np.einsum("mnp,mpq,mnq->mn", self.columns, inverse, self.columns, optimize=True)

    def robust(self, sigma: Array) -> Array:
        """Return residuals (M, N) of least absolute deviations, over sigma (M, N)."""
        weight = self.is_observed / sigma**2
        far = np.abs(self.solved(weight)[0]) / sigma
        for _ in range(_L1_ROUNDS):
            far = np.abs(self.solved(weight / np.maximum(far, _CLOSE))[0]) / sigma
        return far

    def scatter(self, far: Array) -> Array:
        """Return the robust scatter (M,) of each piece's residuals, without as many of the smallest as its curve can
        interpolate."""
        ordered = np.sort(np.where(self.is_observed, far, np.inf), axis=1)
        spare = np.maximum(self.is_observed.sum(1) - self.terms, 1)
        middle = np.minimum(self.terms + spare // 2, self.is_observed.sum(1) - 1)
        return np.asarray(np.take_along_axis(ordered, middle[:, None], axis=1)[:, 0] / _NORMAL_MEDIAN)


def _noise(batch: _Batch, reading: Array, sigma: Array) -> Array:
    """Return the declared sigma, or the median scatter of a channel's runs about their curves."""
    open_channels = np.isfinite(reading) & ~np.isfinite(sigma)
    noise = np.array(sigma, float)
    if not open_channels.any():
        return noise
    plain = np.where(batch.is_observed, 1.0, 0.0)
    spread = np.sqrt(np.sum(batch.solved(plain)[0] ** 2, axis=1) / np.maximum(batch.is_observed.sum(1), 1))
    unit = np.where(spread > 0.0, spread, 1.0)
    scatter = batch.scatter(batch.robust(np.broadcast_to(unit[:, None], batch.y.shape))) * unit
    for k in range(reading.shape[1]):
        scatter_of_channel = scatter[(batch.channel == k) & batch.has_curve]
        sigma_of_channel = float(np.median(scatter_of_channel)) if len(scatter_of_channel) else np.nan
        if not sigma_of_channel > 0.0:
            sigma_of_channel = float(np.nanstd(reading[:, k])) or 1.0
        noise[open_channels[:, k], k] = sigma_of_channel
    return noise


def _with_estimated_noise(
    batch: _Batch, left: Array, rejected: Mask, reading: Array, sigma: Array, first: Array
) -> Array:
    """Return the noise, with undeclared values estimated from all runs of a channel without gross errors."""
    noise, mask = np.array(first), batch.is_observed & ~rejected & batch.has_curve[:, None]
    spare = np.where(batch.has_curve, np.maximum(mask.sum(1) - batch.terms, 0), 0)
    squares = np.sum(np.where(mask, left, 0.0) ** 2, axis=1)
    for k in range(reading.shape[1]):
        of_channel = (batch.channel == k) & (spare > 0)
        if squares[of_channel].sum() > 0.0:
            unknown = np.isfinite(reading[:, k]) & ~np.isfinite(sigma[:, k])
            noise[unknown, k] = np.sqrt(squares[of_channel].sum() / spare[of_channel].sum())
    return noise


def _gross_limit(batch: _Batch) -> float:
    """Return the limit in sigmas that any of some readings of unit noise exceeds with the accepted probability."""
    from scipy.special import ndtri

    return float(-ndtri(0.5 * _FALSE_REJECTIONS / max(int(batch.is_observed.sum()), 1)))


def _rejected(batch: _Batch, sigma: Array, limit: float) -> Mask:
    """Return the mask of outlying readings (M, N) by two methods; per run, the one with fewer or a better fit wins.
    Least absolute deviations resist many gross errors; stepwise exclusion by gain also finds errors at the ends, where
    the curve would follow them."""
    assessed = batch.is_observed & batch.has_curve[:, None]
    masks = [
        _reject_from_robust_start(batch, sigma, limit, assessed),
        _reject_one_by_one(batch, sigma, limit, assessed),
    ]
    cost = [
        np.sum((_weighted_residual(batch, mask, sigma) / sigma) ** 2 * mask, axis=1)
        + limit**2 * (assessed & ~mask).sum(1)
        for mask in masks
    ]
    is_kept = np.where((cost[1] < cost[0])[:, None], masks[1], masks[0])
    for piece in np.flatnonzero((assessed & ~is_kept).any(axis=1)).tolist():
        if _with_a_jump(batch, sigma, piece) + limit**2 < min(cost[0][piece], cost[1][piece]):
            is_kept[piece] = assessed[piece]
    left = _weighted_residual(batch, is_kept, sigma)
    wide = _rejection_limit(batch, left, sigma, is_kept, limit)
    alone = np.abs(left - _neighbour_median(np.where(batch.is_observed, left, np.nan))) >= wide * sigma
    return assessed & ~is_kept & alone & ~_in_long_runs(np.where(assessed & ~is_kept, np.sign(left), 0.0))


def _with_a_jump(batch: _Batch, sigma: Array, piece: int) -> float:
    """Return the chi-square of all readings of a run with a jump at each place, a least number of readings on either
    side."""
    at = np.flatnonzero(batch.is_observed[piece])
    if len(at) < 2 * _LASTS:
        return float("inf")
    white = 1.0 / sigma[piece, at]
    columns = batch.columns[piece, at][:, : batch.terms[piece]] * white[:, None]
    basis, size, _ = np.linalg.svd(columns, full_matrices=False)
    basis = basis[:, size > 1e-8 * size[0]]
    jumps = np.tri(len(at), len(at) - 2 * _LASTS + 1, -_LASTS) * white[:, None]
    left = batch.y[piece, at] * white
    left = left - basis @ (basis.T @ left)
    jumps = jumps - basis @ (basis.T @ jumps)
    reported = np.sum(jumps**2, axis=0)
    gain = (left @ jumps) ** 2 / np.where(reported > 1e-9, reported, np.inf)
    return float(left @ left - gain.max())


def _weighted_residual(batch: _Batch, mask: Mask, sigma: Array) -> Array:
    return batch.solved(np.where(mask, 1.0 / sigma**2, 0.0))[0]


def _rejection_limit(batch: _Batch, left: Array, sigma: Array, mask: Mask, limit: float) -> Array:
    """Return the limit (M, 1) in sigmas, larger if the kept residuals scatter more than their noise."""
    far = np.where(mask, np.abs(left) / sigma, np.inf)
    spare = np.maximum(mask.sum(1) - batch.terms, 1)
    middle = np.clip(batch.terms + spare // 2, 0, np.maximum(mask.sum(1) - 1, 0))
    scatter = np.take_along_axis(np.sort(far, axis=1), middle[:, None], axis=1)[:, 0] / _NORMAL_MEDIAN
    return np.asarray(limit * np.maximum(1.0, np.where(np.isfinite(scatter), scatter, 1.0)))[:, None]


def _reject_from_robust_start(batch: _Batch, sigma: Array, limit: float, assessed: Mask) -> Mask:
    start = batch.robust(sigma)
    wide = (limit * np.maximum(1.0, batch.scatter(start)))[:, None]
    mask = assessed & (start < 1.5 * wide)
    for _ in range(_FIXPOINT_ROUNDS):
        again = assessed & (_standardised(batch, mask, sigma) < wide)
        if (again == mask).all():
            break
        mask = again
    return mask


def _reject_one_by_one(batch: _Batch, sigma: Array, limit: float, assessed: Mask) -> Mask:
    is_kept, rows = assessed.copy(), np.arange(len(assessed))
    for _ in range(_MOST):
        far = np.where(is_kept, _standardised(batch, is_kept, sigma), 0.0)
        worst = far.argmax(axis=1)
        without = is_kept.copy()
        without[rows, worst] = False
        wide = _rejection_limit(batch, _weighted_residual(batch, without, sigma), sigma, without, limit)[:, 0]
        out = far[rows, worst] > wide
        if not out.any():
            break
        is_kept[rows[out], worst[out]] = False
    return is_kept


def _standardised(batch: _Batch, mask: Mask, sigma: Array) -> Array:
    """Return residuals (M, N) over their own standard deviation, for readings inside and outside the fit."""
    left, reach = batch.solved(np.where(mask, 1.0 / sigma**2, 0.0))
    weight = reach / sigma**2
    return np.abs(left) / (sigma * np.sqrt(np.where(mask, np.maximum(1.0 - weight, 1e-3), 1.0 + weight)))


def _neighbour_median(left: Array) -> Array:
    """Return the median (M, N) of the two residuals before and after: the local misfit of a curve that is too stiff."""
    beside = np.full((4, *left.shape), np.nan)
    for k, shift in enumerate((-2, -1, 1, 2)):
        moved = np.roll(left, shift, axis=1)
        inside = np.arange(left.shape[1]) - shift
        beside[k] = np.where((inside >= 0) & (inside < left.shape[1]), moved, np.nan)
    beside[0] = np.where(np.isnan(beside).all(axis=0), 0.0, beside[0])
    return np.asarray(np.nanmedian(beside, axis=0))


def _in_long_runs(side: Array) -> Mask:
    """Return the mask of signs (M, N) in a series of several equal ones other than 0."""
    mask = np.zeros(side.shape, bool)
    for shift in range(_LASTS):
        first = np.roll(side, shift, axis=1)
        same = side != 0.0
        for step in range(_LASTS):
            moved = np.roll(first, -step, axis=1)
            same &= moved == side
            inside = np.arange(side.shape[1]) - shift + step
            same &= (inside >= 0) & (inside < side.shape[1])
        mask |= same
    return mask
