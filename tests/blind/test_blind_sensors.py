"""Effects hidden in unseen force-sensor campaigns are named by the whole pipeline.

``TRUING_BLIND_SEED`` draws other campaigns. They are few and twice as strong as must be found, so that each judgement
fails a correct diagnosis once in a thousand draws; ``python -m benchmarks.blind --instrument sensor`` measures rates.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from tests.blind import rates
from tests.blind.generator.sensor.case import hide, layouts_for
from tests.blind.generator.sensor.hidden import CATALOGUE, draw_two
from tests.blind.judging import UNLUCKY, Assessed, fewest_of, run_all

SEED = int(os.environ.get("TRUING_BLIND_SEED", "1"))
ONE = 1
ABOVE_CLEAR = 2.0
NAMED = 0.99  # of effects so strong


def _drawn() -> list[tuple[str, ...]]:
    """Hidden effects by campaign: none; one; two."""
    rng = np.random.default_rng([SEED, 6])
    ones = rng.choice(sorted(CATALOGUE), ONE, replace=False).tolist()
    return [(), *((name,) for name in ones), draw_two(rng)]


def _write(names: tuple[str, ...], number: int, folder: Path) -> Path:
    seed = int(np.random.SeedSequence([SEED, 7, number]).generate_state(1)[0])
    kinds = layouts_for(names)
    clear = rates.CLEAR_OF_TWO if len(names) > 1 else rates.CLEAR
    return hide(names, kinds[seed % len(kinds)], ABOVE_CLEAR * clear, seed).write(folder)


@pytest.fixture(scope="module")
def assessed(tmp_path_factory: pytest.TempPathFactory) -> list[Assessed]:
    """All campaigns, drawn, written and run in one call."""
    home = tmp_path_factory.mktemp("sensors")
    return run_all([_write(names, number, home / f"blind-{number}") for number, names in enumerate(_drawn())], 1)


def test_without_hidden_effects_a_full_search_finds_no_more_than_chance(
    assessed: list[Assessed],
) -> None:
    plain = [one for one in assessed if not one.hidden]
    sure = [rates.summary(one) for one in plain for row in one.record["findings"] if row["p_value"] < UNLUCKY]
    assert plain
    assert not sure


def test_the_hidden_cause_is_named_with_its_loads_channels_runs_or_signals(assessed: list[Assessed]) -> None:
    hidden = [(one, effect) for one in assessed for effect in one.hidden]
    named = [(one, effect) for one, effect in hidden if effect.cause not in one.missed]
    assert len(hidden) == ONE + 2
    assert len(named) >= fewest_of(len(hidden), NAMED), [rates.summary(one) for one in assessed if one.missed]
    placed = [one for one, effect in named if not one.misplaced(effect)]
    assert len(placed) >= fewest_of(len(named), NAMED), [rates.summary(one) for one, _ in named if one not in placed]


def test_errors_fall_with_everything_that_is_found(assessed: list[Assessed]) -> None:
    assert {one.name: one.unpaid for one in assessed if one.unpaid} == {}


def test_nothing_is_found_for_sure_next_to_what_was_hidden(assessed: list[Assessed]) -> None:
    wrong = [rates.summary(one) for one in assessed if one.hidden and one.invented and _is_sure(one)]
    assert not wrong


def _is_sure(one: Assessed) -> bool:
    """Return True if chance gives such an invented finding in fewer than one campaign of a thousand."""
    hidden = {effect.cause for effect in one.hidden}
    found = [row for row in one.record["findings"] if row["verdict"] == "found" and row["cause"] not in hidden]
    return any(row["p_value"] < UNLUCKY for row in found)
