"""Gross errors stand out; points that an effect moves do not."""

from __future__ import annotations

import numpy as np

from truing.estimation.diagnosis.screening import gross_errors


def test_gross_errors_are_taken_out_and_little_else() -> None:
    rng = np.random.default_rng(1)
    rest, seen = rng.normal(size=(40, 50, 3)), rng.random((40, 50)) > 0.05
    wrong = np.zeros(seen.shape, bool)
    wrong[rng.integers(0, 40, 20), rng.integers(0, 50, 20)] = True
    found = gross_errors(np.where(wrong[..., None], rest + 12.0, rest), seen)
    assert (found == (wrong & seen)).all()


def test_a_target_that_moves_with_an_effect_is_kept() -> None:
    rng = np.random.default_rng(2)
    rest = rng.normal(size=(40, 10, 3))
    rest[:, 3] += 20.0 * rng.uniform(-1, 1, (40, 1))
    rest[20:, 5] += 15.0
    assert not gross_errors(rest, np.ones((40, 10), bool)).any()


def test_nothing_seen_is_nothing_wrong() -> None:
    assert not gross_errors(np.zeros((2, 3, 3)), np.zeros((2, 3), bool)).any()
