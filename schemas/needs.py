"""What a next measurement serves, in the order in which a reader needs it."""

from __future__ import annotations

from enum import StrEnum


class Need(StrEnum):
    """What a next measurement serves; those before come first."""

    REQUIREMENT = "requirement"
    RIVAL = "rival"
    PRECISION = "precision"
    TESTABLE = "testable"

    @property
    def rank(self) -> int:
        """The place in the order of needs, from 0."""
        return list(Need).index(self)
