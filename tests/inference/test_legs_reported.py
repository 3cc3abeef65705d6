"""Reported legs of an effect: all choices of six legs compete on scores with realistic correlations."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.tolerance import assert_between
from truing.inference.scores import log_evidence_of
from truing.simulation.mechanisms.causes.per_leg import choice_share, choices

FREEDOM = 4000.0
STAND: Any = SimpleNamespace(
    noise=SimpleNamespace(observed_total=FREEDOM, inputs_total=0.0, observed=FREEDOM, inputs=0.0),
    model=SimpleNamespace(part_count=6),
)
# Neighbours share what one platform shows of them.
_SHARED = 0.3 * (np.eye(6)[:, [1, 0, 3, 2, 5, 4]] + np.roll(np.eye(6), 1, 0))
GRAM = 12.0**2 * (np.eye(6) + (_SHARED + _SHARED.T) / 2)


def _reported_legs(scores: NDArray) -> tuple[int, ...]:
    """The most probable choice of legs, counted from 1; empty for all."""
    return max(choices(6), key=lambda legs: np.log(choice_share(len(legs), 6)) + _evidence(scores, legs))


def _evidence(scores: NDArray, legs: tuple[int, ...]) -> float:
    own = np.array(legs or range(1, 7)) - 1
    values, vectors = np.linalg.eigh(GRAM[np.ix_(own, own)])
    strengths = np.sqrt(values)
    candidate: Any = SimpleNamespace(
        signature=SimpleNamespace(strengths=strengths, loadings=vectors),
        cause=SimpleNamespace(like_sized=lambda _: tuple(range(len(own))), has_known_scale=False),
    )
    return log_evidence_of(candidate, STAND, vectors.T @ scores[own] / strengths, 1.0)


# Amounts near to each other, of one sign or of either: whoever knew how they are drawn would tell nearly all.
@pytest.mark.parametrize(("count", "signal", "least"), [(1, 8.0, 28), (6, 8.0, 28), (3, 12.0, 23)])
def test_legs_that_err_are_reported(count: int, signal: float, least: int) -> None:
    rng, right = np.random.default_rng(count), 0
    root = np.linalg.cholesky(GRAM)
    for _ in range(30):
        truth = np.isin(range(6), rng.choice(6, count, replace=False))
        signs = rng.choice([-1, 1], 6) if rng.random() < 0.5 else np.ones(6)
        amounts = np.where(truth, signs * rng.uniform(0.7, 1.3, 6), 0.0)
        scores = GRAM @ amounts * (signal / np.sqrt(amounts @ GRAM @ amounts)) + root @ rng.normal(size=6)
        right += _reported_legs(scores) == (() if count == 6 else tuple((np.flatnonzero(truth) + 1).tolist()))
    assert_between(right, least, 30, what=f"right choices of {count} legs, of 30")
