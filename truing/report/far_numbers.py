"""The number that is farther from nominal than its tolerance allows, among all numbers of a machine."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pandas as pd

from truing.report.tables import Row

UNLIKELY = 1e-3  # p-value below which pulls fail
_FAR = 0.01  # p-value, corrected for all numbers, below which a single one is off
_AS_LIKELY = 10.0  # difference of squared pulls up to which two numbers explain the rest as well: odds of 150 to 1
_NAMED = 3


@dataclass(frozen=True)
class FarNumber:
    """The number whose error alone takes most from the squares of all pulls, with numbers that take nearly as much.

    ``p_value``: of as large an error, corrected for all ``tried`` numbers; ``limit``: pull that is significant.
    """

    rows: tuple[Row, ...]
    tried: int
    p_value: float
    pull: float
    limit: float


def far_number(numbers: pd.DataFrame, squares: str) -> FarNumber | None:
    """Return the number that is off by more than its tolerance allows; None where none is.

    The column ``squares`` holds what each number takes from the squares of all pulls. The sum of all shows one among
    dozens of good ones only if it is far larger.
    """
    from scipy.special import chdtrc, chdtri

    if not len(numbers):
        return None
    rows = _likeliest_numbers(numbers, squares)
    largest = float(numbers[squares].max())
    p_value = min(1.0, len(numbers) * float(chdtrc(1, largest)))
    if p_value >= _FAR:
        return None
    limit = math.sqrt(float(chdtri(1, _FAR / len(numbers))))
    return FarNumber(rows, len(numbers), p_value, math.sqrt(largest), limit)


def _likeliest_numbers(numbers: pd.DataFrame, squares: str) -> tuple[Row, ...]:
    """Return the number that takes most from the squares of all pulls, then the first few that are as likely."""
    ordered = numbers.sort_values(squares, ascending=False, kind="stable")
    near = ordered[squares].iloc[0] - ordered[squares] < _AS_LIKELY
    return tuple(ordered[near].head(1 + _NAMED).itertuples())
