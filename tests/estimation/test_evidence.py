"""The search keeps its false-alarm rate, sees what is there, and weighs simple against flexible."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom

from tests.tolerance import assert_between
from truing.estimation.detectable import smallest_detectable
from truing.estimation.evidence import Score, Search, Signature, probabilities, project
from truing.estimation.whitening import Linearised, Whitened, whiten

POSES, ROWS, LOCAL, SHARED = 20, 15, 3, 4
CAMPAIGNS, DRAWS = 400, 499


def _template(seed: int = 0) -> Linearised:
    rng = np.random.default_rng(seed)
    return Linearised(
        np.zeros((POSES, ROWS)),
        rng.normal(size=(POSES, ROWS, LOCAL)),
        rng.normal(size=(POSES, ROWS, SHARED)),
        np.zeros((POSES, LOCAL)),
        np.zeros(SHARED),
        np.zeros(0),
        np.zeros((0, SHARED)),
        np.ones((POSES, ROWS), bool),
        np.ones(LOCAL, bool),
        np.ones(SHARED, bool),
    )


TEMPLATE = _template()
COLUMNS = {
    "one": np.random.default_rng(1).normal(size=(POSES, ROWS, 1)),
    "many": np.random.default_rng(2).normal(size=(POSES, ROWS, 20)),
}


def _measured(
    rng: np.random.Generator, effect: NDArray | float = 0.0, heavy: bool = False, level: float = 1.0
) -> Whitened:
    noise = rng.standard_t(4, (POSES, ROWS)) / np.sqrt(2.0) if heavy else rng.normal(size=(POSES, ROWS))
    unknown = TEMPLATE.by_shared @ rng.normal(size=SHARED)
    unknown = unknown + np.einsum("bmh,bh->bm", TEMPLATE.by_local, rng.normal(size=(POSES, LOCAL)))
    return whiten(replace(TEMPLATE, residual=unknown + level * noise + effect))


def _scores(found: Whitened, rng: np.random.Generator, columns: dict[str, NDArray] = COLUMNS) -> dict[str, Score]:
    return Search(found, {name: project(found, c) for name, c in columns.items()}, DRAWS, rng).scores()


@pytest.mark.parametrize(("heavy", "level"), [(False, 1.0), (True, 1.0), (False, 1.15)])
def test_noise_alone_is_rarely_called_an_effect(heavy: bool, level: float) -> None:
    """Also where its tails are heavy, or where it is larger than declared."""
    rng = np.random.default_rng(3)
    smallest = [
        min(score.p_value for score in _scores(_measured(rng, heavy=heavy, level=level), rng).values())
        for _ in range(CAMPAIGNS)
    ]
    for rate in (0.05, 0.2):
        alarms = int(np.sum(np.array(smallest) <= rate))
        most = int(binom.ppf(0.9999, CAMPAIGNS, rate))
        fewest = int(binom.ppf(0.0001, CAMPAIGNS, 0.5 * rate))  # it may be careful, not deaf
        assert fewest <= alarms <= most, f"{alarms} of {CAMPAIGNS} at {rate}"


def test_an_effect_is_found_where_theory_says_so() -> None:
    """At the size that `smallest_detectable` promises for 80 % power, in a random direction of its parameters."""
    rng = np.random.default_rng(4)
    bare = _measured(np.random.default_rng(9))
    signature = project(bare, COLUMNS["many"])
    level = 0.05 / len(COLUMNS)
    size = smallest_detectable(signature, bare.freedom, level, np.log(20))
    assert size is not None
    found = 0
    for _ in range(CAMPAIGNS // 2):
        pattern = rng.normal(size=20)
        pattern *= size * np.sqrt(20) / np.linalg.norm(pattern)
        score = _scores(_measured(rng, COLUMNS["many"] @ pattern), rng)["many"]
        found += score.p_value <= 0.05 and score.log_evidence >= np.log(20)
    assert_between(found / (CAMPAIGNS // 2), 0.68, 0.9, what="power at the size promised for 80 %")


def test_the_cause_at_work_has_the_larger_evidence() -> None:
    rng = np.random.default_rng(5)
    for name, pattern in (("one", np.full(1, 0.6)), ("many", np.full(20, 0.4))):
        scores = _scores(_measured(rng, COLUMNS[name] @ pattern), rng)
        other = next(key for key in COLUMNS if key != name)
        assert scores[name].log_evidence > scores[other].log_evidence + np.log(20)
        assert scores[name].p_value <= 2 / (DRAWS + 1)


def test_of_two_that_explain_the_same_the_simpler_has_the_larger_evidence() -> None:
    rng = np.random.default_rng(6)
    columns = {"simple": COLUMNS["one"], "flexible": np.concatenate([COLUMNS["one"], COLUMNS["many"]], -1)}
    scores = _scores(_measured(rng, COLUMNS["one"] @ np.full(1, 0.8)), rng, columns)
    assert scores["simple"].log_evidence > scores["flexible"].log_evidence + np.log(20)


def test_what_the_unknowns_already_explain_cannot_be_seen() -> None:
    rng = np.random.default_rng(7)
    hidden = TEMPLATE.by_local @ rng.normal(size=(POSES, LOCAL, 1)) * 1e-3
    score = _scores(_measured(rng), rng, {"hidden": hidden, **COLUMNS})["hidden"]
    assert (score.freedom, score.p_value, score.log_evidence) == (0, 1.0, 0.0)
    assert smallest_detectable(Signature(np.zeros((5, 0)), np.zeros(0), np.zeros((1, 0))), 100.0, 0.05, 0.0) is None


def test_the_same_seed_gives_the_same_scores() -> None:
    found = _measured(np.random.default_rng(8))
    assert _scores(found, np.random.default_rng(1)) == _scores(found, np.random.default_rng(1))


def test_probabilities_leave_room_for_none_of_them() -> None:
    assert probabilities({"a": 0.0, "b": 0.0}) == {"a": 1 / 3, "b": 1 / 3}
    chance = probabilities({"a": 800.0, "b": 790.0})
    assert_between(chance["a"] + chance["b"], 1 - 1e-12, 1.0, what="sum")
