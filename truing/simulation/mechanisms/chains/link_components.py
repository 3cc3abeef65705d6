"""Errors of one link by components of its joint's frame: shifts and rotations along x, y, z."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array
from truing.estimation.design.observability import pivots


def along_components(modes: NDArray) -> tuple[Array, Array, list[int]]:
    """Return modes (6, r) of one joint turned towards components, the rotation (r, r), and those r components.

    The components alone describe every error that the modes span: their rows of the modes are invertible.
    """
    size = np.concatenate([np.full(3, np.abs(part).max(initial=0.0)) for part in (modes[:3], modes[3:])])
    scaled = modes / np.where(size > 0.0, size, 1.0)[:, None]
    chosen = sorted(pivots(scaled.T))
    left, _, right = np.linalg.svd(scaled[chosen])
    rotation = right.T @ left.T
    return modes @ rotation, rotation, chosen
