"""The noise floor follows from the declared noise, whatever the scatter of the data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.simulation.mechanisms.chains.made_arms import campaign
from tests.tolerance import assert_between
from truing.inference.fitted_model import FittedModel
from truing.inference.fitter import Fitter
from truing.inference.observations import Epochs, Frames, Observations
from truing.simulation.mechanisms.chains.causes import ChainCause

POSES, NOISE_M, DECLARED_RAD = 60, 2e-5, 2e-5


def fitted(times: float) -> FittedModel[ChainCause]:
    """The plain model, fitted to points and readings that scatter by this many times their declared noise."""
    rng = np.random.default_rng(7)
    model = campaign(rng, POSES, 3)
    model = replace(model, known=replace(model.known, reading_sigma=np.full(5, DECLARED_RAD)))
    shared = 0.3 * rng.normal(size=model.shared_size) * (np.arange(model.shared_size) > 5)
    values = model.points(shared, times * rng.normal(size=(POSES, 5)))
    values = values + rng.normal(0.0, times * NOISE_M, values.shape)
    covariance = np.broadcast_to(NOISE_M**2 * np.eye(3), (*values.shape, 3))
    measured = Observations(values, covariance, np.ones(values.shape[:2], bool))
    frames = Frames(np.tile(np.eye(3), (POSES, 1, 1)), np.zeros((POSES, 3)), free=False)
    fitter: Fitter[ChainCause] = Fitter(model, Epochs(measured, model.conditions, frames), None, 1, lambda what: None)
    return fitter.prepared(())


def test_noise_of_several_times_the_declared_does_not_raise_the_floor() -> None:
    floors = {times: fitted(times).floor.rms_of() for times in (0.7, 1.0, 1.4)}
    for times, floor in floors.items():
        assert_between(floor / floors[1.0], 0.95, 1.05, what=f"floor at {times} times the declared noise")


def test_errors_are_as_many_floors_as_the_noise_is_declared_ones() -> None:
    final = fitted(1.4)
    assert_between(final.error.rms_of(slice(None)) / final.floor.rms_of(), 1.3, 1.5, what="rms over floor")
