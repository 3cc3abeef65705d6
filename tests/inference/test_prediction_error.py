"""Causes that predict held-out poses worse than chance are not accepted."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.tolerance import assert_between, assert_close
from truing.inference.observations import Frames, Observations
from truing.inference.prediction import PredictionError, predicts_worse

TRIALS, TARGETS = 4000, 8
MODEL = SimpleNamespace(error_groups=None, zero_groups=None)


def _error(gap: NDArray, sigma: float = 1.0) -> PredictionError:
    poses, whitened = len(gap), gap / sigma
    is_observed = np.ones(gap.shape[:2], bool)
    measured = Observations(gap, np.broadcast_to(sigma**2 * np.eye(3), (*gap.shape, 3)), is_observed)
    frames = Frames(np.broadcast_to(np.eye(3), (poses, 3, 3)), np.zeros((poses, 3)))
    none = np.zeros((poses, 0))
    return PredictionError(gap, measured, whitened, frames, none, none[..., None], MODEL, none[0])


def _vetoes(poses: int, size: float, share: float) -> float:
    """Return the rate at which a cause is refused whose modelled effect is ``size`` sigmas in each pose.

    ``share``: the part of the modelled effect that the data contain.
    """
    rng = np.random.default_rng(7)
    count = 0
    for noise in rng.standard_normal((TRIALS, poses, TARGETS, 3)):
        reported = rng.standard_normal(noise.shape)
        reported *= size / np.sqrt(np.sum(reported**2, (1, 2), keepdims=True))
        before, after = _error(noise + share * reported), _error(noise + (share - 1.0) * reported)
        count += predicts_worse(before, after, np.ones(poses, bool))
    return count / TRIALS


@pytest.mark.slow
@pytest.mark.parametrize("poses", [3, 6, 20])
def test_a_cause_with_half_of_the_true_effect_is_refused_at_the_stated_rate(poses: int) -> None:
    """It predicts as accurately as no cause: 0.6 % are refused, within four standard errors of the trials."""
    assert_between(_vetoes(poses, 2.0, 0.5), 0.001, 0.011, what="refused")


@pytest.mark.slow
def test_few_poses_refuse_a_wrong_cause_and_never_a_right_one() -> None:
    assert _vetoes(3, 2.0, 1.0) == 0.0
    assert _vetoes(3, 8.0, 0.0) > 0.99


def test_a_smaller_noise_with_the_cause_does_not_count_as_worse_prediction() -> None:
    noise = np.random.default_rng(3).standard_normal((40, TARGETS, 3))
    assert not predicts_worse(_error(noise), _error(0.999 * noise, sigma=0.9), np.ones(40, bool))


def test_growth_is_that_of_the_gaps_whatever_noise_each_error_counts_with() -> None:
    gap = np.random.default_rng(1).standard_normal((5, TARGETS, 3))
    assert_close(_error(1.5 * gap, sigma=0.1).growth_over(_error(gap, sigma=3.0)), 1.5, atol=1e-12)


def test_growth_counts_what_both_errors_see() -> None:
    gap = np.random.default_rng(1).standard_normal((5, TARGETS, 3))
    wild = gap.copy()
    wild[2, 3] = 1e3
    is_observed = np.ones(gap.shape[:2], bool)
    is_observed[2, 3] = False
    whole = _error(wild)
    assert_close(
        replace(whole, measured=replace(whole.measured, is_observed=is_observed)).growth_over(whole), 1.0, atol=1e-12
    )
