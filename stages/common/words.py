"""Words that several stages use."""

from __future__ import annotations

from collections.abc import Sequence

from truing.report.numbers import count


def listed(names: Sequence[str], most: int = 8) -> str:
    """The first names, and how many more there are."""
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def gross_errors(number: int, what: str) -> str:
    """``1 reading as a gross error``, ``2 readings as gross errors``: what a stage leaves out."""
    return f"{count(number, what)} as {'a gross error' if number == 1 else 'gross errors'}"
