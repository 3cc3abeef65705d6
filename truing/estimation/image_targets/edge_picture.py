"""The picture of a blurred ellipse, pixel by pixel, with its derivatives: what `edge_kernel` fits. Compiled code only.

M is the share of the inside's light in a pixel, T that of the segments of its code's ring. The first six unknowns are
centre x and y, A xx, xy and yy with |A (x - centre)| = 1 on the edge, and the standard deviation of the blur.
Importing this module imports numba.
"""

from __future__ import annotations

import math

from truing.estimation.lane_arithmetic import inner

CX, CY, AXX, AXY, AYY, BLUR = range(6)
# An edge is bent where curvature times blur exceeds this, below which the thin edge is right to 0.5 % of the contrast:
# its picture is then integrated round the ellipse, at so many points per semi-major axis over blur (a step of 1.3 sigma
# gives five digits), but for very long ellipses.
_BENT, _NODES, MOST_NODES = 0.4, 4.8, 64
_REACH = 3.5  # blurs: from further away comes no light
_INV_SQRT2, _INV_SQRT2PI = 0.7071067811865476, 0.3989422804014327


@inner
def _foot(p, dx, dy):  # type: ignore[no-untyped-def]
    """Return distance, normal (2), foot from the centre (2), length of the gradient and curvature, of a pixel."""
    ux, uy = p[2] * dx + p[3] * dy, p[3] * dx + p[4] * dy
    q = max(math.sqrt(ux * ux + uy * uy), 1e-6)
    wx, wy = dx / q, dy / q
    gx, gy = (p[2] * ux + p[3] * uy) / q, (p[3] * ux + p[4] * uy) / q
    ahead = (gx * (dx - wx) + gy * (dy - wy)) / (gx * gx + gy * gy)
    # the foot on the tangent is taken back to the curve, along the ray from the centre
    wx, wy = dx - gx * ahead, dy - gy * ahead
    ux, uy = p[2] * wx + p[3] * wy, p[3] * wx + p[4] * wy
    q = max(math.sqrt(ux * ux + uy * uy), 1e-6)
    wx, wy, ux, uy = wx / q, wy / q, ux / q, uy / q
    gx, gy = p[2] * ux + p[3] * uy, p[3] * ux + p[4] * uy
    g = math.sqrt(gx * gx + gy * gy)
    nx, ny = gx / g, gy / g
    tx, ty = -(p[2] * ny - p[3] * nx), -(p[3] * ny - p[4] * nx)  # A applied to the tangent (-ny, nx)
    return nx * (dx - wx) + ny * (dy - wy), nx, ny, wx, wy, g, (tx * tx + ty * ty) / g


@inner
def upper_tail(z, bell):  # type: ignore[no-untyped-def]
    """Return 1 - Phi(z), right to 1e-7, from bell = exp(-z^2 / 2): Abramowitz and Stegun, 7.1.26."""
    x = abs(z) * _INV_SQRT2
    t = 1.0 / (1.0 + 0.3275911 * x)
    poly = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    half = 0.5 * poly * bell
    return half if z >= 0 else 1.0 - half


@inner
def _thin_edge(p, dx, dy, row):  # type: ignore[no-untyped-def]
    """Return M of a pixel at an edge of little curvature; its derivatives by the first six unknowns go into row."""
    s = p[BLUR]
    d, nx, ny, wx, wy, g, k = _foot(p, dx, dy)
    bend = k / (1 + 0.5 * max(k * d, -1.0))
    z = d / s + 0.5 * s * bend
    bell = math.exp(-0.5 * z * z)
    slope = bell * _INV_SQRT2PI
    by_d = -slope / s
    ux, uy = p[AXX] * wx + p[AXY] * wy, p[AXY] * wx + p[AYY] * wy
    row[CX], row[CY] = -by_d * nx, -by_d * ny
    row[AXX], row[AXY], row[AYY] = by_d * ux * wx / g, by_d * (ux * wy + uy * wx) / g, by_d * uy * wy / g
    row[BLUR] = slope * (d / (s * s) - 0.5 * bend)
    return upper_tail(z, bell)


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
def _whole_edge(p, dx, dy, nodes, count, row):  # type: ignore[no-untyped-def]
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
def edge_light(p, dx, dy, nodes, count, row):  # type: ignore[no-untyped-def]
    """Return M of a pixel so far from the centre, exactly where there are nodes; its derivatives go into row."""
    return _whole_edge(p, dx, dy, nodes, count, row) if count else _thin_edge(p, dx, dy, row)


@inner
def count_nodes(p):  # type: ignore[no-untyped-def]
    """Return how many points round the ellipse its exact picture takes, 0 where a thin edge will do."""
    half, skew = (p[AXX] + p[AYY]) / 2, math.hypot((p[AXX] - p[AYY]) / 2, p[AXY])
    a, inverse_b = 1 / max(half - skew, 1e-9), half + skew
    count = math.ceil(_NODES * a / p[BLUR])
    return max(count, 16) if a * inverse_b * inverse_b * p[BLUR] > _BENT and count <= MOST_NODES else 0


@inner
def set_spokes(p, spokes):  # type: ignore[no-untyped-def]
    """Fill spokes (2, S): where the middles of S equal arcs of the unit circle lie, from the centre, clockwise."""
    count, det = spokes.shape[1], p[AXX] * p[AYY] - p[AXY] * p[AXY]
    for j in range(count):
        c, s = math.cos((j + 0.5) * 2 * math.pi / count), math.sin((j + 0.5) * 2 * math.pi / count)
        spokes[0, j], spokes[1, j] = (p[AYY] * c - p[AXY] * s) / det, (p[AXX] * s - p[AXY] * c) / det


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
    total = 0.0
    for k in range(first, first + 2 * half + 1):
        j = k % count
        if ring[j] == 0.0:
            continue
        mx, my = spokes[0, j], spokes[1, j]
        length2 = mx * mx + my * my
        aside2 = (dx * my - dy * mx) ** 2 / length2
        middle = (dx * mx + dy * my) / length2
        wide = s / math.sqrt(length2)
        near, far = (2.0 - middle) / wide, (3.0 - middle) / wide
        if near > _REACH:
            continue
        at_near, at_far = math.exp(-0.5 * near * near), math.exp(-0.5 * far * far)
        step = upper_tail(near, at_near) - upper_tail(far, at_far)
        along = wide * wide * (at_near - at_far) + middle * wide * step / _INV_SQRT2PI
        total += math.exp(-0.5 * aside2 / (s * s)) * along
    det = p[AXX] * p[AYY] - p[AXY] * p[AXY]
    return total / (count * det * s * s)
