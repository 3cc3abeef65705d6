"""The picture of a straight edge, compiled, and the pixels beside one: what `quad_corners` fits along a quadrangle.

A pixel at t along the edge (0 to 1), d across it and a share a of the band's half width aside shows

    I = (ground + contrast Phi(z)) (1 + along (t - 1/2) + across a),        z = (d - (1 - t) first - t last) / blur.

Importing this module imports numba.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from truing.estimation import lane_arithmetic
from truing.estimation.image_targets import edge_picture
from truing.estimation.image_targets.edge_picture import INV_SQRT2PI, decay, upper_tail
from truing.estimation.lane_arithmetic import compiled, inner, summing

UNKNOWNS = 7
FIRST, LAST, BLUR, GROUND, CONTRAST, ALONG, ACROSS = range(UNKNOWNS)


@inner
def _fill_rows(u: NDArray, blur: tuple[float, float], pixels: tuple, rows: NDArray) -> None:
    """Fill rows (8, M) with derivatives and residual over the noise; blur: what counts of it, and whether it moves."""
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


@compiled(__file__, edge_picture.__file__, lane_arithmetic.__file__)
def add_edges(
    values: NDArray,
    patches: NDArray,
    bounds: tuple[float, float],
    grey: NDArray,
    weight: NDArray,
    t: NDArray,
    d: NDArray,
    across: NDArray,
    cost: NDArray,
    normal: NDArray,
    gradient: NDArray,
) -> None:
    """Add to cost (n,), normal matrices (n, 7, 7) and right sides (n, 7) what the pixels of n edges tell at values
    (n, 7): pixels (P, M) by number of their patches (n,); the blur counts within its bounds, px."""
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
    """How far a point lies within the edge through a corner."""
    return -((x - corner[0]) * normal[0] + (y - corner[1]) * normal[1])


@compiled(__file__, edge_picture.__file__, lane_arithmetic.__file__)
def pixels_beside(
    shape: tuple[int, int],
    start: NDArray,
    side: NDArray,
    end: NDArray,
    normal: NDArray,
    before: NDArray,
    after: NDArray,
    first: NDArray,
    middle: NDArray,
    height: int,
    steep: NDArray,
    half_width: NDArray,
    margin: NDArray,
    columns: NDArray,
    rows: NDArray,
    t: NDArray,
    d: NDArray,
    count: NDArray,
) -> None:
    """Fill columns, rows, t and d (n, M), and how many (n,), with the pixels of an image of a shape (h, w) in the bands
    of half widths (n,) px along n edges, a margin (n,) px clear of the neighbours with normals before and after (n, 2),
    zero where there is none. ``middle`` (n, L): where an edge is in column (row, where steep) first (n,) and those that
    follow; up to ``height`` px aside is looked."""
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
