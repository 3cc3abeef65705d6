"""Dependences of single parts' errors: the right part and columns are found, and scatter gives none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.inference.test_part_errors import PARTS, problem
from truing.inference.campaign_inputs import InTime
from truing.inference.input_spectra import Spectra
from truing.inference.part_dependences import Part, PartDependence, part_dependences
from truing.inference.part_errors import PartProblem

EPOCHS, LEVEL = 60, 0.005
NAMES = ("a_deg", "b_deg", "c_deg")


def _columns(rng: np.random.Generator) -> dict[str, np.ndarray]:
    return {name: rng.uniform(-1.0, 1.0, EPOCHS) for name in NAMES}


def _dependences(own: PartProblem, columns: dict[str, np.ndarray]) -> list[PartDependence]:
    in_time = InTime(np.arange(EPOCHS, dtype=float), None)
    parts = [Part((place,), name) for place, name in enumerate(NAMES)]
    every = Spectra({"time_s": 60.0 * np.arange(EPOCHS), **columns}, in_time)
    return list(part_dependences(own, parts, every, LEVEL))


def _found(own: PartProblem, columns: dict[str, np.ndarray]) -> list[tuple[int | None, set[str]]]:
    return [(one.index if one.is_sure else None, set(one.inputs)) for one in _dependences(own, columns)]


@pytest.mark.parametrize("tails", [1.5, 30.0])
def test_scatter_of_parts_depends_on_nothing(tails: float) -> None:
    alarms = 0
    for seed in range(12):
        rng = np.random.default_rng([seed, 1])
        alarms += bool(_found(problem(rng, rng.standard_t(tails, (EPOCHS, PARTS)), EPOCHS), _columns(rng)))
    assert alarms <= 1


def test_an_error_that_depends_on_two_other_inputs_is_reported_with_its_part() -> None:
    right = 0
    for seed in range(6):
        rng = np.random.default_rng([seed, 2])
        columns, errors = _columns(rng), 2.0 * rng.standard_t(2.0, (EPOCHS, PARTS)) * [1.0, 0.0, 0.0]
        errors[:, 1] += 4.0 * np.sin(2.0 * columns["a_deg"]) * np.cos(2.0 * columns["c_deg"])
        right += (1, {"a_deg", "c_deg"}) in _found(problem(rng, errors, EPOCHS), columns)
    assert right >= 5


def test_friction_of_two_parts_is_reported_of_these_two() -> None:
    right = 0
    for seed in range(6):
        rng = np.random.default_rng([seed, 3])
        columns, errors = _columns(rng), np.zeros((EPOCHS, PARTS))
        for part in (0, 2):
            errors[:, part] = 3.0 * _friction(columns[NAMES[part]])
        found = _found(problem(rng, errors, EPOCHS), columns)
        right += {(0, "a_deg"), (2, "c_deg")} == {(part, name) for part, names in found for name in names}
    assert right >= 5


def test_two_parts_that_move_alike_are_not_named() -> None:
    rng = np.random.default_rng(4)
    columns, errors = _columns(rng), np.zeros((EPOCHS, PARTS))
    errors[:, 0] = 4.0 * np.cos(3.0 * columns["c_deg"])
    own = problem(rng, errors, EPOCHS)
    own = replace(own, moved=own.moved[:, :, [0, 0, 2]])
    assert _found(own, columns)[0] == (None, {"c_deg"})


def test_a_search_ends_where_its_unknowns_become_too_many_and_then_names_no_part(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(6)
    columns, errors = _columns(rng), np.zeros((EPOCHS, PARTS))
    for part, name in ((0, "c_deg"), (2, "a_deg")):
        errors[:, part] = 4.0 * np.cos(3.0 * columns[name])
    own = problem(rng, errors, EPOCHS)
    whole = _found(own, columns)
    assert {part for part, _ in whole} == {0, 2}
    epochs, tall, unknowns = own.by_shared.shape
    monkeypatch.setattr("truing.inference.part_errors._MOST_PRODUCTS", epochs * tall * unknowns**2)
    assert _found(own, columns) == [(None, whole[0][1])]
    assert [one.ends_early for one in _dependences(own, columns)] == [True]


def test_a_part_that_moves_in_several_directions_is_asked_as_one() -> None:
    rng = np.random.default_rng(5)
    columns, errors = _columns(rng), np.zeros((EPOCHS, PARTS))
    errors[:, 1] = 3.0 * np.cos(3.0 * columns["a_deg"])
    errors[:, 2] = 3.0 * np.sin(3.0 * columns["a_deg"])
    every = Spectra(columns, InTime(None, None))
    parts = [Part((0,), "a_deg"), Part((1, 2))]
    found = list(part_dependences(problem(rng, errors, EPOCHS), parts, every, LEVEL))
    assert [(one.index, one.inputs) for one in found if one.is_sure] == [(1, ("a_deg",))]


def _friction(course: np.ndarray) -> np.ndarray:
    """Mean of three elements that move on only beyond their thresholds, less the course."""
    kept, out, thresholds = np.zeros(3), np.empty(len(course)), np.array([0.2, 0.5, 0.8])
    for n, now in enumerate(course - course[0]):
        kept = np.clip(kept, now - thresholds, now + thresholds)
        out[n] = np.mean(kept - now)
    return np.asarray(out / out.std())
