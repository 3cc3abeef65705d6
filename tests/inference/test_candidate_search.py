"""The search keeps its false-alarm rate, and finds effects with the power that theory predicts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, ncf
from scipy.stats import f as f_distribution

from tests.inference import toy_campaign as toy
from tests.tolerance import assert_between
from truing.inference.evidence import log_evidence, probabilities
from truing.inference.search import Search

CAMPAIGNS, DRAWS = 100, 99
LEVEL = 0.05
UNLUCKY = 1e-3


def smallest_p(found: Search) -> float:
    """The p-value of the best of everything that was tried."""
    maxima = found.maxima(found.pathways.along(found.pathways.whitened.rest[None]))[0]
    return min(found.null.corrected(float(square), group) for square, group in zip(maxima, found.groups, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("heavy", "points", "readings"), [(False, 1.0, 1.0), (True, 1.0, 1.0), (False, 1.1, 1.1), (False, 0.9, 0.9)]
)
def test_noise_alone_is_rarely_called_an_effect(heavy: bool, points: float, readings: float) -> None:
    alarms = 0
    for number in range(CAMPAIGNS):
        rng = np.random.default_rng([number, heavy, int(10 * points)])
        whitened = toy.measured(rng, heavy=heavy, points=points, readings=readings)
        alarms += smallest_p(toy.search(whitened, DRAWS, rng)) <= LEVEL
    assert alarms <= binom.isf(UNLUCKY, CAMPAIGNS, LEVEL)


def test_an_effect_is_seen_where_theory_says_so() -> None:
    """One drive's gain at a non-centrality for which the F test, at the p that the search asks for, has power 0.8."""
    campaigns, found = 120, 0
    quiet = toy.search(toy.measured(np.random.default_rng(0)), 2000, np.random.default_rng(1))
    own = quiet.candidates[0].signature
    group = quiet.null.group_of("gain", 1)
    limit, freedom = quiet.null.threshold(group, LEVEL), quiet.noise.freedom(group.input_share)
    quantile = f_distribution.isf(limit, 1, freedom)
    sizes = np.linspace(2, 8, 601)
    clear = sizes[np.searchsorted(ncf.sf(quantile, 1, freedom, sizes**2), 0.8)]
    columns = toy.TEMPLATE.by_local[..., toy.READINGS] @ toy.gain()["drive"][..., :1]
    effect = columns[..., 0] * clear / own.strengths[0]
    for number in range(campaigns):
        rng = np.random.default_rng([number, 77])
        seen = toy.search(toy.measured(rng, effect), DRAWS, rng)
        along = seen.pathways.along(seen.pathways.whitened.rest[None])
        found += seen.null.corrected(float(seen.squares(along)[0, 0]), group) <= LEVEL
    # The quantile of few null draws is itself uncertain, which costs or gains some power.
    assert_between(found, binom.isf(1 - UNLUCKY, campaigns, 0.70), binom.isf(UNLUCKY, campaigns, 0.88))


def test_a_clear_effect_has_a_p_value_beyond_what_was_drawn() -> None:
    columns = toy.TEMPLATE.by_local[..., toy.READINGS] @ toy.gain()["drive"][..., :1]
    own = toy.search(toy.measured(np.random.default_rng(5)), 2, np.random.default_rng(5)).candidates[0].signature
    rng = np.random.default_rng(6)
    clear = toy.search(toy.measured(rng, columns[..., 0] * 9.0 / own.strengths[0]), DRAWS, rng)
    assert smallest_p(clear) < 1e-3


def test_the_same_seed_gives_the_same_p() -> None:
    found = [smallest_p(toy.search(toy.measured(np.random.default_rng(8)), 50, np.random.default_rng(9))) for _ in "ab"]
    assert found[0] == found[1]


def test_evidence_prefers_the_simpler_of_two_that_explain_the_same() -> None:
    along = np.array([7.0])
    simple = log_evidence(along, np.array([20.0]), 350.0, 350.0)
    flexible = log_evidence(np.array([7.0, 0.0, 0.0]), np.array([20.0, 20.0, 20.0]), 350.0, 350.0)
    assert simple > flexible > 0


def test_evidence_is_the_marginal_likelihood() -> None:
    """Against the integral over the parameter and over the size, noise known."""
    z, strength, sizes = 4.0, 5.0, np.array([30.0, 10.0, 3.0, 1.0, 1 / 3, 1 / 10, 1 / 30])
    theta = np.linspace(-300, 300, 2_000_001)
    prior = np.mean(np.exp(-0.5 * (theta[:, None] / sizes) ** 2) / sizes / np.sqrt(2 * np.pi), 1)
    wanted = np.log(
        np.sum(np.exp(z * strength * theta - 0.5 * (strength * theta) ** 2) * prior) * (theta[1] - theta[0])
    )
    found = log_evidence(np.array([z]), np.array([strength]), 1e9, 1e9)
    assert abs(float(found) - wanted) < 1e-3


def test_probabilities_leave_room_for_none_of_them() -> None:
    reported = probabilities({"a": 0.0, "b": np.log(2.0)})
    assert reported["a"] == pytest.approx(0.25)
    assert reported["b"] == pytest.approx(0.5)
