"""What a network cannot tell is not estimated: elements of interiors are held that few or flat images leave open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from truing.estimation.bundle.determinable import UndeterminedNetworkError
from truing.estimation.bundle.intersection import Mask
from truing.estimation.bundle.network import Network

# In this order: what lenses have least of first, the principal distance last.
ORDER = ("A3", "C2", "C1", "B2", "B1", "A2", "A1", "y0", "x0", "c")


def relaxed(
    network: Network, possible: Mask, error: UndeterminedNetworkError
) -> tuple[Network, Mask, tuple[tuple[str, str], ...]]:
    """Return the network with one element held of those that it does not determine, the rays (N,) that can take part
    without images and points in free directions of their own, and what is held now: (camera, element) or nothing.

    Raises the error again where neither helps.
    """
    open_ = [(camera, name) for name in ORDER for camera, known in error.elements if known == name]
    if open_:
        return _holding(network, *open_[0]), possible, (open_[0],)
    loose = np.isin(network.rays.image, error.images) | np.isin(network.rays.point, error.points)
    if not (possible & loose).any():
        raise error
    return network, possible & ~loose, ()


def _holding(network: Network, camera: str, element: str) -> Network:
    cameras = tuple(
        replace(one, free=tuple(name for name in one.free if name != element)) if one.name == camera else one
        for one in network.cameras
    )
    return replace(network, cameras=cameras)
