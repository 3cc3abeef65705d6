"""Decisions on growing data: when a decision that was looked for again and again may be taken.

Looking after every observation until a test decides makes a wrong decision ever more probable. So only looks at half as
many more data count, and each has its share of the probability of error (alpha spending; Lan and DeMets, 1983).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

GROWTH = 1.5  # of the data between two looks that count
ERROR = 0.05  # probability of a wrong decision at any of all looks


@dataclass(frozen=True)
class Look:
    """One look at the data: number of observations, decision (empty: none), and p-value of the limit that it tests."""

    count: int
    decision: str
    p_value: float


def counted_looks(looks: Iterable[Look]) -> list[Look]:
    """Return the looks that count: the first, and each with half as many more observations as the one before."""
    result: list[Look] = []
    for look in looks:
        if not result or look.count >= next_count(result):
            result.append(look)
    return result


def next_count(counted: Sequence[Look]) -> int:
    """Return the number of observations from which on the next look counts."""
    return math.ceil(GROWTH * counted[-1].count)


def allowed_p_value(number: int) -> float:
    """Return the largest p-value that decides at a counted look: 0 at the first; all sum up to `ERROR`."""
    return ERROR / (number * (number - 1)) if number > 1 else 0.0


def is_decided(counted: Sequence[Look]) -> bool:
    """Return True if the last look decides by its share of the error, and the one before decided alike."""
    if len(counted) < 2 or not counted[-1].decision:
        return False
    before, last = counted[-2:]
    return last.decision == before.decision and last.p_value <= allowed_p_value(len(counted))
