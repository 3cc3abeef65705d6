"""Single large errors of one joint are distinguished from normal errors and from wrong targets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.simulation.mechanisms.chains.made_arms import campaign
from truing.inference.fitter import Fitter
from truing.inference.observations import Epochs, Frames, Observations
from truing.inference.single_errors import SingleErrors, single_errors
from truing.simulation.mechanisms.chains.causes import ChainCause
from truing.simulation.mechanisms.chains.nonparametric import NonparametricChainEffect

POSES, NOISE_M, NOISE_RAD = 60, 2e-5, 2e-5


def reported(seed: int, errors: NDArray, shifts: NDArray | float = 0.0) -> SingleErrors[ChainCause] | None:
    """Single errors found for errors (B, 5) of the joints in sigmas and shifts (B, 3, 3) of the targets in m."""
    rng = np.random.default_rng(seed)
    model = campaign(rng, POSES, 3)
    model = replace(model, known=replace(model.known, reading_sigma=np.full(5, NOISE_RAD)))
    values = model.points(0.3 * rng.normal(size=model.shared_size) * (np.arange(model.shared_size) > 5), errors)
    values = values + rng.normal(0.0, NOISE_M, values.shape) + shifts
    covariance = np.broadcast_to(NOISE_M**2 * np.eye(3), (*values.shape, 3))
    measured = Observations(values, covariance, np.ones(values.shape[:2], bool))
    frames = Frames(np.tile(np.eye(3), (POSES, 1, 1)), np.zeros((POSES, 3)), free=False)
    fitter: Fitter[ChainCause] = Fitter(model, Epochs(measured, model.conditions, frames), None, 1, lambda what: None)
    final = fitter.prepared(())
    return single_errors(final, final.scene.single_errors(NonparametricChainEffect()), fitter.input_factor)


def normal(seed: int) -> NDArray:
    return np.random.default_rng([seed, 1]).normal(size=(POSES, 5))


@pytest.mark.parametrize("joint", [1, 2])
def test_a_joint_that_sometimes_stops_far_off_is_named_with_the_number_of_its_errors(joint: int) -> None:
    errors = normal(joint)
    errors[[7, 23, 31, 50], joint] = [25.0, -40.0, 18.0, -22.0]
    found = reported(joint, errors)
    assert found is not None
    assert found.candidate.cause.subject == f"joint j{joint + 1}"
    assert 3 <= found.count <= 4
    assert found.p_value < 1e-3


def test_normal_errors_and_scatter_of_one_joint_are_no_single_errors() -> None:
    assert reported(3, normal(3)) is None
    assert reported(4, normal(4) * np.array([1.0, 6.0, 1.0, 1.0, 1.0])) is None


def test_a_target_that_is_sometimes_far_off_is_no_error_of_a_joint() -> None:
    shifts = np.zeros((POSES, 3, 3))
    shifts[[7, 23, 31, 50], 1] = np.random.default_rng(5).normal(0.0, 4e-4, (4, 3))
    assert reported(5, normal(5), shifts) is None
