"""Tests of models on the page: state, p-value and meaning; an effect found by a test is a result, not a failure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from truing.report.column_heads import Head, P
from truing.report.numbers import p_value, plain
from truing.report.page import Listing

_UNLIKELY, _MARGIN = 1e-3, 1.1  # p-value and factor beyond which errors are called smaller than noise allows
# A rejected hypothesis is a result; a contradicted one is a simulation that the measurement does not confirm.
_PASS, _FAIL, REJECTED, CONTRADICTED, _IDLE = "pass", "fail", "rejected", "contradicted", "not evaluated"
_MARKS = {_PASS: "pass", _FAIL: "fail", REJECTED: "found", CONTRADICTED: "warn", _IDLE: "none"}


@dataclass(frozen=True)
class ModelTest:
    """One test: question, result (None: not evaluated), its meaning, and p-value; ``otherwise``: state if it does not
    hold."""

    question: str
    holds: bool | None
    statement: str
    p: float | None = None
    otherwise: str = _FAIL

    @property
    def state(self) -> str:
        """State: ``pass``, ``fail``, ``rejected``, ``contradicted`` or ``not evaluated``."""
        return _IDLE if self.holds is None else _PASS if self.holds else self.otherwise


def by_p(
    asked: str, p: float | None, least: float, meanings: tuple[str, str], why_not: str, otherwise: str = _FAIL
) -> ModelTest:
    """Return a test that holds if its p-value is at least ``least``; ``meanings``: if it holds, and if not."""
    if p is None or p != p:
        return ModelTest(asked, None, why_not)
    return ModelTest(asked, p >= least, meanings[0] if p >= least else meanings[1], p, otherwise)


def below_noise(asked: str, chi_square: float, freedom: float, why: str) -> ModelTest | None:
    """Return a failed test if errors are significantly smaller than noise allows, by more than 10 %; otherwise None.

    ``why``: possible reason.
    """
    if not freedom > 0.0 or chi_square * _MARGIN**2 >= freedom:
        return None
    from scipy.special import chdtr

    p = float(chdtr(freedom, chi_square))
    times = plain((chi_square / freedom) ** 0.5)
    text = f"It is {times} times what noise gives, significantly less: {why}."
    return ModelTest(asked, False, text, p) if p < _UNLIKELY else None


def listing_of(tests: Sequence[ModelTest], caption: str) -> Listing:
    """Return a listing of the tests, one per row."""
    rows = tuple((test.state, test.question, p_value(test.p), test.statement) for test in tests)
    heads = (
        Head("result", "Outcome of the test: pass, fail, rejected, contradicted or not evaluated."),
        Head("hypothesis", "Statement about the model that the test asks for."),
        P,
        Head("meaning", "What follows from the outcome."),
    )
    return Listing(heads, rows, tuple(_MARKS[test.state] for test in tests), caption)
