"""Effects hidden in unseen campaigns are found and named by the whole pipeline.

``TRUING_BLIND_SEED`` draws other campaigns. Rates are judged over all campaigns of a kind, never one by one: a correct
diagnosis fails a judgement once in a thousand draws. ``python -m benchmarks.blind`` measures the rates themselves.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.blind import rates
from tests.blind.generator.case import hide, layouts_for
from tests.blind.generator.hidden import CATALOGUE, FOREIGN, STRANGE, draw_two
from tests.blind.judging import Assessed, run_all
from tests.blind.rates import clear_from

SEED = int(os.environ.get("TRUING_BLIND_SEED", "1"))
NOTHING, ONE, TWO, UNKNOWN, STRANGERS = 3, 6, 3, 5, 4
IN_FOREIGN_WORLDS = 20.0  # signal-to-noise of each of the effects there
# Above what must be found in 95 of 100: a regression shows in few campaigns only where few are missed without one.
ABOVE_CLEAR = 1.6
FOUND, NAMED, BOTH, DRIVEN = 0.95, 0.9, 0.95, 0.8  # of these; two so strong are missed as rarely as one that is clear
WRONG, MISNAMED = 0.05, 0.1


def _drawn() -> dict[str, list[tuple[str, ...]]]:
    """Hidden effects by campaign: none; one cause; two causes; effects outside the catalogue."""
    rng = np.random.default_rng([SEED, 4])
    names = rng.choice(sorted(CATALOGUE), ONE, replace=False).tolist()
    pairs: list[tuple[str, ...]] = [draw_two(rng) for _ in range(TWO)]
    strange = rng.choice(sorted(STRANGE), UNKNOWN, replace=False).tolist()
    return {
        "nothing": [()] * NOTHING,
        "one": [(name,) for name in names],
        "two": pairs,
        "unknown": [(name,) for name in strange],
        "foreign": [tuple(rng.choice(sorted(FOREIGN), 3, replace=False).tolist()) for _ in range(STRANGERS)],
    }


def _write(names: Sequence[str], number: int, folder: Path) -> Path:
    seed = int(np.random.SeedSequence([SEED, 5, number]).generate_state(1)[0])
    kinds = layouts_for(names)
    foreign = set(names) & set(FOREIGN)
    clear = max((clear_from(name, two=len(names) > 1) for name in names if not foreign), default=1.0)
    wanted = IN_FOREIGN_WORLDS if foreign else ABOVE_CLEAR * clear
    return hide(names, kinds[seed % len(kinds)], wanted, seed).write(folder)


@pytest.fixture(scope="module")
def assessed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Assessed]]:
    """All campaigns, drawn, written and run."""
    home = tmp_path_factory.mktemp("blind")
    drawn = [(group, names) for group, cases in _drawn().items() for names in cases]
    folders = [_write(names, number, home / f"{group}-{number}") for number, (group, names) in enumerate(drawn)]
    results = {one.name: one for one in run_all(folders)}
    groups = {group: [one for name, one in results.items() if name.startswith(group)] for group, _ in drawn}
    assert sum(map(len, groups.values())) == len(drawn)
    return groups


def test_each_assessment_can_fail_with_the_given_number_of_campaigns() -> None:
    short = {(ONE, FOUND), (ONE, NAMED), (TWO, BOTH), (UNKNOWN, DRIVEN)}
    many = {(NOTHING, WRONG), (UNKNOWN, MISNAMED)}
    assert all(rates.Count(0, trials, ()).falls_short(wanted) for trials, wanted in short)
    assert all(rates.Count(trials, trials, ()).exceeds(allowed) for trials, allowed in many)


def test_nothing_is_found_where_nothing_is_hidden(assessed: dict[str, list[Assessed]]) -> None:
    found = rates.alarms(assessed["nothing"])
    assert not found.exceeds(WRONG), [rates.summary(one) for one in assessed["nothing"] if one.found]


def test_effects_outside_the_catalogue_give_no_named_cause(assessed: dict[str, list[Assessed]]) -> None:
    wrong = [bool(one.misnamed) for one in assessed["foreign"]]
    count = rates.Count(sum(wrong), len(wrong), ())
    assert not count.exceeds(WRONG), [rates.summary(one) for one in assessed["foreign"] if one.misnamed]


def test_effects_outside_the_catalogue_are_never_reported_as_agreement(
    assessed: dict[str, list[Assessed]],
) -> None:
    assert all(one.found or one.suspected for one in assessed["foreign"])


def test_errors_fall_with_everything_that_is_found(assessed: dict[str, list[Assessed]]) -> None:
    assert {one.name: one.unpaid for group in assessed.values() for one in group if one.unpaid} == {}


def test_nothing_is_found_next_to_what_was_hidden(assessed: dict[str, list[Assessed]]) -> None:
    campaigns = assessed["one"] + assessed["two"]
    assert not rates.invented(campaigns).exceeds(WRONG), [
        rates.summary(campaign) for campaign in campaigns if campaign.invented
    ]


def test_the_hidden_cause_is_found(assessed: dict[str, list[Assessed]]) -> None:
    found = rates.detected(assessed["one"])
    assert not found.falls_short(FOUND), found.bad


def test_the_hidden_cause_is_named_or_reported_as_indistinguishable(
    assessed: dict[str, list[Assessed]],
) -> None:
    found = rates.named(assessed["one"])
    assert not found.falls_short(NAMED), found.bad


def test_the_right_legs_and_targets_are_reported(assessed: dict[str, list[Assessed]]) -> None:
    found = rates.placed(assessed["one"])
    assert not found.falls_short(FOUND), found.bad


def test_two_effects_are_both_named(assessed: dict[str, list[Assessed]]) -> None:
    found = rates.both_named(assessed["two"])
    assert not found.falls_short(BOTH), found.bad


def test_effects_outside_the_catalogue_are_reported_with_their_inputs(
    assessed: dict[str, list[Assessed]],
) -> None:
    found = rates.driven(assessed["unknown"])
    assert not found.falls_short(DRIVEN), found.bad


def test_effects_outside_the_catalogue_stay_unnamed(assessed: dict[str, list[Assessed]]) -> None:
    assert not rates.misnamed(assessed["unknown"]).exceeds(MISNAMED), [
        rates.summary(one) for one in assessed["unknown"]
    ]


def test_stated_uncertainties_cover_the_truth(assessed: dict[str, list[Assessed]]) -> None:
    """Parameters of a campaign err together: as many trials as there are campaigns."""
    shares = rates.coverage(assessed["one"])
    covered = rates.Count(int(np.ceil(shares.sum())), len(shares), ())
    assert not covered.falls_short(0.9), shares


def test_held_out_observations_are_predicted_to_the_noise(assessed: dict[str, list[Assessed]]) -> None:
    ratios = rates.floors(assessed["one"] + assessed["two"])
    unlucky = 3.1 * ratios.std(ddof=1) / np.sqrt(len(ratios))
    assert ratios.mean() < 1.1 + unlucky, ratios


def test_the_geometry_returns_to_where_it_was_built(assessed: dict[str, list[Assessed]]) -> None:
    found = rates.pulled(assessed["one"] + assessed["two"])
    assert found.trials, "no campaign tells pulls"
    assert not found.falls_short(0.95), found.bad
