"""The end of a search, with the least p-value of the candidates that it left."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from truing.inference.search_end import FurtherCauses, SearchEnd


def _closing(**candidates: tuple[float, float]) -> Any:
    """A last round with the p-value and the logarithmic evidence of each candidate."""
    return SimpleNamespace(
        best={name: SimpleNamespace(key=name) for name in candidates},
        scores={name: SimpleNamespace(log_evidence=evidence) for name, (_, evidence) in candidates.items()},
        p_value=lambda candidate: candidates[candidate.key][0],
    )


@pytest.mark.parametrize(("evidence", "least"), [(2.0, 1e-5), (-3.0, 0.3)])
def test_a_candidate_without_a_plausible_size_is_no_cause_left(evidence: float, least: float) -> None:
    """Such a candidate is never accepted, however small its p-value: a row of the page must not call that fitting."""
    end = FurtherCauses[Any]().end(None, 1, _closing(bending=(1e-5, evidence), drift=(0.3, 1.0)), None)
    assert (end.end, end.p_value) == (SearchEnd.COMPLETE, least)


def test_without_any_candidate_nothing_is_left() -> None:
    assert FurtherCauses[Any]().end(None, 0, _closing(), None).p_value == 1.0


def _event(part: str, *, recurs: bool = False, is_smooth: bool = False) -> SimpleNamespace:
    return SimpleNamespace(id="drift", subject=part, catalogued=True, recurs=recurs, is_smooth=is_smooth)


def _limit(accepted: list[SimpleNamespace], chosen: SimpleNamespace) -> SearchEnd | None:
    """The limit of a search in which every cause but a smooth one has an onset."""
    onsets = SimpleNamespace(onsets=lambda cause: None if cause.is_smooth else cause)
    current: Any = SimpleNamespace(scene=onsets, held_out=None)
    return FurtherCauses[Any]().limit(accepted, current, chosen)


def test_a_third_sudden_change_of_the_same_part_ends_the_search() -> None:
    """Residuals with a pattern that is not known look like one change after the other."""
    assert _limit([_event("tool"), _event("tool")], _event("tool")) is SearchEnd.EVENTS
    assert _limit([_event("tool"), _event("base")], _event("tool")) is None
    assert _limit([_event("tool")], _event("tool")) is None


def test_a_smooth_drift_of_the_same_part_is_no_sudden_change() -> None:
    waves = _event("tool", is_smooth=True)
    assert _limit([waves, waves, _event("tool")], _event("tool")) is None
    assert _limit([_event("tool"), _event("tool")], waves) is None


def test_changes_that_recur_do_not_end_the_search() -> None:
    slip = _event("run 3", recurs=True)
    assert _limit([slip, slip, slip], slip) is None
