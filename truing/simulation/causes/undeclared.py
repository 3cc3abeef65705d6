"""What causes without a name have in common: terms of functions of columns, within the range of these."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from truing.simulation.causes.following import ORDER, TIME

# What is in proportion to one column is so many times as likely beforehand as any other form.
IN_PROPORTION = 4.0
# So many further terms may a form have that was found of lower degree.
FURTHER = 2
# A range counts as reached a hair beyond its ends.
_EDGE = 1e-6


class Undeclared:
    """Something that follows ``columns``, counted from ``centres`` in ``half_ranges``, by terms ``first`` .. ``degree``
    of a form that nobody declared; what follows a column ``of_time`` ends with the campaign."""

    of_time: ClassVar[frozenset[str]] = frozenset({TIME, ORDER})
    columns: tuple[str, ...]
    centres: tuple[float, ...]
    half_ranges: tuple[float, ...]
    degree: int
    first: int

    @property
    def goes_on(self) -> bool:
        """Return whether it holds the further terms of a form of lower degree."""
        return self.first > 1

    @property
    def lasts(self) -> bool:
        """Return whether it stays with what it concerns: not what follows the time."""
        return not self.of_time & set(self.columns)

    @property
    def terms(self) -> str:
        """Return which terms it has, for its name."""
        return f"{self.first} to {self.degree}" if self.goes_on else str(self.degree)

    @property
    def in_proportion(self) -> bool:
        """Return whether it is a line along one column."""
        return len(self.columns) == self.degree == 1

    def within(self, covariates: Mapping[str, NDArray], poses: int) -> NDArray:
        """Return the poses (B,) within the range of what it follows, beyond which its form says nothing."""
        inside = np.ones(poses, bool)
        # What has a range and names no column is everywhere within reach.
        for column, centre, half in zip(self.columns, self.centres, self.half_ranges, strict=bool(self.columns)):
            if (values := covariates.get(column)) is not None and values.ndim == 1:
                inside &= np.abs(values - centre) <= half * (1.0 + _EDGE)
        return inside
