"""The picture of a blurred ellipse, pixel by pixel, with its derivatives: what `edge_kernel` fits. Compiled code only.

M is the share of the inside's light in a pixel, T that of the segments of its code's ring. The first six unknowns are
centre x and y, A xx, xy and yy with |A (x - centre)| = 1 on the edge, and the standard deviation of the blur.
Importing this module imports numba.
"""

from __future__ import annotations

import math

from truing.estimation.lane_arithmetic import LANES, inner

CX, CY, AXX, AXY, AYY, BLUR = range(6)
# An edge is bent where curvature times blur exceeds this, below which the thin edge is right to 0.5 % of the contrast:
# its picture is then integrated round the ellipse, at so many points per semi-major axis over blur (a step of 1.3 sigma
# gives five digits), but for very long ellipses.
_BENT, _NODES, MOST_NODES = 0.4, 4.8, 64
_REACH = 3.5  # blurs: from further away comes no light
_INV_SQRT2, _INV_SQRT2PI = 0.7071067811865476, 0.3989422804014327


@inner
def _foot(axx, axy, ayy, dx, dy):  # type: ignore[no-untyped-def]
    """Return distance, normal (2), foot from the centre (2), one over the gradient and curvature, of a pixel."""
    ux, uy = axx * dx + axy * dy, axy * dx + ayy * dy
    per = 1.0 / max(math.sqrt(ux * ux + uy * uy), 1e-6)
    wx, wy = dx * per, dy * per
    gx, gy = (axx * ux + axy * uy) * per, (axy * ux + ayy * uy) * per
    ahead = (gx * (dx - wx) + gy * (dy - wy)) / (gx * gx + gy * gy)
    # the foot on the tangent is taken back to the curve, along the ray from the centre
    wx, wy = dx - gx * ahead, dy - gy * ahead
    ux, uy = axx * wx + axy * wy, axy * wx + ayy * wy
    per = 1.0 / max(math.sqrt(ux * ux + uy * uy), 1e-6)
    wx, wy, ux, uy = wx * per, wy * per, ux * per, uy * per
    gx, gy = axx * ux + axy * uy, axy * ux + ayy * uy
    per = 1.0 / math.sqrt(gx * gx + gy * gy)
    nx, ny = gx * per, gy * per
    tx, ty = -(axx * ny - axy * nx), -(axy * ny - ayy * nx)  # A applied to the tangent (-ny, nx)
    return nx * (dx - wx) + ny * (dy - wy), nx, ny, wx, wy, per, (tx * tx + ty * ty) * per


@inner
def fading(t):  # type: ignore[no-untyped-def]
    """Return exp(-t) of t not below 0, to 1e-9: by its series at a part of t, squared; of lanes at once, too."""
    u = min(t, 45.0) * (-1 / 64)
    e = 1 + u * (1 / 8)
    e = 1 + u * (1 / 7) * e
    e = 1 + u * (1 / 6) * e
    e = 1 + u * (1 / 5) * e
    e = 1 + u * (1 / 4) * e
    e = 1 + u * (1 / 3) * e
    e = 1 + u * (1 / 2) * e
    e = 1 + u * e
    e *= e
    e *= e
    e *= e
    e *= e
    e *= e
    return e * e


@inner
def upper_tail(z, bell):  # type: ignore[no-untyped-def]
    """Return 1 - Phi(z), right to 1e-7, from bell = exp(-z^2 / 2): Abramowitz and Stegun, 7.1.26."""
    x = abs(z) * _INV_SQRT2
    t = 1.0 / (1.0 + 0.3275911 * x)
    poly = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    half = 0.5 * poly * bell
    return half if z >= 0 else 1.0 - half


@inner
def _thin_edge(axx, axy, ayy, s, dx, dy):  # type: ignore[no-untyped-def]
    """Return M of a pixel at an edge of little curvature, and its derivatives by the first six unknowns."""
    d, nx, ny, wx, wy, per, k = _foot(axx, axy, ayy, dx, dy)
    bend, sharp = k / (1 + 0.5 * max(k * d, -1.0)), 1.0 / s
    z = d * sharp + 0.5 * s * bend
    bell = fading(0.5 * z * z)
    slope = bell * _INV_SQRT2PI
    by_d = -slope * sharp
    ux, uy, per = axx * wx + axy * wy, axy * wx + ayy * wy, by_d * per
    by_shape = ux * wx * per, (ux * wy + uy * wx) * per, uy * wy * per
    return upper_tail(z, bell), -by_d * nx, -by_d * ny, *by_shape, slope * (d * sharp * sharp - 0.5 * bend)


@inner
def thin_edges(p, pixels, first, lane):  # type: ignore[no-untyped-def]
    """Fill seven registers of lanes with M and its derivatives, of so many pixels from the first on."""
    cx, cy, axx, axy, ayy, s = p[CX], p[CY], p[AXX], p[AXY], p[AYY], p[BLUR]
    for j in range(LANES):
        dx, dy = pixels[0, first + j] - cx, pixels[1, first + j] - cy
        m, x, y, xx, xy, yy, blur = _thin_edge(axx, axy, ayy, s, dx, dy)
        lane[j], lane[LANES + j], lane[2 * LANES + j] = m, x, y
        lane[3 * LANES + j], lane[4 * LANES + j], lane[5 * LANES + j], lane[6 * LANES + j] = xx, xy, yy, blur


@inner
def set_nodes(p, nodes, count):  # type: ignore[no-untyped-def]
    """Fill nodes (6, count): of points round the ellipse cos, sin, x, y from the centre, and normal times length."""
    det = p[AXX] * p[AYY] - p[AXY] * p[AXY]
    turn = 2 * math.pi / count
    for j in range(count):
        c, s = math.cos(j * turn), math.sin(j * turn)
        nodes[0, j], nodes[1, j] = c, s
        nodes[2, j], nodes[3, j] = (p[AYY] * c - p[AXY] * s) / det, (p[AXX] * s - p[AXY] * c) / det
        nodes[4, j], nodes[5, j] = (p[AXX] * c + p[AXY] * s) / det * turn, (p[AXY] * c + p[AYY] * s) / det * turn


@inner
def whole_edge(p, dx, dy, nodes, count, row):  # type: ignore[no-untyped-def]
    """Return M of a pixel exactly, as an integral round the ellipse, with its derivatives by the first six unknowns.

    The Gaussian of the blur is the divergence of r (1 - exp(-r^2 / 2 s^2)) / (2 pi r^2): the light from the inside is
    the flux through the edge. The trapezoidal rule on a closed smooth curve converges faster than any power.
    """
    narrow = 0.5 / (p[BLUR] * p[BLUR])
    total = gx = gy = axx = axy = ayy = wide = 0.0
    for j in range(count):
        rx, ry = nodes[2, j] - dx, nodes[3, j] - dy
        flux = rx * nodes[4, j] + ry * nodes[5, j]
        t = (rx * rx + ry * ry) * narrow
        e = math.exp(-t)
        total += flux * ((1.0 - e) / t if t > 1e-6 else 1.0 - 0.5 * t)
        gx += e * nodes[4, j]
        gy += e * nodes[5, j]
        axx += e * nodes[0, j] * nodes[2, j]
        axy += e * (nodes[0, j] * nodes[3, j] + nodes[1, j] * nodes[2, j])
        ayy += e * nodes[1, j] * nodes[3, j]
        wide += e * flux
    unit = narrow / math.pi
    swept = -unit * 2 * math.pi / count / (p[AXX] * p[AYY] - p[AXY] * p[AXY])
    row[CX], row[CY], row[BLUR] = unit * gx, unit * gy, -unit * wide / p[BLUR]
    row[AXX], row[AXY], row[AYY] = swept * axx, swept * axy, swept * ayy
    return 0.5 * unit * total


@inner
def whole_edges(p, pixels, first, nodes, count, row, lane):  # type: ignore[no-untyped-def]
    """Fill seven registers of lanes with M and its derivatives, exactly, of so many pixels from the first on."""
    for j in range(LANES):
        weighs = pixels[3, first + j] != 0.0
        dx, dy = pixels[0, first + j] - p[CX], pixels[1, first + j] - p[CY]
        lane[j] = whole_edge(p, dx, dy, nodes, count, row) if weighs else 0.0
        for i in range(6):
            lane[(1 + i) * LANES + j] = row[i] if weighs else 0.0


@inner
def edge_light(p, dx, dy, nodes, count, row):  # type: ignore[no-untyped-def]
    """Return M of a pixel so far from the centre, exactly where there are nodes; its derivatives go into row."""
    if count:
        return whole_edge(p, dx, dy, nodes, count, row)
    found = _thin_edge(p[AXX], p[AXY], p[AYY], p[BLUR], dx, dy)
    for i in range(6):
        row[i] = found[1 + i]
    return found[0]


@inner
def count_nodes(p):  # type: ignore[no-untyped-def]
    """Return how many points round the ellipse its exact picture takes, 0 where a thin edge will do."""
    half, skew = (p[AXX] + p[AYY]) / 2, math.hypot((p[AXX] - p[AYY]) / 2, p[AXY])
    a, inverse_b = 1 / max(half - skew, 1e-9), half + skew
    count = math.ceil(_NODES * a / p[BLUR])
    return max(count, 16) if a * inverse_b * inverse_b * p[BLUR] > _BENT and count <= MOST_NODES else 0


@inner
def set_spokes(p, spokes):  # type: ignore[no-untyped-def]
    """Fill spokes (5, S): where the middles of S equal arcs of the unit circle lie, from the centre, clockwise; one
    over their squared distance; the blur in units of their distance, and one over it."""
    count, det = spokes.shape[1], p[AXX] * p[AYY] - p[AXY] * p[AXY]
    for j in range(count):
        c, s = math.cos((j + 0.5) * 2 * math.pi / count), math.sin((j + 0.5) * 2 * math.pi / count)
        x, y = (p[AYY] * c - p[AXY] * s) / det, (p[AXX] * s - p[AXY] * c) / det
        length = math.sqrt(x * x + y * y)
        spokes[0, j], spokes[1, j], spokes[2, j] = x, y, 1.0 / (length * length)
        spokes[3, j], spokes[4, j] = p[BLUR] / length, length / p[BLUR]


@inner
def ring_light(p, dx, dy, ring, spokes):  # type: ignore[no-untyped-def]
    """Return how much of the ring's blurred light falls on a pixel, ring (S,) 0 or 1 clockwise from the x axis.

    Arc by arc from radius 2 to 3: along a spoke the Gaussian integrates in closed form.
    """
    ux, uy = p[AXX] * dx + p[AXY] * dy, p[AXY] * dx + p[AYY] * dy
    q = math.sqrt(ux * ux + uy * uy)
    gx, gy = p[AXX] * ux + p[AXY] * uy, p[AXY] * ux + p[AYY] * uy
    s = p[BLUR]
    if (2.0 - q) * q > _REACH * s * math.sqrt(gx * gx + gy * gy):
        return 0.0
    count = len(ring)
    # a spoke at an angle t from the pixel's passes it at a distance of b q sin t at least
    b = 2.0 / (p[AXX] + p[AYY] + math.hypot(p[AXX] - p[AYY], 2.0 * p[AXY]))
    sine = min(_REACH * s / (b * q), 1.0)
    half = int(math.asin(sine) * count / (2 * math.pi)) + 1
    first = math.floor(math.atan2(uy, ux) * count / (2 * math.pi)) - half
    total, narrow = 0.0, 1.0 / (s * s)
    for k in range(first, first + 2 * half + 1):
        j = k % count
        if ring[j] == 0.0:
            continue
        mx, my, wide, per = spokes[0, j], spokes[1, j], spokes[3, j], spokes[4, j]
        aside = dx * my - dy * mx
        aside2 = aside * aside * spokes[2, j] * narrow
        middle = (dx * mx + dy * my) * spokes[2, j]
        near, far = (2.0 - middle) * per, (3.0 - middle) * per
        if near > 0.0 and near * near + aside2 > _REACH * _REACH:
            continue
        at_near, at_far = fading(0.5 * near * near), fading(0.5 * far * far)
        step = upper_tail(near, at_near) - upper_tail(far, at_far)
        along = wide * wide * (at_near - at_far) + middle * wide * step / _INV_SQRT2PI
        total += fading(0.5 * aside2) * along
    det = p[AXX] * p[AYY] - p[AXY] * p[AXY]
    return total / (count * det * s * s)
