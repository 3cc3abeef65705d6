"""Tests of models on the page: passed, failed or not evaluated, each with its p-value and what it says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from truing.report.numbers import p_value, plain
from truing.report.page import Listing

_UNLIKELY, _MARGIN = 1e-3, 1.1  # of errors that are called smaller than noise allows: by chance, and in size
_PASS, _FAIL, _IDLE = "pass", "fail", "not evaluated"
_MARKS = {_PASS: "pass", _FAIL: "fail", _IDLE: "none"}


@dataclass(frozen=True)
class ModelTest:
    """One test: what is asked, whether it holds (None: not evaluated), what that means, and its p-value."""

    question: str
    holds: bool | None
    statement: str
    p: float | None = None

    @property
    def state(self) -> str:
        """``pass``, ``fail`` or ``not evaluated``."""
        return _IDLE if self.holds is None else _PASS if self.holds else _FAIL


def by_p(asked: str, p: float | None, least: float, says: tuple[str, str], why_not: str) -> ModelTest:
    """A test that holds where chance does as much with a probability of at least ``least``; ``says``: if so, if not."""
    if p is None or p != p:
        return ModelTest(asked, None, why_not)
    return ModelTest(asked, p >= least, says[0] if p >= least else says[1], p)


def below_noise(asked: str, chi_square: float, freedom: float, why: str) -> ModelTest | None:
    """A test that fails because less is left than noise allows beyond chance, and by a tenth; None where it is not so.

    ``why``: what makes it so small.
    """
    if not freedom > 0.0 or chi_square * _MARGIN**2 >= freedom:
        return None
    from scipy.special import chdtr

    p = float(chdtr(freedom, chi_square))
    times = plain((chi_square / freedom) ** 0.5)
    text = f"It is {times} times what noise leaves, less than chance explains: {why}."
    return ModelTest(asked, False, text, p) if p < _UNLIKELY else None


def listing_of(tests: Sequence[ModelTest], caption: str) -> Listing:
    """The tests, one a row."""
    rows = tuple((test.state, test.question, p_value(test.p), test.statement) for test in tests)
    return Listing(("state", "test", "p", "what it says"), rows, tuple(_MARKS[test.state] for test in tests), caption)
