"""Parameters of which one part is common to all legs, and one each leg's own."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import NDArray


@dataclass(frozen=True)
class Split:
    """Which shared unknowns (P,) split a variance, by their place; which of them (P,) all legs have in common; and the
    share of the variance that is in common."""

    places: NDArray
    common: NDArray
    share: float
