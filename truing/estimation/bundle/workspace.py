"""Large arrays of an adjustment, used again at every iteration: fresh memory is as dear as what is computed in it."""

from __future__ import annotations

from collections.abc import Hashable

import numpy as np

from truing.estimation.bundle.network import Array


class Workspace:
    """Arrays by name. What is taken holds until the same name is taken again."""

    def __init__(self) -> None:
        self._arrays: dict[Hashable, Array] = {}

    def take(self, name: Hashable, shape: tuple[int, ...]) -> Array:
        """Return an array of a shape, filled with anything."""
        found = self._arrays.get(name)
        if found is None or found.shape != shape:
            found = self._arrays[name] = np.empty(shape)
        return found
