"""The sigma of a shape parameter follows the wider side of the sum of squares, and is never below its curvature's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.tolerance import assert_close
from truing.inference.shape_uncertainty import shape_covariance_factors
from truing.simulation.bench.causes.load_history import Creep

SIGMA, NOISE = 0.3, 1.7


@dataclass(frozen=True)
class Shaped:
    """An effect of one size and one shape; ``shape`` is where it is held, in sigmas."""

    shape: float = 0.0

    def with_fixed_shape(self, shape: np.ndarray) -> Shaped:
        return Shaped(float(shape[0]) / SIGMA)


def factors(rise: Callable[[float], float]) -> np.ndarray:
    """Of a fit whose sum of squares, in those of the noise, rises so over the shape in sigmas."""

    def fitted(causes: Any, start: Any = None) -> Any:
        squares = 5.0 + rise(next(cause.shape for cause in causes if isinstance(cause, Shaped)))
        whitened = SimpleNamespace(rest=np.array([NOISE * np.sqrt(squares)]))
        covariance = np.array([[4.0, 0.1], [0.1, SIGMA**2]])
        reported = (np.array([1.0, 0.0]), covariance)
        return SimpleNamespace(
            causes=causes, fit=SimpleNamespace(whitened=whitened), noise_ratio=NOISE, values=lambda _: reported
        )

    cause = Shaped()
    return shape_covariance_factors(SimpleNamespace(comparable=fitted), fitted(("another", cause)), cause, 1)


@pytest.mark.parametrize(
    ("rise", "wider"),
    [
        (lambda z: z**2, 1.0),
        (lambda z: z**2 * (1.0 if z > 0 else 0.25), 2.0),  # one side as if sigma were twice as large
        (lambda z: z**2 * (0.25 if z > 0 else 3.0), 2.0),
        (lambda z: 5 * z**2, 1.0),  # steeper than its curvature: not narrower than that
        (lambda z: min(z, 0.0) ** 2, 4.0),  # open to one side
        (lambda z: -0.1 * abs(z), 4.0),  # no minimum at all
    ],
)
def test_the_wider_side_counts(rise: Callable[[float], float], wider: float) -> None:
    assert_close(factors(rise), np.outer([1.0, wider], [1.0, wider]), atol=1e-9, what="factors")


def test_a_shape_that_is_not_asked_keeps_its_sigma() -> None:
    class Linear(Shaped):
        def with_fixed_shape(self, shape: np.ndarray) -> None:
            return None

    cause = Linear()
    final = SimpleNamespace(causes=(cause,), values=lambda _: (np.zeros(2), np.eye(2)))
    factors = shape_covariance_factors(SimpleNamespace(), final, cause, 1)
    assert_close(factors, np.ones((2, 2)), atol=0.0, what="factors")


def test_a_creep_is_contested_by_other_time_constants_and_reported_by_the_upper_end_of_its_interval() -> None:
    creep = Creep("fz", 60.0).refined()
    assert creep.with_fixed_shape(np.array([0.3])) == Creep("fz", pytest.approx(60.0 * np.exp(0.3)))
    fraction, tau = creep.reported(np.array([0.01, 0.3]), np.diag([1e-6, 0.25]), 6)
    assert fraction.sigma == pytest.approx(1e-3)
    assert tau.value + 1.96 * (tau.sigma or 0.0) == pytest.approx(60.0 * np.exp(0.3 + 1.96 * 0.5), rel=1e-4)
