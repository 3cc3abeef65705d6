"""Columns that hold the numbers of another column."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from truing.belonging.plausible_slips import Column
from truing.belonging.relation import Slip, SlipKind, State, Tested

_FEWEST = 5  # different values


def equal_columns(value: NDArray[np.float64], columns: Sequence[Column], relation: str, what: str) -> list[Tested]:
    """Return the columns (N, K) of one quantity that agree in every digit wherever one of them was recorded."""
    found = []
    for first, one in enumerate(columns):
        for second in range(first + 1, len(columns)):
            own, other = value[:, first], value[:, second]
            same = one.quantity == columns[second].quantity and np.array_equal(own, other, equal_nan=True)
            if same and len(np.unique(own[np.isfinite(own)])) >= _FEWEST:
                names = (one.name, columns[second].name)
                slip = Slip(SlipKind.COPIED, what, names)
                found.append(
                    Tested(relation, State.FAILS, "copied", ", ".join(names), 100.0, None, None, "%", (slip,), tried=1)
                )
    return found
