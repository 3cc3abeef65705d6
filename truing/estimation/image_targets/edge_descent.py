"""The descent to the picture of a blurred ellipse that is most like the pixels of its edge. Compiled code only.

A pixel at x shows

    I = (ground + contrast (M + T)) (1 + slope . (x - x_start) / size),        M = Phi(-(d + s^2 k / 2) / s)

with d the distance of x from the ellipse |A (x - centre)| = 1 (outside positive), s the standard deviation of the blur
(optics, and the pixel's own area with 1/12 px^2), and k the curvature there: a blurred edge recedes towards its hollow
side. T is the light of the code's ring, where its word is known. Every pixel counts once, with its own noise, so that
the inverse normal equations are the covariance. Above the top of the range the picture is clipped, and says nothing.
Importing this module imports numba.
"""

from __future__ import annotations

import math

from truing.estimation.image_targets.edge_picture import (
    BLOCK,
    BY,
    DX,
    DY,
    SHARE,
    count_nodes,
    edge_light,
    set_nodes,
)
from truing.estimation.lane_arithmetic import LANES, inner, summing

# Unknowns: centre x, y; A xx, xy, yy; blur s; ground; contrast; slope x, y
UNKNOWNS = 10
CX, CY, AXX, AXY, AYY, BLUR, GROUND, CONTRAST, SLOPE_X, SLOPE_Y = range(UNKNOWNS)
# Registers after the edge's own: derivatives by all unknowns begin at BY; level, what the photograph has more, weight,
# and a row of the normal equations
LEVEL, LEFT, WEIGHT, WEIGHTED, REGISTERS = range(BY + UNKNOWNS, BY + UNKNOWNS + 5)
_MIN_BLUR, _MAX_BLUR = 0.3, 6.0
_STEPS = 16
# Illumination changes by so much of itself from one pixel to the next, one sigma: what is known of it beforehand. The
# picture of a small blurred target cannot tell a slope from a shift.
_SLOPE_SIGMA = 0.001


@inner
def solve(normal, rhs, step, n):  # type: ignore[no-untyped-def]
    """Replace normal (n, n) by its Cholesky factor and step by the solution; False where it is not positive."""
    for i in range(n):
        for j in range(i + 1):
            total = normal[i, j]
            for k in range(j):
                total -= normal[i, k] * normal[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                normal[i, i] = math.sqrt(total)
            else:
                normal[i, j] = total / normal[j, j]
    for i in range(n):
        total = rhs[i]
        for k in range(i):
            total -= normal[i, k] * step[k]
        step[i] = total / normal[i, i]
    for i in range(n - 1, -1, -1):
        total = step[i]
        for k in range(i + 1, n):
            total -= normal[k, i] * step[k]
        step[i] = total / normal[i, i]
    return True


@inner
def lay(p, origin, size, n, pixels, first, nodes, count, lane):  # type: ignore[no-untyped-def]
    """Fill the level that a block of pixels from the first should have, not clipped, and its derivatives.

    Return how many there are, with those that fill the lanes.
    """
    many = min(BLOCK, n - first + -n % LANES)
    cx, cy, ground, contrast, slope_x, slope_y = p[CX], p[CY], p[GROUND], p[CONTRAST], p[SLOPE_X], p[SLOPE_Y]
    for j in range(many):
        lane[DX * BLOCK + j], lane[DY * BLOCK + j] = pixels[0, first + j] - cx, pixels[1, first + j] - cy
    edge_light(p, nodes, count, lane, many)
    from_x, from_y = origin[0] - cx, origin[1] - cy
    for j in range(many):
        lane[LEVEL * BLOCK + j] = pixels[4, first + j]
    for j in range(many):
        edge = lane[SHARE * BLOCK + j] + lane[LEVEL * BLOCK + j]
        rx, ry = (lane[DX * BLOCK + j] - from_x) / size, (lane[DY * BLOCK + j] - from_y) / size
        light = 1.0 + slope_x * rx + slope_y * ry
        flat, factor = ground + contrast * edge, contrast * light
        lane[LEVEL * BLOCK + j] = flat * light
        lane[(BY + CX) * BLOCK + j] *= factor
        lane[(BY + CY) * BLOCK + j] *= factor
        lane[(BY + AXX) * BLOCK + j] *= factor
        lane[(BY + AXY) * BLOCK + j] *= factor
        lane[(BY + AYY) * BLOCK + j] *= factor
        lane[(BY + BLUR) * BLOCK + j] *= factor
        lane[(BY + GROUND) * BLOCK + j], lane[(BY + CONTRAST) * BLOCK + j] = light, edge * light
        lane[(BY + SLOPE_X) * BLOCK + j], lane[(BY + SLOPE_Y) * BLOCK + j] = flat * rx, flat * ry
    return many


@summing
def _product(lane, row, other, many):  # type: ignore[no-untyped-def]
    """Return the scalar product of two registers."""
    total = 0.0
    for j in range(many):
        total += lane[row * BLOCK + j] * lane[other * BLOCK + j]
    return total


@inner
def _add_products(pixels, first, many, top, lane, normal, rhs):  # type: ignore[no-untyped-def]
    """Add what a block of pixels tells to normal equations; return its weighted square sum."""
    for j in range(many):
        lane[WEIGHT * BLOCK + j], lane[LEFT * BLOCK + j] = pixels[3, first + j], pixels[2, first + j]
    for j in range(many):
        level, weight = lane[LEVEL * BLOCK + j], lane[WEIGHT * BLOCK + j]
        left = lane[LEFT * BLOCK + j] - min(level, top)
        lane[LEFT * BLOCK + j], lane[WEIGHTED * BLOCK + j] = left, weight * left
        lane[WEIGHT * BLOCK + j] = weight if level < top else 0.0
    cost = _product(lane, WEIGHTED, LEFT, many)
    for i in range(UNKNOWNS):
        own = (BY + i) * BLOCK
        for j in range(many):
            lane[WEIGHTED * BLOCK + j] = lane[WEIGHT * BLOCK + j] * lane[own + j]
        rhs[i] += _product(lane, WEIGHTED, LEFT, many)
        for k in range(i + 1):
            normal[i, k] += _product(lane, WEIGHTED, BY + k, many)
    return cost


@inner
def _evaluate(p, origin, size, n, pixels, top, held, nodes, count, lane, normal, rhs):  # type: ignore[no-untyped-def]
    """Return the weighted square sum at p over pixels (5, n): x, y, grey, weight, ring light; fill normal and rhs."""
    for i in range(UNKNOWNS):
        rhs[i] = 0.0
        for j in range(UNKNOWNS):
            normal[i, j] = 0.0
    if count:
        set_nodes(p, nodes, count)
    known = 1.0 / (_SLOPE_SIGMA * size) ** 2
    cost = known * (p[SLOPE_X] ** 2 + p[SLOPE_Y] ** 2)
    for i in (SLOPE_X, SLOPE_Y):
        normal[i, i], rhs[i] = known, -known * p[i]
    for i in range(3):
        away = p[BLUR + i] - held[i]
        cost += held[3 + i] * away * away
        normal[BLUR + i, BLUR + i], rhs[BLUR + i] = held[3 + i], -held[3 + i] * away
    for first in range(0, n, BLOCK):
        many = lay(p, origin, size, n, pixels, first, nodes, count, lane)
        cost += _add_products(pixels, first, many, top, lane, normal, rhs)
    return cost


@inner
def _take_over(p, normal, rhs, trial, trial_normal, trial_rhs):  # type: ignore[no-untyped-def]
    """Copy a trial to where the descent stands; copies of slices would take five seconds longer to compile."""
    for i in range(UNKNOWNS):
        p[i], rhs[i] = trial[i], trial_rhs[i]
        for j in range(UNKNOWNS):
            normal[i, j] = trial_normal[i, j]


@inner
def descend(p, origin, size, n, pixels, top, held, small, work):  # type: ignore[no-untyped-def]
    """Improve p by damped Gauss-Newton; return the weighted square sum, -1 where it comes to nothing."""
    normal, rhs, factor, trial_normal, trial_rhs, step, trial, nodes, lane = work
    count = count_nodes(p)
    cost = _evaluate(p, origin, size, n, pixels, top, held, nodes, count, lane, normal, rhs)
    damping, moved = 1e-3, 0.0
    for _ in range(_STEPS):
        for i in range(UNKNOWNS):
            for j in range(i + 1):
                factor[i, j] = normal[i, j]
            factor[i, i] = normal[i, i] * (1 + damping) + 1e-30
        if not solve(factor, rhs, step, UNKNOWNS):
            return -1.0
        for i in range(UNKNOWNS):
            trial[i] = p[i] + step[i]
        trial[BLUR] = min(max(trial[BLUR], _MIN_BLUR), _MAX_BLUR)
        moved = abs(step[CX]) + abs(step[CY])
        if not trial[AXX] * trial[AYY] > trial[AXY] ** 2 or moved > size:
            damping *= 10
            continue
        trial_cost = _evaluate(trial, origin, size, n, pixels, top, held, nodes, count, lane, trial_normal, trial_rhs)
        gained = cost - trial_cost
        if gained >= 0:
            _take_over(p, normal, rhs, trial, trial_normal, trial_rhs)
            cost = trial_cost
        damping *= 0.1 if gained >= 0 else 10.0
        if moved < small and abs(gained) < 0.1 * small * cost:
            return cost
    return cost if moved < 10 * small else -1.0
