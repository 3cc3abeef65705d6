"""Compiled image model of a blurred ellipse with derivatives, per pixel, as fitted by `edge_kernel`.

M is the share of the inside's light in a pixel, T that of the segments of its code's ring. The first six unknowns:
centre x and y; A xx, xy and yy, where |A (x - centre)| = 1 on the edge; standard deviation of the blur. M is computed
for a block of pixels at once, loop by loop, in registers of one flat array: the compiler vectorises such loops.
Importing this module imports numba.
"""

from __future__ import annotations

import math

from truing.compiled_code import inner, summing
from truing.estimation.simd_arithmetic import LANES

BLOCK = 8 * LANES  # length of a register: a block of pixels that fits the processor's cache
CX, CY, AXX, AXY, AYY, BLUR = range(6)
# Registers: pixel position relative to the centre, M, and its derivatives by the first six unknowns
DX, DY, SHARE, BY = range(4)
# An edge is curved if curvature times blur exceeds this; below, the thin edge is accurate to 0.5 % of the contrast.
# The picture of a curved edge is integrated around the ellipse, at this many points per semi-major axis over blur (a
# step
# of 1.3 sigma gives five digits), except for very long ellipses.
_BENT, _NODES, MOST_NODES = 0.4, 4.8, 64
_REACH = 3.5  # blurs: light from further away is neglected
_ONE_IN = (1 / 12, 1 / 11, 1 / 10, 1 / 9, 1 / 8, 1 / 7, 1 / 6, 1 / 5, 1 / 4, 1 / 3, 1 / 2, 1.0)
_INV_SQRT2, INV_SQRT2PI = 0.7071067811865476, 0.3989422804014327


@inner
def _foot(axx, axy, ayy, dx, dy):  # type: ignore[no-untyped-def]
    """Return distance, normal (2), foot from the centre (2), length of the gradient and curvature, for a pixel."""
    ux, uy = axx * dx + axy * dy, axy * dx + ayy * dy
    per = 1.0 / max(math.sqrt(ux * ux + uy * uy), 1e-6)
    wx, wy = dx * per, dy * per
    gx, gy = (axx * ux + axy * uy) * per, (axy * ux + ayy * uy) * per
    ahead = (gx * (dx - wx) + gy * (dy - wy)) / max(gx * gx + gy * gy, 1e-30)
    # move the foot from the tangent back to the curve, along the ray from the centre
    wx, wy = dx - gx * ahead, dy - gy * ahead
    ux, uy = axx * wx + axy * wy, axy * wx + ayy * wy
    per = 1.0 / max(math.sqrt(ux * ux + uy * uy), 1e-6)
    wx, wy, ux, uy = wx * per, wy * per, ux * per, uy * per
    gx, gy = axx * ux + axy * uy, axy * ux + ayy * uy
    g = max(math.sqrt(gx * gx + gy * gy), 1e-15)
    nx, ny = gx / g, gy / g
    tx, ty = -(axx * ny - axy * nx), -(axy * ny - ayy * nx)  # A applied to the tangent (-ny, nx)
    return nx * (dx - wx) + ny * (dy - wy), nx, ny, wx, wy, g, (tx * tx + ty * ty) / g


@inner
def decay(t):  # type: ignore[no-untyped-def]
    """Return exp(-t) of t >= 0 to a relative 1e-10 up to 40, constant beyond; loops with it vectorise."""
    y = min(t, 40.0) * -0.015625
    e = 1.0
    for one_in in _ONE_IN:
        e = 1.0 + y * one_in * e
    e *= e  # six times: to the power of 64
    e *= e
    e *= e
    e *= e
    e *= e
    return e * e


@inner
def upper_tail(z, bell):  # type: ignore[no-untyped-def]
    """Return 1 - Phi(z) to 1e-7, from bell = exp(-z^2 / 2): Abramowitz and Stegun, 7.1.26."""
    x = abs(z) * _INV_SQRT2
    t = 1.0 / (1.0 + 0.3275911 * x)
    poly = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    half = 0.5 * poly * bell
    return half if z >= 0 else 1.0 - half


@inner
def _thin_edge(axx, axy, ayy, s, lane, many):  # type: ignore[no-untyped-def]
    """Fill in M of pixels at an edge of little curvature, and its derivatives."""
    for j in range(many):
        d, nx, ny, wx, wy, g, k = _foot(axx, axy, ayy, lane[DX * BLOCK + j], lane[DY * BLOCK + j])
        bend = k / (1 + 0.5 * max(k * d, -1.0))
        z = d / s + 0.5 * s * bend
        bell = decay(0.5 * z * z)
        slope = bell * INV_SQRT2PI
        by_d = -slope / s
        ux, uy = (axx * wx + axy * wy) / g, (axy * wx + ayy * wy) / g
        lane[SHARE * BLOCK + j] = upper_tail(z, bell)
        lane[(BY + CX) * BLOCK + j], lane[(BY + CY) * BLOCK + j] = -by_d * nx, -by_d * ny
        lane[(BY + AXX) * BLOCK + j], lane[(BY + AYY) * BLOCK + j] = by_d * ux * wx, by_d * uy * wy
        lane[(BY + AXY) * BLOCK + j] = by_d * (ux * wy + uy * wx)
        lane[(BY + BLUR) * BLOCK + j] = slope * (d / (s * s) - 0.5 * bend)


@inner
def set_nodes(p, nodes, count):  # type: ignore[no-untyped-def]
    """Fill in nodes (6, count): cos, sin, x, y of points around the ellipse from the centre, and normal times
    length."""
    det = p[AXX] * p[AYY] - p[AXY] * p[AXY]
    turn = 2 * math.pi / count
    for j in range(count):
        c, s = math.cos(j * turn), math.sin(j * turn)
        nodes[0, j], nodes[1, j] = c, s
        nodes[2, j], nodes[3, j] = (p[AYY] * c - p[AXY] * s) / det, (p[AXX] * s - p[AXY] * c) / det
        nodes[4, j], nodes[5, j] = (p[AXX] * c + p[AXY] * s) / det * turn, (p[AXY] * c + p[AYY] * s) / det * turn


@inner
def _whole_edge(p, nodes, count, lane, many):  # type: ignore[no-untyped-def]
    """Fill in M of pixels, as an exact integral around the ellipse, and its derivatives. The Gaussian of the blur is
    the divergence of r (1 - exp(-r^2 / 2 s^2)) / (2 pi r^2): the light from the inside is a flux through the edge.
    The trapezoidal rule on a closed smooth curve converges faster than any power."""
    axx, axy, ayy, s = p[AXX], p[AXY], p[AYY], p[BLUR]
    narrow = 0.5 / (s * s)
    for j in range(SHARE * BLOCK, (BY + 6) * BLOCK):
        lane[j] = 0.0
    for k in range(count):
        c, sine, x, y, nx, ny = nodes[0, k], nodes[1, k], nodes[2, k], nodes[3, k], nodes[4, k], nodes[5, k]
        by_xx, by_xy, by_yy = c * x, c * y + sine * x, sine * y
        for j in range(many):
            rx, ry = x - lane[DX * BLOCK + j], y - lane[DY * BLOCK + j]
            flux = rx * nx + ry * ny
            t = (rx * rx + ry * ry) * narrow
            e = decay(t)
            lane[SHARE * BLOCK + j] += flux * ((1.0 - e) / t if t > 1e-6 else 1.0 - 0.5 * t)
            lane[(BY + CX) * BLOCK + j] += e * nx
            lane[(BY + CY) * BLOCK + j] += e * ny
            lane[(BY + AXX) * BLOCK + j] += e * by_xx
            lane[(BY + AXY) * BLOCK + j] += e * by_xy
            lane[(BY + AYY) * BLOCK + j] += e * by_yy
            lane[(BY + BLUR) * BLOCK + j] += e * flux
    unit = narrow / math.pi
    swept = -unit * 2 * math.pi / count / (axx * ayy - axy * axy)
    for j in range(many):
        lane[SHARE * BLOCK + j] *= 0.5 * unit
        lane[(BY + CX) * BLOCK + j] *= unit
        lane[(BY + CY) * BLOCK + j] *= unit
        lane[(BY + AXX) * BLOCK + j] *= swept
        lane[(BY + AXY) * BLOCK + j] *= swept
        lane[(BY + AYY) * BLOCK + j] *= swept
        lane[(BY + BLUR) * BLOCK + j] *= -unit / s


@inner
def edge_light(p, nodes, count, lane, many):  # type: ignore[no-untyped-def]
    """Fill in M of pixels at DX, DY from the centre and its derivatives; exact if there are nodes."""
    if count:
        _whole_edge(p, nodes, count, lane, many)
    else:
        _thin_edge(p[AXX], p[AXY], p[AYY], p[BLUR], lane, many)


@inner
def count_nodes(p):  # type: ignore[no-untyped-def]
    """Return the number of points around the ellipse for its exact picture, 0 if the thin edge is accurate enough."""
    half, skew = (p[AXX] + p[AYY]) / 2, math.hypot((p[AXX] - p[AYY]) / 2, p[AXY])
    a, inverse_b = 1 / max(half - skew, 1e-9), half + skew
    count = math.ceil(_NODES * a / p[BLUR])
    return max(count, 16) if a * inverse_b * inverse_b * p[BLUR] > _BENT and count <= MOST_NODES else 0


@inner
def set_spokes(p, ring, spokes):  # type: ignore[no-untyped-def]
    """Fill in spokes (4, 2 S), twice around, at the middles of S equal arcs of the unit circle.

    Rows: x and y from the centre, clockwise; one over their squared length; light, from ring (S,) 0 or 1.
    """
    count, det = len(ring), p[AXX] * p[AYY] - p[AXY] * p[AXY]
    for j in range(2 * count):
        c, s = math.cos((j + 0.5) * 2 * math.pi / count), math.sin((j + 0.5) * 2 * math.pi / count)
        x, y = (p[AYY] * c - p[AXY] * s) / det, (p[AXX] * s - p[AXY] * c) / det
        spokes[0, j], spokes[1, j], spokes[2, j], spokes[3, j] = x, y, 1.0 / (x * x + y * y), ring[j % count]


@inner
def ring_light(p, dx, dy, spokes):  # type: ignore[no-untyped-def]
    """Return the share of the ring's blurred light in a pixel."""
    ux, uy = p[AXX] * dx + p[AXY] * dy, p[AXY] * dx + p[AYY] * dy
    q = math.sqrt(ux * ux + uy * uy)
    gx, gy = p[AXX] * ux + p[AXY] * uy, p[AXY] * ux + p[AYY] * uy
    s = p[BLUR]
    if (2.0 - q) * q > _REACH * s * math.sqrt(gx * gx + gy * gy):
        return 0.0
    count = spokes.shape[1] // 2
    # a spoke at angle t from the pixel's direction passes it at a distance of at least b q sin t
    b = 2.0 / (p[AXX] + p[AYY] + math.hypot(p[AXX] - p[AYY], 2.0 * p[AXY]))
    sine = min(_REACH * s / (b * q), 1.0)
    half = int(math.asin(sine) * count / (2 * math.pi)) + 1
    first = (math.floor(math.atan2(uy, ux) * count / (2 * math.pi)) - half) % count
    det = p[AXX] * p[AYY] - p[AXY] * p[AXY]
    return _light_of_spokes(spokes, first, first + 2 * half + 1, dx, dy, s) / (count * det * s * s)


@summing
def _light_of_spokes(spokes, first, last, dx, dy, s):  # type: ignore[no-untyped-def]
    """Return the sum over spokes, each from radius 2 to 3: along a spoke the Gaussian integrates in closed form."""
    total = 0.0
    for j in range(first, last):
        mx, my, per = spokes[0, j], spokes[1, j], spokes[2, j]
        across = (dx * my - dy * mx) / s
        middle, wide = (dx * mx + dy * my) * per, s * math.sqrt(per)
        near, far = (2.0 - middle) / wide, (3.0 - middle) / wide
        at_near, at_far = decay(0.5 * near * near), decay(0.5 * far * far)
        step = upper_tail(near, at_near) - upper_tail(far, at_far)
        along = wide * wide * (at_near - at_far) + middle * wide * step / INV_SQRT2PI
        light = decay(0.5 * across * across * per) * along * spokes[3, j]
        total += 0.0 if near > _REACH else light
    return total
