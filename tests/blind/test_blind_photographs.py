"""Effects of cameras, scale bars and panes hidden in unseen rays are named by the whole pipeline.

``TRUING_BLIND_SEED`` draws other campaigns. They are few and twice as strong as must be found;
``python -m benchmarks.blind --instrument photographs`` measures rates.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from tests.blind import rates
from tests.blind.judging import UNLUCKY, Assessed, run_all
from tests.photographs.hidden_case import CATALOGUE, hide, layouts_for

SEED = int(os.environ.get("TRUING_BLIND_SEED", "1"))
ABOVE_CLEAR = 2.0


def _write(names: tuple[str, ...], number: int, folder: Path) -> Path:
    seed = int(np.random.SeedSequence([SEED, 8, number]).generate_state(1)[0])
    kinds = layouts_for(names)
    return hide(names, kinds[seed % len(kinds)], ABOVE_CLEAR * rates.CLEAR, seed).write(folder)


@pytest.fixture(scope="module")
def assessed(tmp_path_factory: pytest.TempPathFactory) -> list[Assessed]:
    """A campaign with nothing in it and one with one effect, drawn, written and run in one call."""
    home = tmp_path_factory.mktemp("photographs")
    one = str(np.random.default_rng([SEED, 9]).choice(sorted(CATALOGUE)))
    return run_all([_write(names, number, home / f"blind-{number}") for number, names in enumerate([(), (one,)])], 1)


def test_without_hidden_effects_no_more_is_found_than_by_chance(assessed: list[Assessed]) -> None:
    sure = [rates.summary(assessed[0]) for row in assessed[0].record["findings"] if row["p_value"] < UNLUCKY]
    assert not assessed[0].hidden
    assert not sure


def test_the_hidden_cause_is_named_with_its_camera_or_bar(assessed: list[Assessed]) -> None:
    (effect,) = assessed[1].hidden
    assert effect.cause not in assessed[1].missed, rates.summary(assessed[1])
    assert not assessed[1].misplaced(effect), rates.summary(assessed[1])


def test_errors_fall_with_everything_that_is_found(assessed: list[Assessed]) -> None:
    assert {one.name: one.unpaid for one in assessed if one.unpaid} == {}


def test_nothing_is_found_for_sure_next_to_what_was_hidden(assessed: list[Assessed]) -> None:
    own = {effect.cause for effect in assessed[1].hidden}
    beside = [row for row in assessed[1].record["findings"] if row["verdict"] == "found" and row["cause"] not in own]
    assert all(row["p_value"] >= UNLUCKY for row in beside), rates.summary(assessed[1])
