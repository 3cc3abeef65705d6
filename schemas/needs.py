"""Needs that a next measurement serves, the most urgent first."""

from __future__ import annotations

from enum import StrEnum


class Need(StrEnum):
    """Need that a next measurement serves, the most urgent first."""

    REQUIREMENT = "requirement"
    RIVAL = "rival"
    PRECISION = "precision"
    TESTABLE = "testable"

    @property
    def rank(self) -> int:
        """Index in the order of urgency."""
        return list(Need).index(self)
