"""Campaigns of arms for the blind benchmark: hidden effects, their strength, and the recorded truth."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from tests.blind.generator.arms.case import CATALOGUE, draw_two, hide, layouts_for
from tests.blind.generator.arms.effects import ADDED
from tests.blind.generator.arms.foreign import FOREIGN
from tests.blind.generator.folder import truth_path
from tests.blind.judging import Assessed, run_all
from tests.tolerance import assert_between

# Effects whose parameters are reported in other names, units or at another time than the generator holds them.
EXAGGERATED = (
    (("joint-settling", "base-drift"), "palletiser-4r", 3),
    (("joint-backlash", "column-tilt"), "column-lift", 2),
    (("joint-compliance",), "delta", 4),
)


@pytest.fixture(scope="module")
def exaggerated(tmp_path_factory: pytest.TempPathFactory) -> list[Assessed]:
    home = tmp_path_factory.mktemp("arms")
    folders = [hide(names, layout, 60.0, seed).write(home / layout) for names, layout, seed in EXAGGERATED]
    return run_all(folders, 1)


def test_found_parameters_of_exaggerated_effects_agree_with_the_truth(exaggerated: list[Assessed]) -> None:
    counts = {}
    for campaign, effect in ((one, effect) for one in exaggerated for effect in one.hidden):
        (row,) = (row for row in campaign.reported if row.cause == effect.cause)
        assert row.subject == effect.subject
        numbers = [name for name in row.value if row.sigma[name]]
        assert set(numbers) <= set(effect.value)
        assert np.abs(campaign.pulls(effect)).max() < 5.0, effect.cause
        off = np.array([row.value[name] / effect.value[name] - 1.0 for name in numbers])
        assert np.abs(off).min() < 0.05, effect.cause
        counts[effect.cause] = len(numbers)
    assert counts == {
        "joint-settling": 2,
        "base-drift": 6,
        "joint-backlash": 1,
        "column-tilt": 2,
        "joint-compliance": 1,
    }


def test_a_link_that_grows_more_than_its_material_is_named(tmp_path: Path) -> None:
    """126 ppm/K of the recorded temperature, as of a link that its motors warm."""
    folder = hide(("link-growth",), "anthropomorphic-4r", 96.6, 882434735).write(tmp_path / "warm")
    (campaign,) = run_all([folder], 1)
    ((effect,), (row,)) = campaign.hidden, campaign.reported
    assert effect.value["growth"] > 1e-4
    assert (row.cause, row.subject) == (effect.cause, effect.subject)
    assert np.abs(campaign.pulls(effect)).max() < 4.0


def _truth(folder: Path) -> dict[str, object]:
    return dict(json.loads(truth_path(folder).read_text(encoding="utf-8")))


def test_an_effect_outside_the_catalogue_follows_columns_of_its_campaign(tmp_path: Path) -> None:
    reported = set()
    for number, name in enumerate(FOREIGN):
        folder = hide((name,), "scara", 20.0, 31 + number).write(tmp_path / str(number))
        truth = _truth(folder)
        (effect,) = truth["effects"]  # type: ignore[misc]
        assert effect["cause"] == "unexplained"
        with (folder / "configurations.csv").open(encoding="utf-8", newline="") as stream:
            columns = next(csv.reader(stream))
        assert set(effect["follows"].split()) <= set(columns)
        reported.add((effect["kind"], len(effect["follows"].split())))
    assert reported == {("two-joints", 2), ("remanence", 1), ("slow-base", 1), ("heavy-tails", 0)}


def test_remanence_of_a_joint_is_orthogonal_to_gain_and_backlash() -> None:
    campaign = hide(("foreign remanence",), "bench-5r", 20.0, 5).campaign
    (effect,), schedule = campaign.effects, campaign.bench.schedule
    known = (np.ones(len(effect.shape)), schedule.readings[:, effect.where], schedule.approach[:, effect.where])
    assert max(abs(float(effect.shape @ own)) for own in known) < 1e-6


def test_effects_are_as_strong_as_wanted_and_an_exchange_has_no_size(tmp_path: Path) -> None:
    folder = hide(("joint-gain", "target-moved"), "bench-5r", 9.0, 3).write(tmp_path / "two")
    assert _truth(folder)["strengths"] == pytest.approx([9.0, 9.0], rel=0.02)
    folder = hide(("joints-exchanged",), "bench-5r", 9.0, 3).write(tmp_path / "exchanged")
    assert _truth(folder)["strengths"] == [float("inf")]


def test_a_curve_is_hidden_in_many_poses() -> None:
    assert len(hide(("joint-error-curve",), "planar-wrist", 20.0, 2).campaign.readings) == 400


def test_two_effects_can_be_distinguished() -> None:
    rng = np.random.default_rng(1)
    pairs = [draw_two(rng) for _ in range(300)]
    assert not any("joints-exchanged" in pair for pair in pairs)
    assert {frozenset(p) for p in pairs}.isdisjoint([frozenset(("joint-sag", "joint-compliance"))])
    assert {name for pair in pairs for name in pair} == set(CATALOGUE) - {"joints-exchanged", *ADDED}
    assert_between(len({frozenset(pair) for pair in pairs}), 70, 105, what="different pairs")


def test_layouts_are_those_that_show_the_effects() -> None:
    assert "cylindrical" in layouts_for(("joint-gain",))
    assert "cylindrical" not in layouts_for(("joint-sag",))
    with pytest.raises(ValueError, match="cannot be shown"):
        hide(("joint-sag",), "cylindrical", 10.0, 1)
