"""Array types: real numbers of any precision, booleans, and integers (indices, counts, group numbers)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Key = TypeVar("Key")

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]
Integers = NDArray[np.intp]


def index_or_slice(index: Integers) -> Integers | slice:
    """Return indices (n,) as a slice where they are contiguous, which avoids a copy."""
    return slice(index[0], index[-1] + 1) if len(index) and np.all(np.diff(index) == 1) else index


def grouped(keys: Iterable[Key]) -> dict[Key, list[int]]:
    """Return the places of each key."""
    places: dict[Key, list[int]] = {}
    for place, key in enumerate(keys):
        places.setdefault(key, []).append(place)
    return places
