"""Inputs of unnamed effects in an inadequate model are confirmed only if the residuals depend on them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from truing.inference.attribution import Attributed
from truing.inference.selection import _with_confirmed_inputs
from truing.inference.verdicts import FOUND, SUSPECTED, Reason, Verdict

FINAL = cast(Any, SimpleNamespace(model=SimpleNamespace(part_count=6)))


def _verdict(*inputs: str, catalogued: bool = False, subject: str = "") -> Verdict[Any]:
    cause = SimpleNamespace(catalogued=catalogued, inputs=lambda parts: inputs, subject=subject)
    return Verdict(
        cause, FOUND, 0.0, 1.0, 40.0, 9.0, None, *cast(Any, (None, None, (None, None), None, None, None)), candidates=1
    )


@pytest.mark.parametrize(
    ("inputs", "verdict"),
    [
        (("time_s",), FOUND),
        (("time_s", "load_n"), FOUND),
        (("temperature_c",), SUSPECTED),
        (("load_n", "a"), SUSPECTED),
    ],
)
def test_inputs_that_no_residuals_depend_on_are_suspected(inputs: tuple[str, ...], verdict: str) -> None:
    attributions = [Attributed((), ("time_s",), 0.3, 1e-4), Attributed((2,), ("load_n",), 0.1, 1e-4)]
    found = _with_confirmed_inputs(_verdict(*inputs), FINAL, attributions)
    assert found.verdict == verdict
    assert found.reason == (None if verdict == FOUND else Reason.INADEQUATE)


@pytest.mark.parametrize(
    ("subject", "verdict"), [("leg2", FOUND), ("leg1 leg2", FOUND), ("leg1", SUSPECTED), ("leg21", SUSPECTED)]
)
def test_inputs_of_another_part_confirm_nothing(subject: str, verdict: str) -> None:
    attributions = [Attributed((), ("time_s",), 0.3, 1e-4, subject="leg2")]
    assert _with_confirmed_inputs(_verdict("time_s", subject=subject), FINAL, attributions).verdict == verdict


def test_errors_of_another_part_contradict_what_residuals_confirm() -> None:
    """A slipped payload: the motion of the first joint was said to depend on two others, which move the elbow."""
    residuals, elbow = (
        Attributed((), ("a", "b", "c"), 0.3, 1e-4),
        Attributed((), ("a", "b"), 0.1, 1e-4, subject="elbow"),
    )
    of_base = _verdict("a", "b", subject="base")
    assert _with_confirmed_inputs(of_base, FINAL, [residuals]).verdict == FOUND
    assert _with_confirmed_inputs(of_base, FINAL, [residuals, elbow]).verdict == SUSPECTED
    own = Attributed((), ("a",), 0.1, 1e-4, subject="base")
    assert _with_confirmed_inputs(of_base, FINAL, [residuals, elbow, own]).verdict == FOUND


@pytest.mark.parametrize(("seen", "verdict"), [(6, FOUND), (4, FOUND), (3, SUSPECTED), (0, SUSPECTED)])
def test_most_parts_confirm_an_effect_of_all(seen: int, verdict: str) -> None:
    attributions = [Attributed((), (f"rho{n}_mm",), 0.1, 1e-4, subject=f"leg{n}") for n in range(1, seen + 1)]
    every = _verdict(*(f"rho{n}_mm" for n in range(1, 7)))
    assert _with_confirmed_inputs(every, FINAL, attributions).verdict == verdict


def test_causes_of_the_catalogue_are_left_to_other_doubts() -> None:
    assert _with_confirmed_inputs(_verdict(catalogued=True), FINAL, []).verdict == FOUND
