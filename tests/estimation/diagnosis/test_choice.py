"""What is accepted first, and what the data cannot tell from it: alone, or beside what else is there."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.estimation import toy_campaign as toy
from truing.estimation.diagnosis.candidate_round import Round, scored
from truing.estimation.diagnosis.candidate_search import Candidate, Search
from truing.estimation.diagnosis.choice import choose
from truing.estimation.diagnosis.noise_components import components
from truing.estimation.diagnosis.signatures import signature

LEVEL = 0.02
# What a drive does wrong at each pose: three courses that have nothing to do with one another.
COURSES = np.random.default_rng(1).uniform(-1, 1, (3, toy.POSES))


def _cause(name: str, catalogued: bool) -> Any:
    return SimpleNamespace(key=name, catalogued=catalogued, alike=lambda legs: ())


def _design(course: NDArray, drive: int) -> dict[str, NDArray]:
    return {"drive": course[:, None, None] * np.eye(toy.DRIVES)[:, [drive]]}


def _round(designs: dict[str, dict[str, NDArray]], sizes: dict[str, float], unnamed: tuple[str, ...]) -> Round:
    """A round over candidates, each a kind of its own, in data that hold some at a signal-to-noise."""
    clean = toy.channels(toy.measured(np.random.default_rng(0)))
    effect = np.zeros(toy.TEMPLATE.residual.shape)
    for name, size in sizes.items():
        columns = toy.TEMPLATE.by_local[..., toy.READINGS] @ designs[name]["drive"]
        effect += columns[..., 0] * size / signature(clean, designs[name]).strengths[0]
    whitened = toy.measured(np.random.default_rng(2), effect)
    own, noise = toy.channels(whitened), components(whitened, 3 * toy.POINTS, toy.READINGS)
    stand: Any = SimpleNamespace(
        noise=noise, model=SimpleNamespace(leg_count=0), fit=SimpleNamespace(whitened=whitened)
    )
    found = [Candidate(_cause(n, n not in unnamed), n, signature(own, d), 1.0) for n, d in designs.items()]
    shares = dict.fromkeys(designs, 1.0)
    return scored(stand, Search(own, noise, found, [], shares, 99, np.random.default_rng(3)))


@pytest.fixture(scope="module")
def both() -> Round:
    """An effect with a name and a stronger one without, and a twin that does on the same drive what the weak does."""
    weak, strong = _design(COURSES[0], 0), _design(COURSES[1], 1)
    twin = _design(COURSES[0] + 0.02 * COURSES[2], 0)
    return _round({"weak": weak, "strong": strong, "twin": twin}, {"weak": 20.0, "strong": 25.0}, ("strong",))


def test_what_is_there_beside_a_cause_is_no_rival_of_it(both: Round) -> None:
    choice = choose(both, set(), LEVEL)
    assert choice is not None
    assert choice.candidate.key in ("weak", "twin")
    assert "strong" not in [rival.key for rival, _ in choice.rivals]


def test_of_two_causes_that_are_there_the_rivals_are_those_that_do_as_well_beside_the_other(both: Round) -> None:
    choice = choose(both, set(), LEVEL)
    assert choice is not None
    assert {choice.candidate.key, *(rival.key for rival, _ in choice.rivals)} == {"weak", "twin"}
    assert all(abs(lead) < np.log(20.0) for _, lead in choice.rivals)


def test_where_one_effect_is_there_the_rivals_are_those_that_explain_it_alone() -> None:
    designs = {"own": _design(COURSES[0], 0), "twin": _design(COURSES[0] + 0.02 * COURSES[2], 0)}
    designs["other"] = _design(COURSES[1], 1)
    choice = choose(_round(designs, {"own": 12.0}, ()), set(), LEVEL)
    assert choice is not None
    names = [rival.key for rival, _ in choice.rivals]
    assert {choice.candidate.key, *names} == {"own", "twin"}
