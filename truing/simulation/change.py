"""Class `Change`: derivatives of the fields of a state by the parameters of a cause or of a model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Change:
    """Derivatives of a state by P parameters, by field name; fields that do not change are absent.

    Values: (..., L, 3, P) for a, b, u; (..., L, P) for rho, indicated, l, delta_bz. Leading axes are poses, or
    broadcast against them.
    """

    fields: dict[str, NDArray]
    size: int

    def get(self, name: str, shape: tuple[int, ...]) -> NDArray:
        """Return the derivative of a field, or zeros (*shape, P) if the field does not change."""
        variable = self.fields.get(name)
        return np.zeros((*shape, self.size)) if variable is None else variable
