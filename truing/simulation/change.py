"""Derivatives of a state, field by field: what one cause or one parameter changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Change:
    """Derivatives of the state by P parameters, field by field; a field that does not change is absent.

    Values: (..., L, 3, P) for a, b, u; (..., L, P) for rho, indicated, l, delta_bz. Leading axes are poses, or
    broadcast against them.
    """

    fields: dict[str, NDArray]
    size: int

    def get(self, name: str, shape: tuple[int, ...]) -> NDArray:
        """Return a field's derivative, or zeros of the shape that it would have."""
        found = self.fields.get(name)
        return np.zeros((*shape, self.size)) if found is None else found
