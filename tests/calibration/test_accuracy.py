"""Errors that 95 of 100 poses do not exceed, without the measurement's noise; their interval contains the truth."""

from __future__ import annotations

import numpy as np
import pytest

from truing.calibration.accuracy import Decision, chance_at_limit, deciding_pose_count, error_of_95_percent

TRIALS, POSES, MACHINE, NOISE = 2000, 30, 3.0, 1.0
TRUE = 1.959964 * MACHINE


def test_the_error_of_95_percent_is_the_machines_own_and_its_interval_holds_it() -> None:
    rng = np.random.default_rng(5)
    errors = rng.normal(scale=np.hypot(MACHINE, NOISE), size=(TRIALS, POSES))
    found = [error_of_95_percent(error, np.full(POSES, NOISE**2)) for error in errors]
    reported = np.array([(one.lower, one.value, one.upper) for one in found if one is not None])
    assert len(reported) == TRIALS
    covered = np.mean((reported[:, 0] <= TRUE) & (reported[:, 2] >= TRUE))
    assert abs(covered - 0.95) < 4.0 * np.sqrt(0.95 * 0.05 / TRIALS)
    # of a mean square of normal errors: variance 2 (machine^2 + noise^2)^2 / N
    square = (reported[:, 1] / 1.959964) ** 2
    spread = (MACHINE**2 + NOISE**2) * np.sqrt(2.0 / POSES / TRIALS)
    assert abs(square.mean() - MACHINE**2) < 4.0 * spread


def test_a_measurement_noisier_than_what_was_seen_leaves_no_error() -> None:
    found = error_of_95_percent(np.array([1.0, -1.0, 1.0]), np.full(3, 100.0))
    assert found is not None
    assert found.value == 0.0
    assert found.lower == 0.0
    assert found.upper > 0.0


def test_poses_without_an_error_do_not_count() -> None:
    some = error_of_95_percent(np.array([1.0, np.nan, -2.0]), np.array([0.1, 9.0, 0.1]))
    assert some == error_of_95_percent(np.array([1.0, -2.0]), np.array([0.1, 0.1]))
    assert error_of_95_percent(np.full(3, np.nan), np.ones(3)) is None


@pytest.mark.parametrize("factor", [1e-3, 180.0 / np.pi])
def test_results_are_independent_of_the_unit(factor: float) -> None:
    errors, variances = np.array([1.0, -2.0, 0.5]), np.array([0.2, 0.1, 0.3])
    one, other = error_of_95_percent(errors, variances), error_of_95_percent(factor * errors, factor**2 * variances)
    assert one is not None
    assert other is not None
    expected = [factor * value for value in (one.value, one.lower, one.upper)]
    assert [other.value, other.lower, other.upper] == pytest.approx(expected)


def _undecided(spare: int = 0) -> tuple[np.ndarray, float, Decision]:
    """Return errors of few poses, a limit in their interval, and what decides it."""
    errors = np.random.default_rng(11).normal(scale=np.hypot(MACHINE, NOISE), size=8)
    found = error_of_95_percent(errors, np.full(8, NOISE**2))
    assert found is not None
    limit = 0.8 * found.upper
    assert found.lower < found.value < limit
    decision = deciding_pose_count(errors, np.full(8, NOISE**2), limit, spare)
    assert decision is not None
    return errors, limit, decision


def test_further_poses_that_miss_by_as_much_decide_and_one_less_does_not() -> None:
    errors, limit, decision = _undecided()
    assert decision.poses == 8
    assert decision.more_poses is not None
    assert decision.then is not None
    mean = np.sqrt(np.mean(errors**2))
    for fewer, is_decided in ((0, True), (1, False)):
        more = np.concatenate([errors, np.full(decision.more_poses - fewer, mean)])
        found = error_of_95_percent(more, np.full(len(more), NOISE**2))
        assert found is not None
        assert (found.upper <= limit) == is_decided
        if is_decided:
            assert [found.lower, found.upper] == pytest.approx([decision.then.lower, decision.then.upper])


def test_simulated_poses_of_that_size_decide_about_every_second_time() -> None:
    """The expected number of poses is the median: in about half of the draws more are needed."""
    (errors, limit, decision), rng = _undecided(), np.random.default_rng(12)
    assert decision.more_poses is not None
    size = np.sqrt(np.mean(errors**2))
    drawn = rng.normal(scale=size, size=(TRIALS, decision.more_poses))
    found = [error_of_95_percent(np.append(errors, one), np.full(8 + len(one), NOISE**2)) for one in drawn]
    share = np.mean([one is not None and one.upper <= limit for one in found])
    assert 0.4 < share < 0.65


def test_poses_that_were_fitted_to_count_no_more_next_to_further_ones() -> None:
    (_, _, both), (_, _, alone) = _undecided(), _undecided(spare=8)
    assert both.more_poses is not None
    assert alone.more_poses == both.more_poses + 8


def test_a_requirement_decided_or_at_its_limit_asks_for_no_further_poses() -> None:
    errors, variances = np.array([1.0, -2.0, 0.5]), np.zeros(3)
    found = error_of_95_percent(errors, variances)
    assert found is not None
    assert deciding_pose_count(errors, variances, 2.0 * found.upper) is None
    assert deciding_pose_count(errors, variances, 0.5 * found.lower) is None
    assert deciding_pose_count(np.full(3, np.nan), variances, 1.0) is None
    assert deciding_pose_count(errors, variances, found.value) == Decision(3)


def test_the_p_value_of_a_limit_at_an_end_of_the_interval_is_that_of_the_interval() -> None:
    errors = np.random.default_rng(4).normal(scale=np.hypot(MACHINE, NOISE), size=POSES)
    variances = np.full(POSES, NOISE**2)
    found = error_of_95_percent(errors, variances)
    assert found is not None
    for limit in (found.lower, found.upper):
        assert chance_at_limit(errors, variances, limit) == pytest.approx(0.05)
    assert (
        chance_at_limit(errors, variances, 1.2 * found.upper) < 0.05 < chance_at_limit(errors, variances, found.value)
    )
    assert chance_at_limit(np.zeros(3), np.zeros(3), 0.0) == 1.0
    assert np.isnan(chance_at_limit(np.full(3, np.nan), np.ones(3), 1.0))
