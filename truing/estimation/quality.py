"""Statistics for quality checks: noise, steps, drift, exchanged labels, repeats; arrays in SI."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.rotation import rigid_motions

# Poses that are compared with others at a time, and the factor that keeps rounding out of a preselection.
_POSES_AT_ONCE, _WIDER = 256, 1.001
_NARROW = 9  # width up to which each window is sorted anew


@dataclass(frozen=True)
class Scatter:
    """Sum of squares of standardised residuals with its degrees of freedom, per group; ratio estimated / declared."""

    chi_square: Array
    dof: Array

    @property
    def ratio(self) -> Array:
        """Estimated over declared standard deviation; NaN without freedom."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.sqrt(np.where(self.dof > 0.0, self.chi_square / self.dof, np.nan))

    @property
    def pooled(self) -> Scatter:
        """All groups as one."""
        return Scatter(self.chi_square.sum(keepdims=True), self.dof.sum(keepdims=True))

    def p_above(self, tolerated_ratio: float) -> Array:
        """Return the p-value of a noise of at most ``tolerated_ratio`` times the declared one (chi-square,
        one-sided)."""
        from scipy.special import chdtrc

        safe = np.maximum(self.dof, 1e-9)
        return np.where(self.dof > 0.0, chdtrc(safe, self.chi_square / tolerated_ratio**2), 1.0)

    def p_below(self, tolerated_ratio: float) -> Array:
        """Return the p-value of a noise of at least ``tolerated_ratio`` times the declared one (chi-square,
        one-sided)."""
        from scipy.special import chdtr

        safe = np.maximum(self.dof, 1e-9)
        return np.where(self.dof > 0.0, chdtr(safe, self.chi_square / tolerated_ratio**2), 1.0)


def residual_scatter(residuals: Array, sigma: Array, redundancy: Array, covariates: Array) -> Scatter:
    """Return the scatter per axis of residuals without their dependence on covariates and constants per target.

    residuals (B, T, 3) in m; sigma (B, T, 3) of the measurement alone (a survey error is a constant of its target);
    redundancy (B, T, 3) of the pose fits, zero if unused; covariates (B, C). Regression on drives, time or temperature
    removes deformation, target by target. Degrees of freedom: redundancy left by the regressions.
    """
    mask = redundancy > 0.0
    design = np.column_stack([np.ones(len(covariates)), covariates])
    weight = mask / np.where(mask, sigma, 1.0) ** 2
    left, share = _regression_residuals(np.where(mask, residuals, 0.0), weight, design)
    return Scatter((weight * left**2).sum(axis=(0, 1)), (redundancy * share).sum(axis=(0, 1)))


def _regression_residuals(values: Array, weight: Array, design: Array) -> tuple[Array, Array]:
    """Return residuals (B, T, 3) of a weighted regression of each coordinate on the design, and the share of each
    value's own error in them."""
    normal = np.einsum("bi,bta,bj->taij", design, weight, design, optimize=True)
    right = np.einsum("bi,bta,bta->tai", design, weight, values, optimize=True)
    inverse = np.linalg.pinv(normal, rcond=1e-10, hermitian=True)
    fitted = np.einsum("bi,taij,taj->bta", design, inverse, right, optimize=True)
    leverage = np.einsum("bi,taij,bj,bta->bta", design, inverse, design, weight, optimize=True)
    return values - fitted, np.maximum(1.0 - leverage, 0.0)


@dataclass(frozen=True)
class TargetStep:
    """The best step of each target: index of the pose after it, size (T, 3) in m, sigma, and p-value over all
    onsets."""

    onset: Index
    size: Array
    sigma: Array
    p_value: Array


def find_steps(values: Array, sigma: Array, used: Mask, shortest: int = 3) -> TargetStep:
    """Return the most significant step in each target's residuals over poses in time order.

    values, sigma (B, T, 3), used (B, T). The statistic is the chi-square (3 degrees of freedom) of the difference of
    weighted means after and before; maximised over onsets with at least ``shortest`` poses on either side, with
    Bonferroni over the onsets.
    """
    from scipy.special import chdtrc

    weight = used[:, :, None] / np.where(used[:, :, None], sigma, 1.0) ** 2
    sums, weights, counts = (np.cumsum(a, axis=0) for a in (weight * values, weight, used.astype(float)))
    after, after_weight = sums[-1:] - sums, weights[-1:] - weights
    enough = (counts >= shortest) & (counts[-1:] - counts >= shortest)
    with np.errstate(divide="ignore", invalid="ignore"):
        difference = after / after_weight - sums / weights
        variance = 1.0 / after_weight + 1.0 / weights
        chi_square = np.where(enough, (difference**2 / variance).sum(axis=2), -1.0)
    best = chi_square.argmax(axis=0)
    target = np.arange(values.shape[1])
    mask = chi_square[best, target] >= 0.0
    single = chdtrc(3, np.maximum(chi_square[best, target], 0.0))
    p = np.where(mask, np.minimum(1.0, enough.sum(axis=0) * single), 1.0)
    pick = np.where(mask[:, None], difference[best, target], 0.0)
    return TargetStep(best + 1, pick, np.sqrt(np.where(mask[:, None], variance[best, target], 0.0)), p)


@dataclass(frozen=True)
class Drift:
    """Smooth motion in time: p-value of no trend, and the span of the smoothed positions (per target, m)."""

    p_value: float
    span: Array


def find_drift(positions: Array, mask: Mask) -> Drift:
    """Test positions (B, T, 3), in time order, for drift by von Neumann's ratio of successive differences, pooled.

    The span is that of a running median over a twentieth of the poses (at least five); the largest over a target's axes
    is the size of the drift.
    """
    from scipy.special import ndtr

    complete = mask.all(axis=1)
    series = positions[complete].reshape(int(complete.sum()), 3 * mask.shape[1])
    n = len(series)
    if n < 8:
        return Drift(1.0, np.zeros(mask.shape[1]))
    centred = series - series.mean(axis=0)
    variance = (centred**2).mean(axis=0)
    moving = variance > 0.0
    # 2 for values without any trend.
    ratio = (np.diff(series, axis=0)[:, moving] ** 2).sum(axis=0) / (n * variance[moving])
    z = (ratio - 2.0) / np.sqrt(4.0 * (n - 2) / (n**2 - 1))
    p = float(min(1.0, max(moving.sum(), 1) * ndtr(z).min())) if moving.any() else 1.0
    smooth = running_median(positions[complete], max(5, n // 20))
    return Drift(p, np.linalg.norm(np.ptp(smooth, axis=0), axis=-1))


def running_median(series: Array, width: int) -> Array:
    """Return the median of series (B, ...) over a window of ``width`` rows, for complete windows only."""
    width = min(width, len(series))
    if width <= _NARROW:
        return np.median(np.lib.stride_tricks.sliding_window_view(series, width, axis=0), axis=-1)
    from scipy.ndimage import rank_filter  # its cost grows with the logarithm of the width

    windows = slice(width // 2, width // 2 + len(series) - width + 1)
    flat = np.ascontiguousarray(series.reshape(len(series), -1).T)
    middle = [[rank_filter(row, rank, size=width)[windows] for row in flat] for rank in {(width - 1) // 2, width // 2}]
    return np.mean(middle, axis=0).T.reshape(-1, *series.shape[1:])


def exchanged_pairs(fitted_from: Array, measured: Array, gross: Mask, limit: Array) -> list[tuple[int, int, int]]:
    """Return (pose, target, target) for points at each other's places: exchanged labels.

    fitted_from (B, T, 3): survey moved by each pose; measured (B, T, 3); gross (B, T): targets away from their place;
    limit (B, T) in m: distance within which a point is at another target's place.
    """
    result = []
    for pose in np.nonzero(gross.sum(axis=1) >= 2)[0]:
        off = np.nonzero(gross[pose])[0]
        distance = np.linalg.norm(measured[pose][off][:, None] - fitted_from[pose][off][None], axis=2)
        near = distance < limit[pose, off][None]
        for a, b in zip(*np.nonzero(near & near.T & ~np.eye(len(off), dtype=bool)), strict=True):
            if a < b:
                result.append((int(pose), int(off[a]), int(off[b])))
    return result


@dataclass(frozen=True)
class BodyShape:
    """Geometry of one body: rms extents along its principal axes (m, descending), leverage of each target."""

    extents: Array
    leverage: Array


def body_shape(points: Array) -> BodyShape:
    """Return the geometry of points (T, 3): principal extents, and the leverage (0..1) of each target in a fit of the
    frame."""
    centred = points - points.mean(axis=0)
    extents = np.linalg.svd(centred, compute_uv=False) / np.sqrt(len(points))
    design = rigid_motions(centred)
    inverse = np.linalg.pinv(np.einsum("tia,tib->ab", design, design), rcond=1e-9, hermitian=True)
    return BodyShape(extents, np.einsum("tia,ab,tib->t", design, inverse, design) / 3.0)


def repeated_groups(settings: Array, tolerance: Array) -> list[Index]:
    """Return groups of poses (indices) with settings (B, D) that agree within tolerance (D,), each with at least two.

    An unknown setting (NaN) agrees with none.
    """
    order, begin, end = _neighbours(settings, tolerance)
    first = np.arange(len(settings))
    for start in range(0, len(order), _POSES_AT_ONCE):
        rows = slice(start, start + _POSES_AT_ONCE)
        own_rows, neighbours = order[rows], order[begin[rows].min() : end[rows].max()]
        alike = np.ones((len(own_rows), len(neighbours)), bool)
        for column, allowed in zip(settings.T, tolerance, strict=True):
            alike &= np.abs(column[own_rows, None] - column[neighbours]) <= allowed
        first[own_rows] = np.minimum(own_rows, np.where(alike, neighbours, len(first)).min(axis=1, initial=len(first)))
    number, count = np.unique(first, return_inverse=True, return_counts=True)[1:]
    return [np.nonzero(number == k)[0] for k in np.flatnonzero(count > 1)]


def _neighbours(settings: Array, tolerance: Array) -> tuple[Index, Index, Index]:
    """Return the order (B,) of poses along the setting with most distinct values. For each place there: the range
    [begin, end) of places that agree with it in this setting."""
    pairs = []
    for column, allowed in zip(settings.T, tolerance * _WIDER, strict=True):
        order = np.argsort(column, kind="stable")
        values = column[order]
        begin = np.searchsorted(values, values - allowed, "left")
        pairs.append((order, begin, np.searchsorted(values, values + allowed, "right")))
    return min(pairs, key=lambda pair: int(np.sum(pair[2] - pair[1])))


def successive_sigma(values: Array, mask: Mask) -> Array:
    """Return the robust scatter (T, 3) of each target's values (B, T, 3) from successive differences, which ignores
    steps and slow drift."""
    sigma = np.zeros(values.shape[1:])
    for target in range(values.shape[1]):
        series = values[mask[:, target], target]
        if len(series) > 3:
            sigma[target] = 1.4826 * np.median(np.abs(np.diff(series, axis=0)), axis=0) / np.sqrt(2.0)
    return sigma


def isolated_values(values: Array, sigma: Array, mask: Mask, limit: float = 10.0) -> Mask:
    """Return the mask (B, T) of values further than ``limit`` deviations from the running median of five neighbours in
    time."""
    far = np.zeros(mask.shape, bool)
    for target in range(values.shape[1]):
        rows = np.nonzero(mask[:, target])[0]
        if len(rows) >= 5:
            series = values[rows, target]
            middle = running_median(np.concatenate([series[:2][::-1], series, series[-2:][::-1]]), 5)
            far[rows, target] = (np.abs(series - middle) > limit * sigma[rows, target]).any(axis=1)
    return far


def holm_adjusted(p_value: Array) -> Array:
    """Return p-values (N,) with Holm's correction (1979), which controls the family-wise error rate."""
    order = np.argsort(p_value, kind="stable")
    scaled = np.minimum(np.maximum.accumulate(p_value[order] * np.arange(len(order), 0, -1)), 1.0)
    adjusted = np.empty_like(scaled)
    adjusted[order] = scaled
    return adjusted
