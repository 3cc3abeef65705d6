"""Words that several stages use."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from truing.report.numbers import count


def listed(names: Sequence[str], most: int = 8) -> str:
    """The first names, and how many more there are."""
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def reasons(what: str, *left_out: Mapping[tuple[str, str], int]) -> list[str]:
    """How many were left out for which reason, the most frequent first; given by (file, reason)."""
    total: Counter[str] = Counter()
    for one in left_out:
        for (_, reason), number in one.items():
            total[reason] += number
    return [f"{count(number, what)}: {reason}" for reason, number in total.most_common()]


def gross_errors(number: int, what: str) -> str:
    """``1 reading as a gross error``, ``2 readings as gross errors``: what a stage leaves out."""
    return f"{count(number, what)} as {'a gross error' if number == 1 else 'gross errors'}"
