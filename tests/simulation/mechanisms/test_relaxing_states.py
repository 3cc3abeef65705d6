"""States that relax after movements represent every slow recovery of a machine, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from truing.simulation.inputs import RELAXING, relaxing_states

TIME = np.cumsum(np.random.default_rng(0).uniform(8.0, 12.0, 120))
READINGS = np.column_stack(
    [np.sin(TIME / 190.0), np.sin(TIME / 140.0 + 1.0), np.random.default_rng(1).normal(size=120).cumsum()]
)


def _recovery(readings: NDArray, tau: float) -> NDArray:
    """State of a spring and a damper in series at each pose, by small time steps along even movements."""
    fine = np.linspace(TIME[0], TIME[-1], 200_001)
    path, step = np.interp(fine, TIME, readings), fine[1] - fine[0]
    held = np.zeros_like(fine)
    for index in range(1, len(fine)):
        held[index] = held[index - 1] * (1.0 - step / tau) + path[index] - path[index - 1]
    return np.interp(TIME, fine, held)


@pytest.mark.parametrize("tau", [20.0, 60.0, 200.0])
@pytest.mark.parametrize("reading", [0, 2])
def test_a_viscoelastic_recovery_is_a_sum_of_the_states(tau: float, reading: int) -> None:
    states = relaxing_states(READINGS, TIME)
    assert states is not None
    held = _recovery(READINGS[:, reading], tau)
    left = held - states[:, reading] @ np.linalg.lstsq(states[:, reading], held, rcond=None)[0]
    assert np.sum(left**2) < 0.02 * np.sum(held**2)  # three time constants stand for all


def test_states_are_without_correlation_and_independent_of_units_and_of_the_order_of_rows() -> None:
    states = relaxing_states(READINGS, TIME)
    assert states is not None
    assert states.shape == (*READINGS.shape, len(RELAXING))
    products = np.einsum("bls,blt->lst", states, states) / len(TIME)
    np.testing.assert_allclose(products, np.broadcast_to(np.eye(len(RELAXING)), products.shape), atol=1e-9)
    mixed = np.random.default_rng(2).permutation(len(TIME))
    other = relaxing_states(1e3 * READINGS[mixed], TIME[mixed] + 1e5)
    assert other is not None
    planes = [own @ own.transpose(0, 2, 1) for own in (states[mixed].transpose(1, 0, 2), other.transpose(1, 0, 2))]
    np.testing.assert_allclose(planes[0], planes[1], atol=1e-6)


def test_a_machine_at_rest_and_times_that_are_unknown_give_no_states() -> None:
    assert relaxing_states(READINGS, np.full(len(TIME), 5.0)) is None
    assert relaxing_states(READINGS, np.full(len(TIME), np.nan)) is None
    still = relaxing_states(np.zeros_like(READINGS), TIME)
    assert still is not None
    assert not still.any()
