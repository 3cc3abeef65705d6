"""Late readings: rates along a path, and the cause on legs and on a chain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.simulation.mechanisms.chains.made_arms import campaign
from tests.simulation.mechanisms.telescope import sample_model
from tests.tolerance import assert_between, assert_close
from truing.inference.observations import Epochs, Frames, Observations
from truing.inference.selection import CauseDiagnosis, CauseSelection, Settings
from truing.simulation.catalogue import catalogue_of_chains
from truing.simulation.inputs import RATE, rates
from truing.simulation.mechanisms.causes.reading_lag import ReadingLag
from truing.simulation.mechanisms.chains.conditions import movements
from truing.simulation.mechanisms.chains.model import ChainModel
from truing.simulation.mechanisms.chains.reading_lag import ChainReadingLag

POSES, NOISE_M = 80, 2e-5
TIME = 0.5 * np.arange(POSES)
SPEEDS = 2.0 * np.pi * np.array([1.1, 1.6, 0.9, 1.3, 1.9]) / TIME[-1]


def path(time_s: NDArray) -> NDArray:
    """Readings (B, 5) at times (B,) along a smooth path of one to two cycles."""
    return np.sin(SPEEDS * time_s[:, None] + np.arange(5.0))


def test_rates_are_the_derivative_of_a_path_at_any_times() -> None:
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.3, 0.6, POSES))
    order = rng.permutation(POSES)
    found = rates(path(time)[order], time[order])
    assert found is not None
    assert_close(found, (SPEEDS * np.cos(SPEEDS * time[:, None] + np.arange(5.0)))[order], atol=2e-3 * SPEEDS.max())


def test_a_pause_begins_a_new_path() -> None:
    """The jump of readings during a pause is no rate of any reading."""
    time = np.where(np.arange(POSES) < POSES // 2, TIME, TIME + 600.0)
    found = rates(path(time), time)
    assert found is not None
    assert np.abs(found).max() < 1.05 * SPEEDS.max()


@pytest.mark.parametrize(
    ("readings", "time"),
    [
        pytest.param(np.random.default_rng(1).uniform(-1.0, 1.0, (POSES, 5)), TIME, id="random order"),
        pytest.param(np.repeat(path(TIME)[::4], 4, axis=0), TIME, id="four times each"),
        pytest.param(path(TIME), None, id="no times"),
        pytest.param(path(TIME), np.zeros(POSES), id="one time"),
        pytest.param(path(TIME)[:6], TIME[:6], id="few readings"),
        pytest.param(np.ones((POSES, 5)), TIME, id="at rest"),
    ],
)
def test_readings_along_no_path_have_no_rates(readings: NDArray, time: NDArray | None) -> None:
    assert rates(readings, time) is None


def test_late_legs_are_where_they_are_read_later() -> None:
    plain, cause = sample_model(np.random.default_rng(3), POSES), ReadingLag()
    rate = 1e-3 * np.random.default_rng(4).normal(size=plain.conditions.readings.shape)
    plain = plain.at(replace(plain.conditions, covariates={RATE: rate}))
    late = plain.with_causes((cause,))
    assert [one.id for one in cause.candidates(plain.scene)] == ["reading-lag"]
    shared, local = np.zeros(plain.shared_size), np.zeros((POSES, plain.local_size))
    with_lag = np.zeros(late.shared_size)
    with_lag[late.layout[cause.key]] = 0.05 / late.effect_sigma(cause)
    later = plain.at(replace(plain.conditions, readings=plain.conditions.readings + 0.05 * rate))
    assert_close(late.points(with_lag, local), later.points(shared, local), atol=1e-12)


def _moving_chain(seed: int) -> ChainModel:
    model = campaign(np.random.default_rng(seed), POSES, 3)
    covariates = {**model.conditions.covariates, "time_s": TIME}
    covariates |= movements(path(TIME), covariates, np.full(5, 1e-3))
    known = replace(model.known, gear_orders=dict.fromkeys(model.tree.readings, ()))
    return replace(model, known=known).at(replace(model.conditions, readings=path(TIME), covariates=covariates))


def _diagnosed(seed: int, readings_then: NDArray) -> CauseDiagnosis:
    """Return the diagnosis of a chain that was measured at other readings than the recorded ones."""
    rng, model = np.random.default_rng(seed), _moving_chain(seed)
    shared = 0.3 * rng.normal(size=model.shared_size) * (np.arange(model.shared_size) > 5)
    points = model.at(replace(model.conditions, readings=readings_then)).points(shared, np.zeros((POSES, 0)))
    seen = points + rng.normal(0.0, NOISE_M, points.shape)
    covariance = np.broadcast_to(NOISE_M**2 * np.eye(3), (*seen.shape, 3))
    measured = Observations(seen, covariance, np.ones(seen.shape[:2], bool))
    frames = Frames(np.tile(np.eye(3), (POSES, 1, 1)), np.zeros((POSES, 3)), free=False)
    search = CauseSelection(model, Epochs(measured, model.conditions, frames), None, Settings(0.05, 200, 1))
    return search.run(list(catalogue_of_chains().values()))


@pytest.mark.slow
@pytest.mark.parametrize("lag_s", [0.02, -0.01])
def test_a_lag_of_all_joints_is_the_one_name(lag_s: float) -> None:
    found = [v for v in _diagnosed(5, path(TIME + lag_s)).verdicts if v.verdict not in ("rejected", "not testable")]
    assert [(v.cause.id, v.verdict) for v in found] == [("reading-lag", "found")]
    sigma = float(np.sqrt(found[0].covariance[0, 0]))
    assert_between(abs(float(found[0].values[0]) - lag_s) / sigma, 0.0, 4.0)
    assert sigma < 0.1 * abs(lag_s)


def test_a_moving_chain_without_lag_has_none() -> None:
    assert all(v.cause.id != "reading-lag" or v.verdict == "rejected" for v in _diagnosed(6, path(TIME)).verdicts)


def test_a_chain_in_random_order_is_not_asked() -> None:
    assert not ChainReadingLag().candidates(campaign(np.random.default_rng(1), POSES).scene)
