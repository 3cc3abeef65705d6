"""A value with the bounds of its 95 % interval."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Interval:
    """A value with the bounds of its 95 % interval, all in its own unit."""

    value: float
    lower: float
    upper: float
