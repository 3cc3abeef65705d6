"""Fitted ellipses: their axes, the light that is seen of them and about them, and which of them are one thing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.estimation.image_targets import edge_kernel as edge

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_TOLD = 0.8  # of the range between ground and dot: the highest level at which an edge is sought where light is clipped
_LARGER = 1.4  # times, what another edge is than the same


def matrices(fit: Array) -> Array:
    """Return the matrices (N, 2, 2) that turn the ellipses into unit circles."""
    return fit[:, [[edge.AXX, edge.AXY], [edge.AXY, edge.AYY]]]


def axes_of(fit: Array) -> tuple[Array, Array]:
    """Return semi-axes (N, 2), the major one first, and the angles (N,) of the major ones in (-pi/2, pi/2]."""
    values, vectors = np.linalg.eigh(matrices(fit))
    x, y = vectors[:, 0, 0], vectors[:, 1, 0]
    angle = np.arctan2(y, x)
    angle = np.where(angle > np.pi / 2, angle - np.pi, np.where(angle <= -np.pi / 2, angle + np.pi, angle))
    return 1 / np.maximum(values, 1e-12), angle


def visible_contrast(fit: Array, top: float) -> Array:
    """Return the contrast (N,) of dots (N, RESULTS) as clipped at the top of the range."""
    ground, level = fit[:, edge.GROUND], fit[:, edge.GROUND] + fit[:, edge.CONTRAST]
    return np.abs(np.minimum(level, top) - np.minimum(ground, top))


def unclipped(grey: Array, fit: Array, top: float, left: Array) -> Array:
    """Return levels (N, K) in units of the dots' contrast, of grey levels (N, K) about dots (N, RESULTS): 0 the ground,
    1 what the blur leaves (N,) of the contrast, as both are seen below the top of the range.

    An edge is where half of the light is: near the top of the range where the light is more than the range, and there
    as far as it can be told from clipped levels.
    """
    ground, contrast = fit[:, edge.GROUND], fit[:, edge.CONTRAST]
    low, high = np.minimum(ground, top), np.minimum(ground + contrast * left, top)
    half = np.minimum(ground + contrast * left / 2, low + _TOLD * (high - low))
    half = np.where(contrast > 0, half, np.minimum(ground + contrast * left / 2, high + _TOLD * (low - high)))
    safe = [np.where(np.abs(span) < 1e-6, 1e-6, span)[:, None] for span in (half - low, high - half)]
    above = (grey - half[:, None]) / safe[1]
    return 0.5 + 0.5 * np.where(above > 0, above, (grey - half[:, None]) / safe[0])


def doubles(fit: Array, axes: Array) -> Mask:
    """Return which fits (N,) lie on another one that fits better."""
    from scipy.spatial import cKDTree

    double = np.zeros(len(fit), bool)
    settled = np.flatnonzero(fit[:, edge.SETTLED] > 0.5)
    pairs = cKDTree(fit[settled, :2]).query_pairs(4.0, output_type="ndarray") if len(settled) else np.empty((0, 2), int)
    i, j = settled[pairs].T
    size = axes[:, 1]
    near = np.hypot(*(fit[i, :2] - fit[j, :2]).T) < 0.5 * np.minimum(size[i], size[j])
    near &= np.maximum(size[i], size[j]) < _LARGER * np.minimum(size[i], size[j])
    worse = np.where(fit[i, edge.MISFIT] > fit[j, edge.MISFIT], i, j)
    double[worse[near]] = True
    return double


def on_rings(fit: Array, ringed: Mask) -> Mask:
    """Return which dots (N,) lie on the ring of another, where those have any (N,)."""
    from scipy.spatial import cKDTree

    owner = np.flatnonzero(ringed)
    lies = np.zeros(len(fit), bool)
    if len(owner):
        reach = 3.5 * axes_of(fit[owner])[0][:, 0]
        near = cKDTree(fit[:, :2]).query_ball_point(fit[owner, :2], reach)
        i = np.repeat(owner, [len(part) for part in near])
        j = np.concatenate(near).astype(np.int64)
        radius = np.linalg.norm(np.einsum("nij,nj->ni", matrices(fit[i]), fit[j, :2] - fit[i, :2]), axis=1)
        lies[j[(radius > 1.5) & (radius < 3.2)]] = True
    return lies


def about_others(fit: Array) -> Mask:
    """Return which dots (N,) have another at their middle: what a target is printed on."""
    from scipy.spatial import cKDTree

    size, about = axes_of(fit)[0][:, 1], np.zeros(len(fit), bool)
    pairs = cKDTree(fit[:, :2]).query_pairs(4.0, output_type="ndarray") if len(fit) else np.empty((0, 2), int)
    i, j = np.concatenate([pairs, pairs[:, ::-1]]).T
    apart = np.hypot(*(fit[i, :2] - fit[j, :2]).T)
    about[i[(apart < 0.5 * size[j]) & (size[i] >= _LARGER * size[j])]] = True
    return about
