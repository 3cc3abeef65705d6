"""Rendered ellipses and ring targets, integrated over the area of every pixel; shares no code with the measurement."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtr


def pixel_weights(pixels, fine, blur):
    """Return (pixels, n) weights of lines at even fine coordinates (n,) in pixels at 0, 1, ...: Gaussian blur and the
    width of a pixel, exactly."""
    upper = ndtr((np.arange(pixels)[:, None] + 0.5 - fine) / blur)
    return (upper - ndtr((np.arange(pixels)[:, None] - 0.5 - fine) / blur)) * (fine[1] - fine[0])


def ellipse_picture(size, centre, axes, angle, blur, step=0.03):
    """Return (size, size) how much of every pixel a blurred ellipse covers, from 0 to 1.

    Rows of the ellipse are chords, whose blurred ends integrate over a pixel in closed form."""
    c, s = math.cos(angle), math.sin(angle)
    a, b = axes
    # x^T Q x = 1
    qxx, qyy = (c / a) ** 2 + (s / b) ** 2, (s / a) ** 2 + (c / b) ** 2
    qxy = c * s * (a**-2 - b**-2)
    height = math.sqrt(qxx / (qxx * qyy - qxy**2))
    edges = np.linspace(-height, height, int(2 * height / step) + 1)
    y = (edges[1:] + edges[:-1]) / 2
    half = np.sqrt(np.maximum(qxy**2 * y**2 - qxx * (qyy * y**2 - 1), 0)) / qxx
    middle = centre[0] - qxy * y / qxx
    along = chord_light(size, middle - half, blur) - chord_light(size, middle + half, blur)
    return pixel_weights(size, centre[1] + y, blur) @ along


def chord_light(size, start, blur):
    """Return (rows, size) the light in pixels of half-lines that begin at start (rows,), blurred."""

    def integral(t):
        return t * ndtr(t / blur) + blur * np.exp(-0.5 * (t / blur) ** 2) / math.sqrt(2 * math.pi)

    x = np.arange(size) - start[:, None]
    return integral(x + 0.5) - integral(x - 0.5)


def ring_target_picture(size, centre, axes, angle, bits, word, turn, blur, fine=12, closed=4.0):
    """Return (size, size) the light of a ring target: dot of radius 1, segments of radius 2 to 3, clockwise from the
    angle `turn` on the target, most significant bit first; the image of its plane is an affine one."""
    half = closed * axes[0]
    n = int(2 * half * fine)
    x = centre[0] - half + (np.arange(n) + 0.5) / fine
    y = centre[1] - half + (np.arange(n) + 0.5) / fine
    dx, dy = x[None, :] - centre[0], y[:, None] - centre[1]
    c, s = math.cos(angle), math.sin(angle)
    u, v = (c * dx + s * dy) / axes[0], (-s * dx + c * dy) / axes[1]
    radius = np.hypot(u, v)
    segment = (np.floor((np.arctan2(v, u) - turn) / (2 * math.pi) * bits).astype(int)) % bits
    lit = (word >> (bits - 1 - segment) & 1).astype(bool)
    scene = (radius < 1) | (lit & (radius > 2) & (radius < 3))
    return pixel_weights(size, y, blur) @ scene.astype(float) @ pixel_weights(size, x, blur).T


def photograph(rng, light, ground, contrast, read_sigma, gain=0.0, top=255):
    """Return light (...) as grey levels uint8 with read and photon noise, rounded and clipped."""
    grey = ground + contrast * light
    noisy = grey + np.sqrt(read_sigma**2 + gain * np.maximum(grey, 0)) * rng.normal(size=light.shape)
    return np.clip(np.rint(noisy), 0, top).astype(np.uint8)
