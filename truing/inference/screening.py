"""Gross errors: observations far outside the spread of their own channel, even where an effect widens that spread."""

from __future__ import annotations

import numpy as np

from truing.inference.arrays import Array, Integers, Mask

# Probability that unit normal noise exceeds the limit.
_BY_CHANCE = 1.2e-6
_ENOUGH = 8  # fewest observations of a channel for a spread of its own
# An observation is confirmed if _AGREE of the _NEIGHBOURS epochs before it agree, or of those after it; near either end
# of the series, also if both direct neighbours agree.
_NEIGHBOURS, _AGREE = 3, 2
# Largest difference of observations that agree, in units of the channel's spread from epoch to epoch; the second value
# is for observations that are already suspect.
_REACH, _SUSPECT_REACH = 12.0, 3.5
# Suspects are no part of the fit, so they scatter more. They also agree within this share of their own deviation, which
# two gross errors hardly ever do.
_ALIKE = 0.25


def gross_errors(
    rest: Array,
    is_observed: Mask,
    axes: Array | None = None,
    order: Array | Integers | None = None,
    zero_groups: Integers | None = None,
) -> Mask:
    """Return True for observations (B, K) that are gross errors, from whitened residuals rest (B, K, d).

    A channel's spread is its median length over the epochs, and at least that of unit noise; a channel seen in few
    epochs uses the median over all channels.

    ``axes`` (B, K, d, d): derivatives of whitened residuals by shifts along the group's axes (m); ``order`` (B,): ranks
    of the epochs in time. With both, an observation that agrees with its neighbours in time is no gross error: its
    channel was displaced. Readings (d = 1) with the same number in ``zero_groups`` (B, K) count as a channel of their
    own: an effect widens only the runs that show it.
    """
    if zero_groups is not None:
        return _by_run(rest, is_observed, axes, order, zero_groups)
    far = _is_beyond_limit(rest, is_observed)
    if axes is None or order is None or not far.any():
        return far
    known = is_observed & (np.abs(np.linalg.det(axes)) > 0)
    values = np.linalg.solve(np.where(known[..., None, None], axes, np.eye(rest.shape[-1])), rest[..., None])[..., 0]
    return far & alone_in_time(np.where(known[..., None], values, np.nan), order, far, 0.0)


def least_gross(size: int) -> float:
    """Return the length of a whitened residual (d coordinates) above which an observation of ordinary spread is a gross
    error."""
    from scipy.special import chdtri

    return float(np.sqrt(chdtri(size, _BY_CHANCE)))


def _by_run(
    rest: Array, is_observed: Mask, axes: Array | None, order: Array | Integers | None, zero_groups: Integers
) -> Mask:
    """Return the gross errors (B, K) with each run's values of a channel treated as a channel of its own."""
    step, channel = np.nonzero(is_observed & (zero_groups >= 0))
    in_time = np.lexsort((step if order is None else order[step], zero_groups[step, channel]))
    step, channel = step[in_time], channel[in_time]
    group = np.unique(zero_groups[step, channel], return_inverse=True)[1]
    index = np.arange(len(group)) - np.searchsorted(group, group)
    shape = (int(index.max(initial=-1)) + 1, int(group.max(initial=-1)) + 1)
    known = np.zeros(shape, bool)
    known[index, group] = True
    values = np.zeros((*shape, 1))
    values[index, group] = rest[step, channel]
    unit = np.ones((*shape, 1, 1))
    if axes is not None:
        unit[index, group] = axes[step, channel]
    wrong = np.zeros(is_observed.shape, bool)
    if known.any():
        in_run = None if order is None else np.arange(shape[0])
        wrong[step, channel] = gross_errors(values, known, None if axes is None else unit, in_run)[index, group]
    return wrong


def _is_beyond_limit(residuals: Array, is_observed: Mask) -> Mask:
    length, limit = lengths(residuals, is_observed)
    return np.asarray(np.nan_to_num(length) > limit)


def lengths(residuals: Array, is_observed: Mask) -> tuple[Array, Array]:
    """Return the lengths (B, K) of whitened residuals rest (B, K, d), NaN where unseen, and their limits (K,)."""
    length = np.where(is_observed, np.sqrt(np.sum(residuals**2, -1)), np.nan)
    if not is_observed.any():
        return length, np.full(is_observed.shape[1], np.inf)
    from scipy.special import chdtri

    size = residuals.shape[-1]
    gross, middle = np.sqrt(chdtri(size, [_BY_CHANCE, 0.5]))
    common = np.nanmedian(length)
    medians = np.array([np.nanmedian(column) if np.isfinite(column).any() else common for column in length.T])
    spread = np.where(is_observed.sum(0) >= _ENOUGH, medians, np.maximum(medians, common)) / middle
    return length, gross * np.maximum(spread, 1.0)


def alone_in_time(values: Array, order: Array | Integers, suspect: Mask, least: float = 1e-6) -> Mask:
    """Return True for observations (B, T) that agree with no others of their channel just before or just after them.

    values (B, T, d): measured minus expected place of each channel, along the group's axes, m; NaN where unseen. order
    (B,): ranks of the epochs in time. suspect (B, T): observations that another test rejected. least (m): smallest
    scatter of a channel. In a channel seen in fewer than four epochs, only suspects count.
    """
    alone = np.zeros(suspect.shape, bool)
    known = np.all(np.isfinite(values), -1)
    in_time = np.argsort(order, kind="stable")
    for channel in range(values.shape[1]):
        rows = in_time[known[in_time, channel]]
        channel_values, doubted = values[rows, channel], suspect[rows, channel]
        alone[rows, channel] = doubted if len(rows) <= _NEIGHBOURS else _is_isolated(channel_values, doubted, least)
    return alone


def _is_isolated(values: Array, doubted: Mask, least: float) -> Mask:
    """Return True for a channel's observations (N, d), in time order, that agree with no neighbours, nor with their
    expected place."""
    from scipy.special import chdtri

    steps = _lengths(np.diff(values, axis=0))
    median = float(np.sqrt(chdtri(values.shape[1], 0.5)))  # length of as many unit normals
    spread = max(float(np.median(steps)) / median / np.sqrt(2.0), least)
    reach = np.sqrt(2.0) * spread * np.where(doubted, _SUSPECT_REACH, _REACH)
    reach = np.maximum(reach, doubted * _ALIKE * _lengths(values))
    agree, between = np.zeros((2, len(values)), int), np.zeros(len(values), bool)
    for distance in range(1, _NEIGHBOURS + 1):
        near = _lengths(values[distance:] - values[:-distance])
        agree[0, distance:] += near <= reach[distance:]
        agree[1, :-distance] += near <= reach[:-distance]
        if distance == 1:
            between |= agree.all(0)
    between[2:-2] = False
    expected = ~doubted & (_lengths(values) <= np.sqrt(2.0) * spread * _SUSPECT_REACH)
    return np.asarray((agree < _AGREE).all(0) & ~between & ~expected)


def _lengths(vectors: Array) -> Array:
    return np.asarray(np.sqrt(np.sum(vectors**2, -1)))
