"""Laws of the equations of every calibration: exact derivatives, and batches that equal single evaluations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tests.tolerance import assert_close
from truing.simulation.mechanisms.calibration_problem import CalibrationProblem

_STEP = 1e-30


def assert_derivatives_exact(
    problem: CalibrationProblem, values: NDArray, deviation: NDArray, atol: tuple[float, float] = (1e-13, 1e-12)
) -> None:
    """Hold derivatives by deviations and by values, each within its tolerance, to complex steps."""
    found = problem.constrain(values, deviation)
    for j, nudge in enumerate(1j * _STEP * np.eye(problem.deviations)):
        expected = problem.constrain(values, deviation + nudge).value.imag / _STEP
        assert_close(found.by_deviation[..., j], expected, atol=atol[0], what=f"deviation {j}")
    for j, nudge in enumerate(1j * _STEP * np.eye(len(values))):
        expected = problem.constrain(values + nudge, deviation).value.imag / _STEP
        assert_close(found.by_values[..., j], expected, atol=atol[1], what=problem.entries[j].label)


def assert_batch_is_its_members(problem: CalibrationProblem, values: NDArray, deviation: NDArray) -> None:
    """Hold many values (S, P) with deviations (S, B, n), constrained at once, to one after the other."""
    found = problem.constrain(values, deviation)
    for i in range(len(values)):
        single = problem.constrain(values[i], deviation[i])
        assert_close(found.value[i], single.value, atol=1e-14, what="value")
        assert_close(found.by_deviation[i], single.by_deviation, atol=1e-12, what="by deviation")
        assert_close(found.by_values[i], single.by_values, atol=1e-12, what="by values")
