"""Corners of dark quadrangles on a light ground, as intersections of edges fitted to their pixels.

A pixel lies at t along an edge (0 to 1) and at d across it (outside positive); a is d in units of the band's half
width. Its grey value is

    I = (ground + contrast Phi(z)) (1 + along (t - 1/2) + across a);
    z = (d - (1 - t) first - t last) / blur.

The blur includes the pixel's own area. Pixels near a corner are excluded, since two edges appear there. Lens
distortion bends a long edge, so only the part within `_REACH` of a corner is used for it. Importing this module imports
numba.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from truing.arrays import Array, Mask
from truing.compiled_code import compiled, inner, summing
from truing.estimation import simd_arithmetic
from truing.estimation.image_targets import edge_picture
from truing.estimation.image_targets.edge_picture import INV_SQRT2PI, decay, upper_tail
from truing.estimation.image_targets.image_noise import ImageNoise
from truing.estimation.image_targets.patch_fit import SHARPEST, SOFTEST, PatchFit, fit_patches

_REACH = 48.0  # px
_CLEAR = 3.0  # blurs between a pixel and the other edges
_NARROWEST, _WIDEST = 2.5, 6.0  # half width of the band about an edge, px
_SHORTEST = 6.0  # px of an edge that must remain
_LEAST_MODULE = 4.0  # blurs; at a smaller distance, neighbouring cells shift an edge by more than a fiftieth of a pixel
_CHUNK = 24  # edges fitted at once, to fit the processor's cache
# Priors: a sharp picture does not determine the blur; light changes over a marker by a twentieth as one sigma.
_PRIOR = np.array([0.0, 0.0, 0.01, 0.0, 0.0, 400.0, 400.0])
UNKNOWNS = 7
FIRST, LAST, BLUR, GROUND, CONTRAST, ALONG, ACROSS = range(UNKNOWNS)


@dataclass(frozen=True)
class QuadCorners:
    """Corners (Q, 4, 2) in px with covariance (Q, 4, 2, 2) in px^2, contrast (Q,) in grey levels; and the reason (Q,)
    to reject a quadrangle, empty if accepted."""

    xy: Array
    covariance: Array
    contrast: Array
    refused: NDArray[np.str_]


@dataclass(frozen=True)
class _Edges:
    """Edges from ``start`` (E, 2) to ``end`` (E, 2): unit normals (E, 2) outwards, half widths (E,) of the bands,
    normals (E, 2) of the neighbours at start and end, zero without a neighbour."""

    start: Array
    end: Array
    normal: Array
    half_width: Array
    before: Array
    after: Array


class _EdgePixels(NamedTuple):
    """Pixels (P, M) of edges: grey value, weight, position t along the edge, distance d across it in px and in half
    widths of the band."""

    grey: Array
    weight: Array
    t: Array
    d: Array
    across: Array


class _EdgeSums(NamedTuple):
    """Cost (n,), normal matrix (n, 7, 7) and right side (n, 7) of edges, to be filled in."""

    cost: Array
    normal: Array
    gradient: Array


class _Bands(NamedTuple):
    """Bands along n edges from start to end (n, 2), with side = end - start and unit normals (n, 2) outwards.

    Half widths (n,) in px, and a margin (n,) in px to the neighbours with normals before and after (n, 2), zero without
    one.
    """

    start: Array
    side: Array
    end: Array
    normal: Array
    before: Array
    after: Array
    half_width: Array
    margin: Array


class _SearchedPixels(NamedTuple):
    """Pixels to test: position ``middle`` (n, L) of an edge in column (row, if steep) first (n,) and those that follow,
    and pixels up to ``height`` px aside."""

    first: NDArray[np.int64]
    middle: NDArray[np.int64]
    height: int
    steep: Mask


class _PixelPositions(NamedTuple):
    """Columns, rows, t and d (n, M) of the pixels in bands, and their number (n,), to be filled in."""

    columns: NDArray[np.int64]
    rows: NDArray[np.int64]
    t: Array
    d: Array
    n_pixels: NDArray[np.int64]


def refine_quads(grey: NDArray, corners: Array, module_px: Array, noise: ImageNoise) -> QuadCorners:
    """Return refined corners (Q, 4, 2), in order around their quadrangles, in a grey image (h, w), starting within 1.5
    px of the truth.

    ``module_px`` (Q,): least distance of another edge, inside or outside.
    """
    count = len(corners)
    refused = np.zeros(count, dtype="U40")
    xy, covariance = corners.astype(float), np.full((count, 4, 2, 2), np.nan)
    contrast, blur = np.zeros(count), np.ones(count)
    for _ in range(2):  # the second time around the fitted lines, and clear of the corners by the fitted blur
        good = np.flatnonzero(refused == "")
        if not len(good):
            break
        found, blur[good] = _refined(grey, xy[good], module_px[good], blur[good], noise)
        xy[good], covariance[good] = found.xy, found.covariance
        contrast[good], refused[good] = found.contrast, found.refused
    moved = np.linalg.norm(xy - corners, axis=2).max(1, initial=0.0) if count else np.zeros(0)
    refused[(refused == "") & (moved > 3.0)] = "edges elsewhere than its cells"
    refused[(refused == "") & (module_px < _LEAST_MODULE * blur)] = "cells too small for the blur"
    return QuadCorners(xy, covariance, contrast, refused)


def _refined(
    grey: NDArray, corners: Array, module_px: Array, blur: Array, noise: ImageNoise
) -> tuple[QuadCorners, Array]:
    """Return the corners after one fit of their edges, and the blur (Q,) in px of these."""
    edges, quad, at_start, at_end = _edges_of(corners, module_px)
    fit = _fit_edges(grey, edges, blur[quad], noise)
    usable = _usable(fit, edges, noise)
    variance = np.einsum("euu->eu", fit.covariance) * fit.covariance_factor[:, None] * noise.correlation
    # A corner lies on the edge that starts there and on the one that ends there.
    offset = np.stack([fit.values[at_start[..., 0], at_start[..., 1]], fit.values[at_end[..., 0], at_end[..., 1]]], -1)
    spread = np.stack([variance[at_start[..., 0], at_start[..., 1]], variance[at_end[..., 0], at_end[..., 1]]], -1)
    normals = np.stack([edges.normal[at_start[..., 0]], edges.normal[at_end[..., 0]]], -2)
    crossing = np.abs(np.linalg.det(normals)) > 0.2
    inverse = np.linalg.inv(np.where(crossing[..., None, None], normals, np.eye(2)))
    shift = np.einsum("qcij,qcj->qci", inverse, offset)
    covariance = np.einsum("qcij,qcj,qckj->qcik", inverse, spread, inverse)
    count = len(corners)
    bad_edges = np.bincount(quad[~usable], minlength=count) > 0
    refused = np.where(bad_edges, "no straight edges from dark to light", "").astype("U40")
    refused[~crossing.all(1)] = "seen too obliquely"
    sums = np.bincount(quad, minlength=count)
    contrast, found_blur = (np.bincount(quad, np.nan_to_num(fit.values[:, k]), count) / sums for k in (CONTRAST, BLUR))
    xy = corners + np.where(refused[:, None, None] == "", shift, 0.0)
    return QuadCorners(xy, covariance, contrast, refused), np.clip(found_blur, 0.5, 6.0)


def _edges_of(corners: Array, module_px: Array) -> tuple[_Edges, NDArray, NDArray, NDArray]:
    """Return the edges of quadrangles (Q, 4, 2), whole or only both ends of long ones; the quadrangle of each; and edge
    and end at each corner (Q, 4, 2), for the starting and the ending edge."""
    following = np.roll(corners, -1, axis=1)
    side = following - corners
    length = np.linalg.norm(side, axis=2)
    along = side / length[..., None]
    ahead = np.roll(along, -1, axis=1)
    turn = np.sign((along[..., 0] * ahead[..., 1] - along[..., 1] * ahead[..., 0]).sum(1))  # +1: clockwise as seen
    normal = np.stack([along[..., 1], -along[..., 0]], -1) * turn[:, None, None]
    long = length > 2.0 * _REACH
    before, after = np.roll(normal, 1, axis=1), np.roll(normal, -1, axis=1)
    reach = np.where(long, _REACH, length)[..., None] * along
    width = np.broadcast_to(np.clip(0.55 * module_px, _NARROWEST, _WIDEST)[:, None], length.shape)
    none = np.zeros_like(after)
    first = (corners, corners + reach, normal, width, before, np.where(long[..., None], none, after))
    second = (following, following - reach, normal, width, after, none)
    parts = [np.concatenate([a.reshape(-1, *a.shape[2:]), b[long]]) for a, b in zip(first, second, strict=True)]
    number = np.arange(4 * len(corners)).reshape(-1, 4)
    extra = np.full(long.shape, -1)
    extra[long] = 4 * len(corners) + np.arange(long.sum())
    ends = np.where(long, np.stack([extra, np.zeros_like(extra)]), np.stack([number, np.ones_like(number)]))
    quad = np.concatenate([number.ravel() // 4, np.nonzero(long)[0]])
    at_start = np.stack([number, np.full_like(number, FIRST)], -1)
    at_end = np.roll(np.moveaxis(ends, 0, -1), 1, axis=1)
    return _Edges(*parts), quad, at_start, at_end


def _fit_edges(grey: NDArray, edges: _Edges, blur: Array, noise: ImageNoise) -> PatchFit:
    """Return the fit of all edges, in chunks of similar lengths."""
    length = np.linalg.norm(edges.end - edges.start, axis=1)
    order = np.argsort(length)
    extremes = float(grey.min()), float(grey.max())
    patch_fits: list[PatchFit] = []
    for first in range(0, len(order), _CHUNK):
        patch_fits.append(_fit_chunk(grey, extremes, edges, order[first : first + _CHUNK], blur, noise))
    back = np.argsort(order)
    parts = [np.concatenate([getattr(fit, name) for fit in patch_fits])[back] for name in PatchFit.__dataclass_fields__]
    return PatchFit(*parts)


def _fit_chunk(
    grey: NDArray, extremes: tuple[float, float], edges: _Edges, chosen: NDArray, blur: Array, noise: ImageNoise
) -> PatchFit:
    picture, t, d, usable = _pixels(grey, edges, chosen, blur[chosen])
    width = edges.half_width[chosen]
    bottom, top = extremes
    usable &= (picture > bottom) & (picture < top)
    start = np.zeros((len(chosen), UNKNOWNS))
    start[:, BLUR] = blur[chosen]
    dark, light = usable & (d < -0.5 * width[:, None]), usable & (d > 0.5 * width[:, None])
    start[:, GROUND] = _masked_mean(picture, dark, bottom)
    start[:, CONTRAST] = _masked_mean(picture, light, top) - start[:, GROUND]
    expected = start[:, GROUND, None] + start[:, CONTRAST, None] * ndtr(d / blur[chosen][:, None])
    weight = np.where(usable, 1.0 / np.maximum(noise.variance(expected), 1e-12), 0.0)
    pixels = _EdgePixels(picture, weight, t, d, d / width[:, None])

    def equations(values: Array, patches: NDArray[np.intp]) -> tuple[Array, Array, Array]:
        normal = np.tile(np.diag(_PRIOR), (len(values), 1, 1))
        sums = _EdgeSums(np.square(values) @ _PRIOR, normal, -values * _PRIOR)
        add_edges(values, patches, (SHARPEST, SOFTEST), pixels, sums)
        return np.where(np.isfinite(sums.cost), sums.cost, np.inf), sums.normal, sums.gradient

    return fit_patches(equations, start, (weight > 0.0).sum(1))


def _masked_mean(picture: Array, mask: Mask, otherwise: float) -> Array:
    count = mask.sum(1)
    return np.where(count > 0, (picture * mask).sum(1) / np.maximum(count, 1), otherwise)


def _pixels(grey: NDArray, edges: _Edges, chosen: NDArray, blur: Array) -> tuple[Array, Array, Array, Mask]:
    """Return grey values (n, M) in the bands, positions along the edge (0..1) and across it (px, outside positive), and
    the mask of valid ones."""
    start, side = edges.start[chosen], edges.end[chosen] - edges.start[chosen]
    steep = np.abs(side[:, 1]) > np.abs(side[:, 0])
    lead = np.where(steep, 1, 0)
    each = np.arange(len(chosen))
    span = side[each, lead]
    longest = int(np.ceil(np.abs(span).max())) + 1
    # Columns of pixels across the edge, one for every pixel along the image axis nearer to the edge.
    first = np.floor(np.minimum(start[each, lead], start[each, lead] + span)).astype(int)
    main = first[:, None] + np.arange(longest + 1)
    middle = (
        start[each, 1 - lead][:, None] + (main - start[each, lead][:, None]) * (side[each, 1 - lead] / span)[:, None]
    )
    height = int(np.ceil(edges.half_width[chosen].max() * np.sqrt(2.0))) + 1
    most = middle.shape[1] * (2 * height + 1)
    count = np.zeros(len(chosen), np.int64)
    columns, rows = np.zeros((2, len(chosen), most), np.int64)
    t, d = np.zeros((2, len(chosen), most))
    positions = _PixelPositions(columns, rows, t, d, count)
    bands = _Bands(
        start=start,
        side=side,
        end=edges.end[chosen],
        normal=edges.normal[chosen],
        before=edges.before[chosen],
        after=edges.after[chosen],
        half_width=edges.half_width[chosen],
        margin=np.maximum(_CLEAR, _CLEAR * blur),
    )
    edge_pixels(grey.shape, bands, _SearchedPixels(first, np.round(middle).astype(int), height, steep), positions)
    columns, rows, t, d = (values[:, : max(int(count.max()), 1)] for values in (columns, rows, t, d))
    picture = grey[rows, columns].astype(float)
    return picture, np.ascontiguousarray(t), np.ascontiguousarray(d), np.arange(d.shape[1]) < count[:, None]


def _usable(fit: PatchFit, edges: _Edges, noise: ImageNoise) -> Mask:
    """Return the mask (E,) of usable edges: dark inside, light outside, clear of noise, and similar to the model."""
    values = fit.values
    contrast, ground = values[:, CONTRAST], values[:, GROUND]
    quiet = np.sqrt(noise.variance(np.maximum(ground, 0.0)))
    misfit = np.sqrt(fit.chi2 / np.maximum(fit.freedom, 1.0)) * quiet
    with np.errstate(invalid="ignore"):
        good = fit.converged & (contrast > 4.0 * quiet) & (misfit < 0.15 * contrast)
        good &= values[:, BLUR] < 0.9 * edges.half_width
        good &= (np.abs(values[:, [FIRST, LAST]]) < 3.0).all(1)
    good &= np.linalg.norm(edges.end - edges.start, axis=1) >= _SHORTEST + 2.0 * _CLEAR
    return good & np.isfinite(np.einsum("euu->eu", fit.covariance)[:, :2]).all(1)


@inner
def _fill_rows(u: NDArray, blur: tuple[float, float], pixels: tuple, rows: NDArray) -> None:
    """Fill in rows (8, M) with derivatives and residual over the noise; blur: effective value and derivative."""
    grey, weight, t, d, across = pixels
    first, last, ground, contrast, along, aside = u[FIRST], u[LAST], u[GROUND], u[CONTRAST], u[ALONG], u[ACROSS]
    sharp, moves = 1.0 / blur[0], blur[1]
    for m in range(len(grey)):
        back, half, over_noise = 1.0 - t[m], t[m] - 0.5, math.sqrt(weight[m])
        z = (d[m] - back * first - t[m] * last) * sharp
        bell = decay(0.5 * z * z)
        share = 1.0 - upper_tail(z, bell)
        plain, light = (ground + contrast * share) * over_noise, 1.0 + along * half + aside * across[m]
        slope = -contrast * bell * INV_SQRT2PI * sharp * light * over_noise
        rows[FIRST, m], rows[LAST, m], rows[BLUR, m] = back * slope, t[m] * slope, z * slope * moves
        rows[GROUND, m], rows[CONTRAST, m] = light * over_noise, share * light * over_noise
        rows[ALONG, m], rows[ACROSS, m] = plain * half, plain * across[m]
        rows[UNKNOWNS, m] = grey[m] * over_noise - plain * light


@summing
def _product(rows: NDArray, i: int, k: int, n: int) -> float:
    """Return the product of two rows (., n)."""
    total = 0.0
    for m in range(n):
        total += rows[i, m] * rows[k, m]
    return total


@compiled(__file__, edge_picture.__file__, simd_arithmetic.__file__)
def add_edges(
    values: NDArray, patches: NDArray, bounds: tuple[float, float], pixels: _EdgePixels, sums: _EdgeSums
) -> None:
    """Add the pixels of n edges to their sums, at values (n, 7).

    Pixels are selected by patch number (n,); the blur is limited to its bounds, px.
    """
    grey, weight, t, d, across = pixels
    cost, normal, gradient = sums
    rows = np.empty((UNKNOWNS + 1, grey.shape[1]))
    for n in range(len(values)):
        p, u = patches[n], values[n]
        blur = min(max(u[BLUR], bounds[0]), bounds[1])
        moves = 1.0 if blur == u[BLUR] else 0.0
        _fill_rows(u, (blur, moves), (grey[p], weight[p], t[p], d[p], across[p]), rows)
        for i in range(UNKNOWNS):
            gradient[n, i] += _product(rows, i, UNKNOWNS, grey.shape[1])
            for k in range(i + 1):
                product = _product(rows, i, k, grey.shape[1])
                normal[n, i, k] += product
                if k < i:
                    normal[n, k, i] += product
        cost[n] += _product(rows, UNKNOWNS, UNKNOWNS, grey.shape[1])


@inner
def _depth(x: float, y: float, corner: NDArray, normal: NDArray) -> float:
    """Return the distance of a point inside the edge through a corner."""
    return -((x - corner[0]) * normal[0] + (y - corner[1]) * normal[1])


@compiled(__file__, edge_picture.__file__, simd_arithmetic.__file__)
def edge_pixels(shape: tuple[int, int], bands: _Bands, searched: _SearchedPixels, positions: _PixelPositions) -> None:
    """Fill in the positions of the pixels in bands along n edges of an image (h, w)."""
    start, side, end, normal, before, after, half_width, margin = bands
    first, middle, height, steep = searched
    columns, rows, t, d, count = positions
    for n in range(len(start)):
        length = math.sqrt(side[n, 0] ** 2 + side[n, 1] ** 2)
        has_before, has_after = np.any(before[n] != 0.0), np.any(after[n] != 0.0)
        k = 0
        for i in range(middle.shape[1]):
            for other in range(middle[n, i] - height, middle[n, i] + height + 1):
                x, y = (other, first[n] + i) if steep[n] else (first[n] + i, other)
                if x < 0 or y < 0 or x >= shape[1] or y >= shape[0]:
                    continue
                fx, fy = x - start[n, 0], y - start[n, 1]
                across = fx * normal[n, 0] + fy * normal[n, 1]
                along = (fx * side[n, 0] + fy * side[n, 1]) / length**2
                if abs(across) > half_width[n] or along * length < margin[n] or along > 1.0:
                    continue
                if has_before and across <= 0.0 and _depth(x, y, start[n], before[n]) < margin[n]:
                    continue
                if has_after and (1.0 - along) * length < margin[n]:
                    continue
                if has_after and across <= 0.0 and _depth(x, y, end[n], after[n]) < margin[n]:
                    continue
                columns[n, k], rows[n, k], t[n, k], d[n, k] = x, y, along, across
                k += 1
        count[n] = k
