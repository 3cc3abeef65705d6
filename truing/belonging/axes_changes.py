"""Changes of axes that turn points into their mirror image."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from truing.arrays import Array
from truing.belonging.relation import RecordSlip, SlipKind

_AXES = ("x_mm", "y_mm", "z_mm")


@dataclass(frozen=True)
class AxesChange:
    """A change of axes that undoes a slip: right = recorded @ matrix."""

    slip: RecordSlip
    matrix: Array


def _changes() -> Iterator[AxesChange]:
    """Yield changes of axes that mirror: an odd number of signs, or two axes exchanged."""
    for signs in product((1.0, -1.0), repeat=3):
        if np.prod(signs) < 0.0:
            turned = " and ".join(name for name, sign in zip(_AXES, signs, strict=True) if sign < 0.0)
            yield AxesChange(RecordSlip(SlipKind.SIGN, f"{turned} of points"), np.diag(signs))
    for order in permutations(range(3)):
        matrix = np.eye(3)[:, list(order)]
        if np.linalg.det(matrix) < 0.0:
            moved = " and ".join(_AXES[axis] for axis in range(3) if order[axis] != axis)
            yield AxesChange(RecordSlip(SlipKind.COLUMNS, f"{moved} of points"), matrix)


AXES_CHANGES = tuple(_changes())
"""Every such change."""
