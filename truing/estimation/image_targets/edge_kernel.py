"""Compiled fit of circle edges in a photograph, one target after the other.

A blurred ellipse is fitted to the pixels around each edge, without outlying pixels. The residuals show how elliptic
the edge is. A pixel at x has the grey value

    I = (ground + contrast (M + T)) (1 + slope . (x - x_start) / size),        M = Phi(-(d + s^2 k / 2) / s).

d is the distance of x from the ellipse |A (x - centre)| = 1 (outside positive), and k is the curvature there: blur
shifts an edge towards its concave side. s is the standard deviation of the blur (optics, and the pixel's own area with
1/12 px^2). T is the light of the code's ring, if its word is known (both: `edge_picture`). Each pixel counts once with
its own noise, so the inverse normal equations are the covariance. At the top of the range the image is clipped; such
pixels carry no information.

Written here because image processing libraries give centres without a covariance. Importing this module imports numba.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Mask
from truing.compiled_code import compiled, inner, summing
from truing.estimation import simd_arithmetic
from truing.estimation.image_targets import edge_picture
from truing.estimation.image_targets.edge_picture import (
    BLOCK,
    BY,
    DX,
    DY,
    MOST_NODES,
    SHARE,
    count_nodes,
    decay,
    edge_light,
    ring_light,
    set_nodes,
    set_spokes,
    upper_tail,
)
from truing.estimation.simd_arithmetic import LANES

# Unknowns: centre x, y; A xx, xy, yy; blur s; ground; contrast; slope x, y
UNKNOWNS = 10
CX, CY, AXX, AXY, AYY, BLUR, GROUND, CONTRAST, SLOPE_X, SLOPE_Y = range(UNKNOWNS)
# Registers after the edge's own: derivatives by all unknowns begin at BY; level, residual, weight, and a row of the
# normal equations
LEVEL, LEFT, WEIGHT, WEIGHTED, REGISTERS = range(BY + UNKNOWNS, BY + UNKNOWNS + 5)
_MIN_BLUR, _MAX_BLUR = 0.3, 6.0
_STEPS = 16
# Prior of the illumination gradient: relative change from one pixel to the next, one sigma. The picture of a small
# blurred target cannot separate gradient and shift.
_SLOPE_SIGMA = 0.001
# Results of a fit after its unknowns: covariance xx xy yy of the centre; mean square of weighted residuals and its
# degrees of freedom, the same of arcs of the edge; distance of the worst arc outside the ellipse, px; share of
# outlying pixels inside and outside the edge; rms of residuals over the contrast; converged
RESULTS = UNKNOWNS + 12
C_XX, C_XY, C_YY, CHI2, FREEDOM, ARC_CHI2, ARC_FREEDOM, DENT, HIDDEN, MERGED, MISFIT, SETTLED = range(UNKNOWNS, RESULTS)
# px, step of the centre after which the next one is negligible; and the same if another fit follows
_SMALL_STEP, _COARSE_STEP = 1e-3, 2e-2
_RELAID, _BRIGHT = 2, 0.01  # repetitions if the light of a ring exceeds this share of the contrast
_ARC, _ARCS_LEAST, _ARCS_MOST = 3.0, 8, 24  # px, length of an arc; least and largest number of arcs
_DENT_SIGMAS = 4.0
_HELD_BLUR = 0.5  # px, while levels are held: a narrow strip cannot separate blur, levels and size
# Relative to the contrast: least and largest limit beyond which a pixel is excluded; sharpening in a camera overshoots
# by up to 0.2.
_OUTLYING_LEAST, _OUTLYING = 0.03, 0.25
# Share of pixels slightly off, due to demosaicing, that indicates no other object; inside small dots with few pixels,
# one or two may be further off.
_FEW, _OTHER = 2, 0.1
_OUTLYING_SIGMAS = 5.0


class Picture(NamedTuple):
    """Photograph (h, w) uint16, noise (2,) as variance of a black pixel and per grey level, and top of the range."""

    grey: NDArray[np.uint16]
    noise: Array
    top: float


class EdgeTargets(NamedTuple):
    """Start values (N, UNKNOWNS) of targets, code rings (N, S) of those ``coded`` (N,), and limits ``outer`` (N,) of
    pixels in radii."""

    start: Array
    ring: Array
    coded: Mask
    outer: Array


class Patch(NamedTuple):
    """Pixels (5, most) around an edge: x, y, grey, weight, ring light; their number n; origin, size and top of the
    model's light."""

    pixels: Array
    n: int
    origin: tuple[float, float]
    size: float
    top: float


class FitWorkspace(NamedTuple):
    """Arrays that all fits of a call use one after the other."""

    normal: Array
    rhs: Array
    factor: Array
    trial_normal: Array
    trial_rhs: Array
    step: Array
    trial: Array
    nodes: Array
    lane: Array
    held: Array
    arcs: Array


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
def fill_block(p, patch, first, nodes, count, lane):  # type: ignore[no-untyped-def]
    """Fill in the unclipped level of a block of pixels from the first, and its derivatives.

    Returns the number of pixels, including padding to full SIMD lanes.
    """
    pixels, n, origin, size, _ = patch
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
    """Add a block of pixels to the normal equations; return its weighted square sum."""
    for j in range(many):
        lane[WEIGHT * BLOCK + j], lane[LEFT * BLOCK + j] = pixels[3, first + j], pixels[2, first + j]
    for j in range(many):
        level, weight = lane[LEVEL * BLOCK + j], lane[WEIGHT * BLOCK + j]
        left = lane[LEFT * BLOCK + j] - min(level, top)
        lane[LEFT * BLOCK + j], lane[WEIGHTED * BLOCK + j] = left, weight * left
        lane[WEIGHT * BLOCK + j] = weight if level < top else 0.0
    cost = _product(lane, WEIGHTED, LEFT, many)
    for i in range(UNKNOWNS):
        diagonal_block = (BY + i) * BLOCK
        for j in range(many):
            lane[WEIGHTED * BLOCK + j] = lane[WEIGHT * BLOCK + j] * lane[diagonal_block + j]
        rhs[i] += _product(lane, WEIGHTED, LEFT, many)
        for k in range(i + 1):
            normal[i, k] += _product(lane, WEIGHTED, BY + k, many)
    return cost


@inner
def _evaluate(p, patch, count, work, normal, rhs):  # type: ignore[no-untyped-def]
    """Return the weighted square sum at p over the pixels of a patch; fill in normal and rhs."""
    held, nodes, lane = work.held, work.nodes, work.lane
    for i in range(UNKNOWNS):
        rhs[i] = 0.0
        for j in range(UNKNOWNS):
            normal[i, j] = 0.0
    if count:
        set_nodes(p, nodes, count)
    known = 1.0 / (_SLOPE_SIGMA * patch.size) ** 2
    cost = known * (p[SLOPE_X] ** 2 + p[SLOPE_Y] ** 2)
    for i in (SLOPE_X, SLOPE_Y):
        normal[i, i], rhs[i] = known, -known * p[i]
    for i in range(3):
        away = p[BLUR + i] - held[i]
        cost += held[3 + i] * away * away
        normal[BLUR + i, BLUR + i], rhs[BLUR + i] = held[3 + i], -held[3 + i] * away
    for first in range(0, patch.n, BLOCK):
        many = fill_block(p, patch, first, nodes, count, lane)
        cost += _add_products(patch.pixels, first, many, patch.top, lane, normal, rhs)
    return cost


@inner
def _accept_trial(p, normal, rhs, trial, trial_normal, trial_rhs):  # type: ignore[no-untyped-def]
    """Copy a trial to the current state; copies of slices would take five seconds longer to compile."""
    for i in range(UNKNOWNS):
        p[i], rhs[i] = trial[i], trial_rhs[i]
        for j in range(UNKNOWNS):
            normal[i, j] = trial_normal[i, j]


@inner
def descend(p, patch, small, work):  # type: ignore[no-untyped-def]
    """Improve p by damped Gauss-Newton; return the weighted square sum, -1 on failure."""
    normal, rhs, factor, step, trial = work.normal, work.rhs, work.factor, work.step, work.trial
    count = count_nodes(p)
    cost = _evaluate(p, patch, count, work, normal, rhs)
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
        if not trial[AXX] * trial[AYY] > trial[AXY] ** 2 or moved > patch.size:
            damping *= 10
            continue
        trial_cost = _evaluate(trial, patch, count, work, work.trial_normal, work.trial_rhs)
        gained = cost - trial_cost
        if gained >= 0:
            _accept_trial(p, normal, rhs, trial, work.trial_normal, work.trial_rhs)
            cost = trial_cost
        damping *= 0.1 if gained >= 0 else 10.0
        if moved < small and abs(gained) < 0.1 * small * cost:
            return cost
    return cost if moved < 10 * small else -1.0


@inner
def _gather(picture, p, target, pixels):  # type: ignore[no-untyped-def]
    """Fill in pixels (5, most) around the edge, out to `outer` radii, padded to full SIMD lanes with zero weight;
    return their number."""
    (grey, noise, _), (ring, coded, outer) = picture, target
    det = p[AXX] * p[AYY] - p[AXY] * p[AXY]
    reach = 3.0 * p[BLUR] + 1.0
    half_x = math.hypot(p[AYY], p[AXY]) / det + reach
    half_y = math.hypot(p[AXX], p[AXY]) / det + reach
    rows, columns = grey.shape
    spokes = np.empty((4, 2 * len(ring)))
    if coded:
        set_spokes(p, ring, spokes)
    n = 0
    for y in range(max(0, math.ceil(p[CY] - half_y)), min(rows - 1, math.floor(p[CY] + half_y)) + 1):
        for x in range(max(0, math.ceil(p[CX] - half_x)), min(columns - 1, math.floor(p[CX] + half_x)) + 1):
            dx, dy = x - p[CX], y - p[CY]
            ux, uy = p[AXX] * dx + p[AXY] * dy, p[AXY] * dx + p[AYY] * dy
            q = math.sqrt(ux * ux + uy * uy)
            if q > outer:
                continue
            gx, gy = p[AXX] * ux + p[AXY] * uy, p[AXY] * ux + p[AYY] * uy
            slope = math.sqrt(gx * gx + gy * gy) / max(q, 1e-9)
            if abs(q - 1.0) > reach * slope or n + LANES >= pixels.shape[1]:
                continue
            light = ring_light(p, dx, dy, spokes) if coded else 0.0
            depth = (q - 1.0) / max(slope, 1e-9) / p[BLUR]
            expected = p[GROUND] + p[CONTRAST] * (upper_tail(depth, decay(0.5 * depth * depth)) + light)
            pixels[0, n], pixels[1, n], pixels[2, n] = x, y, grey[y, x]
            pixels[3, n] = 1.0 / (noise[0] + noise[1] * max(expected, 0.0))
            pixels[4, n] = light
            n += 1
    for m in range(n, n + -n % LANES):
        for i in range(5):
            pixels[i, m] = pixels[i, n - 1] if i != 3 else 0.0
    return n


@inner
def _is_lit(pixels, n):  # type: ignore[no-untyped-def]
    """True if the light of a ring falls on any of the pixels."""
    brightest = 0.0
    for m in range(n):
        brightest = max(brightest, pixels[4, m])
    return brightest > _BRIGHT


@inner
def _drop_outlying(p, patch, first, work, result):  # type: ignore[no-untyped-def]
    """Exclude outlying pixels and set their shares inside and outside; return the number of pixels left."""
    inside = outside = hidden = merged = 0
    pixels, n, _, _, top = patch
    remaining = n
    nodes, lane, count = work.nodes, work.lane, count_nodes(p)
    if count:
        set_nodes(p, nodes, count)
    off = np.empty(n)
    for m in range(n):
        if m % BLOCK == 0:
            fill_block(p, patch, m, nodes, count, lane)
        off[m] = abs(pixels[2, m] - min(lane[LEVEL * BLOCK + m % BLOCK], top))
    # five sigmas, from the mean of absolute values
    usual = _OUTLYING if first else min(max(6.25 * off.mean() / abs(p[CONTRAST]), _OUTLYING_LEAST), _OUTLYING)
    for m in range(n):
        out = off[m] > usual * abs(p[CONTRAST]) and off[m] * math.sqrt(pixels[3, m]) > _OUTLYING_SIGMAS
        if out:
            pixels[3, m] = 0.0
            remaining -= 1
        other = out and off[m] > _OTHER * abs(p[CONTRAST])
        dx, dy = pixels[0, m] - p[CX], pixels[1, m] - p[CY]
        if (p[AXX] * dx + p[AXY] * dy) ** 2 + (p[AXY] * dx + p[AYY] * dy) ** 2 < 1.0:
            inside += 1
            hidden += other
        else:
            outside += 1
            merged += other
    result[HIDDEN] = max(hidden - _FEW, 0) / max(inside, 1)
    result[MERGED] = merged / max(outside, 1)
    return remaining


@inner
def _set_arc_distances(p, patch, work, result):  # type: ignore[no-untyped-def]
    """Set the distances of arcs from the ellipse: mean square in sigmas, its freedom, and the worst in px. Returns the
    number of unclipped pixels and the sum of their weights. Sharpening or a non-Gaussian blur affects the whole edge
    alike and dents no single arc."""
    pixels, n, _, _, top = patch
    arcs, nodes, lane, count = work.arcs, work.nodes, work.lane, count_nodes(p)
    if count:
        set_nodes(p, nodes, count)
    half, skew = (p[AXX] + p[AYY]) / 2, math.hypot((p[AXX] - p[AYY]) / 2, p[AXY])
    round_px = math.pi * (1 / max(half - skew, 1e-9) + 1 / (half + skew))
    m_arcs = min(max(int(round_px / _ARC), _ARCS_LEAST), arcs.shape[1])
    arcs[:] = 0.0
    seen, weights = 0, 0.0
    for m in range(n):
        j = m % BLOCK
        if j == 0:
            fill_block(p, patch, m, nodes, count, lane)
        level = lane[LEVEL * BLOCK + j]
        if pixels[3, m] == 0.0 or level >= top:
            continue
        x, y = pixels[0, m], pixels[1, m]
        seen, weights = seen + 1, weights + pixels[3, m]
        ux, uy = p[AXX] * (x - p[CX]) + p[AXY] * (y - p[CY]), p[AXY] * (x - p[CX]) + p[AYY] * (y - p[CY])
        k = int((math.atan2(uy, ux) / (2 * math.pi) + 0.5) * m_arcs) % m_arcs
        steep = math.hypot(lane[(BY + CX) * BLOCK + j], lane[(BY + CY) * BLOCK + j])
        rise = math.copysign(steep, p[CONTRAST])
        arcs[0, k] += pixels[3, m] * rise * (pixels[2, m] - level)
        arcs[1, k] += pixels[3, m] * rise * rise
    square, used, worst = 0.0, 0, 0.0
    for k in range(m_arcs):
        if arcs[1, k] > 0:
            off, sigma = arcs[0, k] / arcs[1, k], 1 / math.sqrt(arcs[1, k])
            square += (off / sigma) ** 2
            used += 1
            if abs(off) > _DENT_SIGMAS * sigma and abs(off) > abs(worst):
                worst = off
    result[ARC_FREEDOM] = max(used - 5, 1)
    result[ARC_CHI2], result[DENT] = square / result[ARC_FREEDOM], worst
    return seen, weights


@inner
def _set_covariance(work, result):  # type: ignore[no-untyped-def]
    """Set the covariance of the centre from the final normal equations; return whether it exists."""
    normal, factor, step, unit = work.normal, work.factor, work.step, work.trial
    good = True
    for axis in range(2):
        for i in range(UNKNOWNS):
            unit[i] = 0.0
            for j in range(i + 1):
                factor[i, j] = normal[i, j]
        unit[axis] = 1.0
        good = good and solve(factor, unit, step, UNKNOWNS)
        result[C_XX + axis], result[C_XY + axis] = step[0], step[1]
    return good


@inner
def _fit(picture, target, held_share, pixels, work, result):  # type: ignore[no-untyped-def]
    """Fit one result, starting from the unknowns at its beginning; return whether it converged."""
    p, first, held, coded, top = result[:UNKNOWNS], held_share > 0, work.held, target[1], picture.top
    origin, size = (p[CX], p[CY]), 1.0 / math.sqrt(p[AXX] * p[AYY] - p[AXY] ** 2)
    patch = Patch(pixels, _gather(picture, p, target, pixels), origin, size, top)
    held[0], held[1], held[2] = p[BLUR], p[GROUND], p[CONTRAST]
    if first:
        held[3], held[4] = 1.0 / _HELD_BLUR**2, 1.0 / (held_share * p[CONTRAST]) ** 2
        held[5] = held[4]
    cost = descend(p, patch, _COARSE_STEP, work) if patch.n > 2 * UNKNOWNS else -1.0
    # the light of a ring depends on the position of the dot, so it is repeated
    for _ in range(_RELAID):
        if cost >= 0 and coded and _is_lit(pixels, patch.n):
            patch = Patch(pixels, _gather(picture, p, target, pixels), origin, size, top)
            cost = descend(p, patch, _COARSE_STEP, work)
    if cost < 0:
        return False
    if not first:
        patch = Patch(pixels, _gather(picture, p, target, pixels), origin, size, top)
    remaining = _drop_outlying(p, patch, first, work, result)
    if remaining <= 2 * UNKNOWNS:
        return False
    if not first or remaining < patch.n:
        cost = descend(p, patch, _COARSE_STEP if first else _SMALL_STEP, work)
    if cost < 0:
        return False
    seen, weights = _set_arc_distances(p, patch, work, result)
    if seen <= UNKNOWNS:
        return False
    visible = abs(min(p[GROUND] + p[CONTRAST], top) - min(p[GROUND], top))
    result[CHI2], result[FREEDOM] = cost / (seen - UNKNOWNS), seen - UNKNOWNS
    result[MISFIT] = math.sqrt(cost / weights) / max(visible, 1e-9)
    return first or _set_covariance(work, result)


@compiled(__file__, edge_picture.__file__, simd_arithmetic.__file__)
def fit_edges(picture: Picture, targets: EdgeTargets, held_share: float, most: int, results: Array) -> None:
    """Fill in results (N, RESULTS) of all fits.

    held_share: levels held to a share of the contrast, 0: free; most: largest number of pixels of a fit.
    """
    shape = (UNKNOWNS, UNKNOWNS)
    work = FitWorkspace(
        normal=np.empty(shape),
        rhs=np.empty(UNKNOWNS),
        factor=np.empty(shape),
        trial_normal=np.empty(shape),
        trial_rhs=np.empty(UNKNOWNS),
        step=np.empty(UNKNOWNS),
        trial=np.empty(UNKNOWNS),
        nodes=np.empty((6, MOST_NODES)),
        lane=np.empty(REGISTERS * BLOCK),
        held=np.zeros(6),
        arcs=np.empty((2, _ARCS_MOST)),
    )
    pixels = np.empty((5, most + LANES))
    for t in range(len(targets.start)):
        result = results[t]
        for i in range(UNKNOWNS):
            result[i] = targets.start[t, i]
        target = targets.ring[t], targets.coded[t], targets.outer[t]
        result[SETTLED] = _fit(picture, target, held_share, pixels, work, result)
