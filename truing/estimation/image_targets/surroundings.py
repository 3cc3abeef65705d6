"""Grey levels on ellipses concentric with targets, all targets at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_AT_ONCE = 16000  # targets per call: OpenCV's maps are shorter than 2^15


def unit_matrices(semi_axes: Array, angle: Array) -> Array:
    """Return symmetric A (N, 2, 2), with |A (x - centre)| = 1 on ellipses of semi-axes (N, 2), angle (N,) in rad."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
    return (R / semi_axes[:, None, :]) @ R.swapaxes(1, 2)


def sample_ellipses(grey: NDArray, centre: Array, A: Array, radii: tuple[float, ...], count: int) -> Array:
    """Return grey levels (N, len(radii), count), bilinear, clockwise from the x axis of the circle's plane.

    Samples lie at the middles of `count` equal arcs. Beyond the image its outermost pixels go on.
    """
    import cv2

    flat = (len(centre), len(radii) * count)
    x, y = (place.reshape(flat).astype(np.float32) for place in _places(centre, A, radii, count))
    parts = [
        cv2.remap(grey, x[k : k + _AT_ONCE], y[k : k + _AT_ONCE], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for k in range(0, len(x), _AT_ONCE)
    ]
    levels = np.concatenate(parts) if parts else np.empty(flat)
    return levels.reshape(-1, len(radii), count).astype(np.float64)


def inside_image(grey: NDArray, centre: Array, A: Array, radius: float) -> NDArray[np.bool_]:
    """Return which ellipses (N,) of so many times the target's size lie in the image whole."""
    x, y = _places(centre, A, (radius,), 32)
    rows, columns = grey.shape
    return ((x >= 0) & (y >= 0) & (x <= columns - 1) & (y <= rows - 1)).all((1, 2))


def _places(centre: Array, A: Array, radii: tuple[float, ...], count: int) -> tuple[Array, Array]:
    """Return x and y (N, len(radii), count) of the middles of arcs of ellipses."""
    turn = (np.arange(count) + 0.5) * 2 * np.pi / count
    circle = np.stack([np.cos(turn), np.sin(turn)])
    along = np.linalg.inv(A) @ circle if len(A) else np.empty((0, 2, count))
    place = centre[:, :, None, None] + along[:, :, None, :] * np.asarray(radii)[:, None]
    return place[:, 0], place[:, 1]
