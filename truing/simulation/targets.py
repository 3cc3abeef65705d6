"""Targets on the bodies of a parallel mechanism: which body carries each."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import NDArray

BASE, PLATFORM, LEG = 0, 1, 2


@dataclass(frozen=True)
class Targets:
    """K targets: which kind of body carries each, and which leg it belongs to (counted from 0).

    ``leg`` is the leg that a LEG target rides on, or the attachment that a PLATFORM target sits on; -1 for none.
    ``names`` and ``bodies`` are those of the tables, where they are told.
    """

    body: NDArray  # (K,) of BASE, PLATFORM, LEG
    leg: NDArray  # (K,) int
    names: tuple[str, ...] = ()
    bodies: tuple[str, ...] = ()

    @property
    def at_attachment(self) -> NDArray:
        """Return which targets (K,) sit on an attachment."""
        return (self.body == PLATFORM) & (self.leg >= 0)
