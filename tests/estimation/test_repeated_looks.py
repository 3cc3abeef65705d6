"""Repeated decisions on growing data keep their false-alarm rate."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import chdtr, chdtrc

from truing.estimation.repeated_looks import (
    ERROR,
    Look,
    allowed_p_value,
    counted_looks,
    is_decided,
    next_count,
)

SEQUENCES, FIRST, LAST = 600, 4, 400


def _looks(ratio: float, seed: int, growth: int = 1) -> list[list[Look]]:
    """Looks at sequences of normal errors, after every few poses; ratio: true standard deviation over its limit."""
    squares = np.cumsum(np.random.default_rng(seed).normal(scale=ratio, size=(SEQUENCES, LAST)) ** 2, axis=1)
    counts = np.arange(FIRST, LAST + 1, growth)
    below, above = (chance(counts, squares[:, counts - 1]) for chance in (chdtr, chdtrc))
    p = 2.0 * np.minimum(below, above)
    words = np.where(p > ERROR, "", np.where(below < above, "met", "not-met"))
    reported = zip(words.tolist(), p.tolist(), strict=True)
    return [[Look(*one) for one in zip(counts.tolist(), *row, strict=True)] for row in reported]


def _ended(looks: list[Look]) -> Look | None:
    counted = counted_looks(looks)
    return next((counted[k - 1] for k in range(1, len(counted) + 1) if is_decided(counted[:k])), None)


@pytest.mark.parametrize("wrong", ["met", "not-met"])
def test_a_wrong_decision_ends_the_looking_at_most_as_often_as_stated(wrong: str) -> None:
    """At the limit itself either decision is wrong half of the time; looking until a test decides is wrong far more
    often."""
    sequences = _looks(1.0, seed=1)
    ended = [found for looks in sequences if (found := _ended(looks)) is not None]
    naive = [next((look.decision for look in looks if look.decision), "") for looks in sequences]
    scatter = 3.0 * np.sqrt(ERROR / SEQUENCES)
    assert sum(look.decision == wrong for look in ended) / SEQUENCES <= ERROR + scatter
    assert sum(decision == wrong for decision in naive) / SEQUENCES > 2.0 * (ERROR + scatter)


@pytest.mark.parametrize(("ratio", "right"), [(0.7, "met"), (1.4, "not-met")])
def test_repeated_looks_end_early_in_a_clear_case(ratio: float, right: str) -> None:
    ended = [_ended(looks) for looks in _looks(ratio, seed=2, growth=5)]
    assert np.mean([look is not None and look.decision == right for look in ended]) > 0.95
    assert np.median([look.count for look in ended if look is not None]) < LAST / 2


def test_the_shares_of_all_looks_sum_up_to_the_error() -> None:
    assert sum(map(allowed_p_value, range(1, 100_000))) == pytest.approx(ERROR, rel=1e-3)


def test_a_decision_counts_when_a_later_look_with_half_as_many_more_poses_repeats_it() -> None:
    first, soon, later = Look(20, "met", 1e-6), Look(29, "met", 1e-6), Look(30, "met", 1e-6)
    assert not is_decided(counted_looks([first]))
    assert not is_decided(counted_looks([first, soon]))
    assert next_count([first]) == 30
    assert is_decided(counted_looks([first, soon, later]))
    assert not is_decided(counted_looks([first, Look(30, "not-met", 1e-6)]))
    assert not is_decided(counted_looks([first, Look(30, "met", 0.04)]))
    assert not is_decided(counted_looks([Look(20, "", 0.2), later]))
