"""The picture of a straight edge, compiled: what `quad_corners` fits to the pixels along the sides of a quadrangle.

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
