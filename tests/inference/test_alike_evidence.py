"""Evidence of parameters of similar size: agreement with an integral, and the preferred choice of parts."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.tolerance import assert_between, assert_close
from truing.inference import evidence
from truing.inference.evidence import like_sized_log_evidence, log_evidence

FREEDOM = 4000.0


def _drawn(rng: np.random.Generator, parts: int, others: int, count: int) -> NDArray:
    """Parameters (count, parts + others) as the evidence takes them to be beforehand."""
    sizes = rng.choice(evidence.LIKE_SIZES, (count, 1))
    one_sign = rng.random(count) < 0.5
    signs = rng.choice([-1.0, 1.0], (count, parts))
    while np.any(again := np.abs(signs.sum(1)) == parts):
        signs[again] = rng.choice([-1.0, 1.0], (again.sum(), parts))
    signs = np.where(one_sign[:, None], rng.choice([-1.0, 1.0], (count, 1)), signs)
    spreads = rng.choice(evidence._SPREADS, (count, 1))
    of_like_size = signs + spreads * rng.normal(size=(count, parts))
    return sizes * np.concatenate([of_like_size, rng.normal(size=(count, others))], 1)


@pytest.mark.parametrize(("parts", "others"), [(2, 0), (3, 0), (2, 2)])
def test_evidence_is_the_mean_likelihood_over_draws_of_the_prior(parts: int, others: int) -> None:
    rng = np.random.default_rng(parts + others)
    size = parts + others
    root = rng.normal(size=(size, size)) + 1.5 * np.eye(size)
    gram, scores = root @ root.T, root @ rng.normal(size=size) * 2.0
    drawn = _drawn(rng, parts, others, 400_000)
    after = FREEDOM - 2 * drawn @ scores + np.einsum("di,ij,dj->d", drawn, gram, drawn)
    expected = np.mean((after / FREEDOM) ** (-FREEDOM / 2))
    found = like_sized_log_evidence(scores, gram, range(parts), FREEDOM, FREEDOM)
    # The mean of 400 000 likelihoods scatters by about one per cent.
    assert_close(found, np.log(expected), atol=0.06, what="log evidence")


def test_results_are_independent_of_parameter_order() -> None:
    rng = np.random.default_rng(8)
    root = rng.normal(size=(6, 6))
    gram, scores = root @ root.T, rng.normal(size=6) * 3
    mixed = np.array([4, 0, 5, 2, 1, 3])
    back = np.argsort(mixed)[:3].tolist()
    one = like_sized_log_evidence(scores, gram, [0, 1, 2], FREEDOM, FREEDOM)
    same = like_sized_log_evidence(scores[mixed], gram[np.ix_(mixed, mixed)], back, FREEDOM, FREEDOM)
    assert_close(one, same, atol=1e-12 * abs(one), what="log evidence")  # rounding of about 2,700


def test_two_of_six_parts_are_distinguished_from_all_of_them() -> None:
    """Amplitudes of four and six sigma at two parts, noise at the others: independent ones would often have all six."""
    rng, wins, independent = np.random.default_rng(5), 0, 0
    strength = 12.0  # of one plausible scale, in sigma
    gram = strength**2 * np.eye(6)
    for _ in range(60):
        scores = strength * (rng.normal(size=6) + np.array([4.0, -6.0, 0, 0, 0, 0]))
        shares = {2: 0.2 / 15, 6: 0.35}
        odds, old = {}, {}
        for chosen in (*combinations(range(6), 2), tuple(range(6))):
            own = np.ix_(chosen, chosen)
            share = np.log(shares[len(chosen)])
            odds[chosen] = share + like_sized_log_evidence(
                scores[list(chosen)], gram[own], range(len(chosen)), FREEDOM, FREEDOM
            )
            along = scores[list(chosen)] / strength
            old[chosen] = share + float(log_evidence(along, np.full(len(chosen), strength), FREEDOM, FREEDOM))
        wins += max(odds, key=lambda key: odds[key]) == (0, 1)
        independent += max(old, key=lambda key: old[key]) == (0, 1)
    assert_between(wins, 57, 60, what="right choices of 60")
    assert independent < wins


def test_a_single_part_is_as_probable_as_an_independent_one() -> None:
    """One parameter has no other to be alike; both say the same but for how finely they go through the sizes."""
    for z in (0.0, 3.0, 8.0, 20.0):
        one = like_sized_log_evidence(np.array([12.0 * z]), np.array([[144.0]]), [0], FREEDOM, FREEDOM)
        other = float(log_evidence(np.array([z]), np.array([12.0]), FREEDOM, FREEDOM))
        assert_close(one, other, atol=1.2, what="log evidence")
