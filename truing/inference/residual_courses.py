"""Residuals of a fitted model that may depend on inputs: those of each channel, and courses of groups in space.

An effect on a group moves its places in one pattern, which is unknown, along a course over the epochs. So residuals in
space are reduced to their leading principal components: those beyond noise are such courses. Whatever a course
follows, or nothing, its evidence is against a course of the same size without any order.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from truing.inference.arrays import Array, Mask
from truing.inference.fitted_model import FittedModel
from truing.inference.model import CauseT
from truing.inference.random_functions import centred, orthonormal, smooth_functions

FEWEST_EPOCHS = 20
_FIELDS = 8  # smooth patterns over the places of a group, in addition to its common shift
_SCALE_OF_FIELDS = 1.0  # length scale of the patterns, in standard deviations of the places
_MOST_COURSES = 4  # of one group
_DRAWS_OF_NOISE = 20
_ROUNDING = 1e-6  # residuals of constant readings, in units of the noise
_LEAST_SQUARES = 1e-300
_LEAST_OWN = 0.1  # variance of a channel's residuals that those of others do not share, from which on it is told apart


@dataclass(frozen=True)
class Residuals:
    """Residuals (n, q) of a group at selected epochs (B,), of some channels, or of all where ``channels`` is empty.

    A course is known to exceed noise, and only what it follows is open. ``share`` is the share of the residuals in the
    squares of their group.
    """

    channels: tuple[int, ...]
    epochs: Mask
    rows: Array
    group: int
    share: float
    is_course: bool


def residuals_of(
    fitted: FittedModel[CauseT], first: FittedModel[CauseT], doubted_noise: Array | None = None
) -> Iterator[Residuals]:
    """Yield the residuals to be explained. Where observations are numbers: one set per channel. In space: the courses
    of each group. Shares are of the squares of a first model's residuals.

    ``doubted_noise`` (B, K): factors on the noise of the fits that may be an effect; residuals are without them.
    """
    measured = fitted.measured
    factor = np.ones(measured.is_observed.shape) if doubted_noise is None else doubted_noise
    rows_of_groups = _groups_of_residuals(fitted, factor)
    squares = list(map(_squares, rows_of_groups if first is fitted else _groups_of_residuals(first, factor)))
    if measured.size == 1:
        rows_of_groups = _without_larger(rows_of_groups, fitted)
    for group, (rows, sum_of_squares) in enumerate(zip(rows_of_groups, squares, strict=True)):
        if measured.size == 1:
            at = measured.is_observed[:, group] & np.isfinite(rows).all(1)
            if at.any() and np.abs(rows[at]).max() > _ROUNDING:
                share = min(1.0, _squares(rows) / max(sum_of_squares, _LEAST_SQUARES))
                yield Residuals((group,), at, rows[at], group, share, is_course=False)
            continue
        for course in courses(rows):
            share = min(1.0, float(np.sum(course**2)) / max(sum_of_squares, _LEAST_SQUARES))
            yield Residuals((), np.ones(len(rows), bool), course, group, share, is_course=True)


def _without_larger(rows: list[Array], fitted: FittedModel[CauseT]) -> list[Array]:
    """Return residuals (B, 1) of channels, each without what the channels with larger ones predict of it.

    Where an uncertain input moves several channels, an error of one moves the estimated input, and with it the
    residuals of the others. Channels whose residuals are hardly their own keep them: either may err.
    """
    if len(rows) < 2:
        return rows
    correlation, values = _correlation_by_inputs(rows, fitted), np.nan_to_num(np.column_stack(rows))
    order, result = np.argsort(-np.mean(values**2, 0), kind="stable"), list(rows)
    for place, channel in enumerate(order[1:], 1):
        larger = order[:place]
        of_larger, with_it = correlation[:, larger[:, None], larger], correlation[:, larger, channel]
        weight = np.linalg.solve(of_larger + _ROUNDING * np.eye(place), with_it[..., None])[..., 0]
        if np.mean(1.0 - np.sum(weight * with_it, 1)) > _LEAST_OWN:
            result[channel] = rows[channel] - np.sum(weight * values[:, larger], 1)[:, None]
    return result


def _correlation_by_inputs(rows: list[Array], fitted: FittedModel[CauseT]) -> Array:
    """Return the correlation (B, K, K) of the channels' residuals that the unknowns of their epoch cause."""
    basis = fitted.fit.whitened.local_basis[:, : len(rows)] * np.isfinite(np.stack(rows, 1))
    covariance = np.eye(len(rows)) - basis @ basis.transpose(0, 2, 1)
    scale = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), _ROUNDING))
    return np.asarray(covariance / (scale[:, :, None] * scale[:, None, :]))


def _groups_of_residuals(fitted: FittedModel[CauseT], factor: Array) -> list[Array]:
    """Return residuals (B, q) by group. Where observations are numbers: those of each channel, NaN where unseen. In
    space: those of all inputs together, and for each group of channels those of the projection on smooth fields over
    its places, along its own axes. Residuals are multiplied by a factor (B, K)."""
    measured, whitened = fitted.measured, fitted.fit.whitened
    epochs, channels, size = measured.values.shape
    if size == 1:
        scaled = fitted.standardised * factor[..., None]
        return [scaled[:, channel] for channel in range(channels)]
    height = channels * size
    rest = whitened.rest[: epochs * (height + whitened.problem.local_value.shape[1])].reshape(epochs, -1)
    of_groups = [rest[:, height + fitted.input_rows.start : height + fitted.input_rows.stop]]
    axes = (
        measured.whitener @ fitted.fit.frames.R[:, None] @ fitted.model.rotations(fitted.fit.shared, fitted.fit.local)
    )
    in_space = rest[:, :height].reshape(epochs, channels, size) * factor[..., None]
    along = np.einsum("bkij,bki->bkj", axes, in_space)
    for group in np.unique(fitted.model.channel_groups):
        members = fitted.model.channel_groups == group
        fields = _fields(np.asarray(fitted.scene.shape, float)[members])
        of_groups.append(np.einsum("bki,kp->bpi", along[:, members], fields).reshape(epochs, -1))
    return of_groups


def _squares(rows: Array) -> float:
    """Return the sum of squares of centred residuals (B, q), without epochs that hold a gap."""
    finite_rows = rows[np.isfinite(rows).all(1)]
    return float(np.sum(centred(finite_rows) ** 2)) if len(finite_rows) else 0.0


def courses(rows: Array) -> Iterator[Array]:
    """Yield the leading principal components (n, 1) of rows (n, q) that exceed noise of the same size; none of few
    epochs.

    Noise is drawn as many times; its size follows from the median of all components, most of which are noise.
    """
    count = min(len(rows) - 1, rows.shape[1])
    if len(rows) < FEWEST_EPOCHS or not (about := centred(rows)).any():
        return
    left, size, _ = np.linalg.svd(about, full_matrices=False)
    rng = np.random.default_rng(len(rows))
    drawn = [
        np.linalg.svd(centred(rng.normal(size=rows.shape)), compute_uv=False)[:count] for _ in range(_DRAWS_OF_NOISE)
    ]
    limit = float(np.median(size[:count]) * np.max([sizes_drawn[0] / np.median(sizes_drawn) for sizes_drawn in drawn]))
    for k in range(min(_MOST_COURSES, int(np.sum(size[:count] > limit)))):
        yield left[:, k : k + 1] * size[k]


def _fields(places: Array) -> Array:
    """Return smooth orthonormal patterns (K, p) over places (K, 0 to 3), a common shift among them."""
    ones = np.ones((len(places), 1))
    if not places.shape[1] or len(places) < 2:
        return orthonormal(ones)
    return orthonormal(np.column_stack([ones, *smooth_functions(places[:, :2], _FIELDS, (_SCALE_OF_FIELDS,))]))
