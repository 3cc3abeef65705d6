"""Accepted causes that worsen predictions are only suspected, and the final model omits them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import log
from types import SimpleNamespace
from typing import Any

import pytest

from truing.inference.block_gain import BlockGain
from truing.inference.blocks import BlockKind
from truing.inference.doubts import Doubts
from truing.inference.forward_search import ForwardSearch
from truing.inference.search_verdicts import SearchVerdicts, contradiction, is_unconfirmed
from truing.inference.verdicts import FOUND, SUSPECTED, Reason


@dataclass(frozen=True)
class _Error:
    """An error of predictions of which only the size and the number of observations are known."""

    size: float
    count: int = 300

    def growth_over(self, other: _Error) -> float:
        return self.size / other.size

    def log_odds_over(self, other: _Error) -> float:
        return -self.count * log(self.size / other.size)


@dataclass(frozen=True)
class _Verdict:
    """The part of a verdict that the checks of predictions read."""

    cause: Any
    after: _Error
    held_out: tuple[_Error | None, _Error | None] = (None, None)
    verdict: str = FOUND
    reason: Reason | None = None
    before: _Error = _Error(2.0)
    signal_to_noise: float = 9.0
    block_gain: Any = None
    floor: Any = None
    probability: float = 1.0
    log_odds: float = 30.0


def _verdict(
    name: str,
    after: float = 1.0,
    held: float | None = None,
    gain: float | None = None,
    count: int = 300,
    squares: float = 8.0,
) -> _Verdict:
    held_out = (None, None) if held is None else (_Error(2.0), _Error(held, count))
    block_gain = None if gain is None else BlockGain(BlockKind.DAY, 3, gain, squares)
    return _Verdict(SimpleNamespace(key=name, catalogued=True), _Error(after), held_out, block_gain=block_gain)


@pytest.mark.parametrize(
    ("verdict", "reason"),
    [
        (_verdict("lower errors"), None),
        (_verdict("higher errors", after=2.1), Reason.UNPAID),
        (_verdict("in held-out epochs alone", after=2.1, held=1.5), None),
        (_verdict("held out alike", held=2.03), None),
        (_verdict("held out worse", held=2.05), Reason.HELD_OUT),
        (_verdict("in few observations by chance", held=2.05, count=30), None),
        (_verdict("in few observations beyond chance", held=2.3, count=30), Reason.HELD_OUT),
        (_verdict("less probable elsewhere", gain=-3.1), Reason.ELSEWHERE),
        (_verdict("undecided elsewhere", gain=-2.9), None),
    ],
)
def test_predictions_contradict_a_cause_with_a_reason(verdict: Any, reason: Reason | None) -> None:
    assert contradiction(verdict) is reason


@pytest.mark.parametrize(
    ("gain", "squares", "unconfirmed"), [(0.5, 100.0, True), (3.1, 100.0, False), (0.5, 9.0, False)]
)
def test_a_gain_far_below_that_of_an_effect_of_its_size_confirms_nothing(
    gain: float, squares: float, unconfirmed: bool
) -> None:
    verdict: Any = _verdict("of blocks", gain=gain, squares=squares)
    assert is_unconfirmed(verdict) is unconfirmed


@pytest.mark.parametrize(
    ("probability", "state"), [(0.009, SUSPECTED), (0.49, SUSPECTED), (0.51, FOUND), (0.99, FOUND)]
)
def test_an_effect_without_a_name_is_suspected_where_other_causes_are_more_probable(
    probability: float, state: str
) -> None:
    assert _checked_unnamed(probability=probability).verdict == state


def _checked_unnamed(probability: float) -> Any:
    unnamed: Any = replace(_verdict("of time"), cause=SimpleNamespace(key="of time", catalogued=False))
    unnamed = replace(unnamed, probability=probability)
    return Doubts(None, (), {}, (), ()).checked(unnamed, SimpleNamespace(), ())  # type: ignore[arg-type]


@dataclass(frozen=True)
class _Fit:
    """A fit of causes: held-out errors of 2, less 1 where two causes act that only pay together."""

    keys: list[str]
    error: _Error = _Error(1.0)
    floor: Any = None

    @property
    def held_out(self) -> _Error:
        return _Error(3.0 if "worse" in self.keys else 1.0 if {"one", "other"} <= set(self.keys) else 2.0)


class _Verdicts(SearchVerdicts[Any]):
    """Given verdicts on causes, and fits that are the names of their causes."""

    def __init__(self, verdicts: dict[str, _Verdict]) -> None:
        fitter: Any = SimpleNamespace(
            prepared=lambda causes, start: _Fit([cause.key for cause in causes]),
            comparable=lambda causes, other: _Fit([cause.key for cause in causes]),
            predicted=lambda fitted: fitted,
        )
        settings: Any = None
        super().__init__(ForwardSearch(fitter, settings, (), lambda what: None))
        self.__dict__["given"] = verdicts

    def verdicts(self, searched: Any, refuted: Any = ()) -> Any:
        return [*(self.__dict__["given"][step.cause.key] for step in searched.kept), *refuted]


@dataclass(frozen=True)
class _Step:
    cause: Any
    chosen: Any = field(default_factory=lambda: SimpleNamespace(rivals=()))
    before: Any = None
    after: Any = None
    probability: float = 1.0


@dataclass(frozen=True)
class _Search:
    kept: list[_Step]
    plain: Any
    final: Any
    given: tuple[()] = ()


def _paid(own: dict[str, _Verdict]) -> tuple[list[str], list[str], dict[str, tuple[str, Reason | None]]]:
    """Causes that were kept, those of the final model, and all verdicts."""
    steps, fit = [_Step(verdict.cause) for verdict in own.values()], _Fit(list(own))
    searched, verdicts = _Verdicts(own).paying(_Search(steps, _Fit([]), fit), [])  # type: ignore[arg-type]
    final: Any = searched.final
    reported = {verdict.cause.key: (verdict.verdict, verdict.reason) for verdict in verdicts}
    return [step.cause.key for step in searched.kept], final.keys, reported


def test_the_final_model_holds_the_causes_that_pay() -> None:
    own = {name: _verdict(name, held=held) for name, held in (("first", 1.0), ("worse", 2.2), ("last", 1.5))}
    kept, final, reported = _paid(own)
    assert kept == final == ["first", "last"]
    assert reported == {"first": (FOUND, None), "last": (FOUND, None), "worse": (SUSPECTED, Reason.HELD_OUT)}


@pytest.mark.parametrize(("odds", "catalogued", "kept"), [(8.5, False, False), (9.5, False, True), (8.5, True, True)])
def test_the_final_model_holds_no_effect_without_a_name_that_is_hardly_more_probable_than_none(
    odds: float, catalogued: bool, kept: bool
) -> None:
    last = _Verdict(SimpleNamespace(key="last", catalogued=catalogued), _Error(1.0), log_odds=log(odds))
    names, final, reported = _paid({"first": _verdict("first"), "last": last})
    assert names == final == (["first", "last"] if kept else ["first"])
    assert reported["last"] == ((FOUND, None) if kept else (SUSPECTED, Reason.WEAK))


def test_two_causes_that_only_pay_together_are_kept() -> None:
    """The first one predicts held-out epochs worse as long as the other is missing."""
    own = {"one": _verdict("one", held=2.1), "other": _verdict("other", held=1.0)}
    kept, final, reported = _paid(own)
    assert kept == final == ["one", "other"]
    assert reported == {"one": (FOUND, None), "other": (FOUND, None)}


def test_a_search_whose_causes_all_pay_stays_as_it_is() -> None:
    searched = _Search([_Step(SimpleNamespace(key="first"))], _Fit([]), _Fit(["first"]))
    kept, _ = _Verdicts({"first": replace(_verdict("first"))}).paying(searched, [])  # type: ignore[arg-type]
    assert kept is searched
