"""The fit of a model converges where full Gauss-Newton steps diverge or converge slowly."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.tolerance import assert_close
from truing.inference.fit import FitState, fit_model, linearise, shared_without
from truing.inference.observations import Frames, Observations

TRUE, STEEP, PRIOR = 0.4, 30.0, 1e4


@dataclass(frozen=True)
class Saturating:
    """A reading that saturates: from far away, a full step overshoots ever more."""

    at: NDArray  # (B,)

    zeros = None

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> SimpleNamespace:
        away = STEEP * (PRIOR * shared[0] - self.at)
        points = np.arctan(away)[:, None, None]
        slope = PRIOR * STEEP / (1.0 + away**2)
        return SimpleNamespace(
            values=points,
            by_shared=slope[:, None, None, None] if by_shared else np.empty((len(self.at), 1, 1, 0)),
            by_local=np.empty((len(self.at), 1, 1, 0)),
            known_residual=np.empty(0),
            known_by_shared=np.empty((0, 1)),
            shared_known=np.ones(1, bool),
            local_known=np.empty(0, bool),
            zero_columns=None,
        )


def test_a_step_that_would_make_things_worse_is_halved() -> None:
    model = Saturating(TRUE + np.linspace(-0.02, 0.02, 9))
    truth = model.predict(np.array([TRUE / PRIOR]), np.zeros((9, 0))).values
    measured = Observations(truth, np.full((9, 1, 1, 1), 1e-10), np.ones((9, 1), bool))
    fit = fit_model(model.predict, measured, Frames.of_numbers(9), np.array([0.0]), np.zeros((9, 0)))
    assert fit.state == FitState.SETTLED
    assert_close(PRIOR * fit.shared, [TRUE], atol=1e-6)


@dataclass(frozen=True)
class Bent:
    """Readings that bend, (x, b x^2): where they fit badly, full steps shrink by a constant share each."""

    bend: float

    zeros = None

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> SimpleNamespace:
        x = PRIOR * shared[0]
        slopes = PRIOR * np.array([1.0, 2.0 * self.bend * x]).reshape(1, 2, 1, 1)
        return SimpleNamespace(
            values=np.array([x, self.bend * x**2]).reshape(1, 2, 1),
            by_shared=slopes if by_shared else np.empty((1, 2, 1, 0)),
            by_local=np.empty((1, 2, 1, 0)),
            known_residual=np.empty(0),
            known_by_shared=np.empty((0, 1)),
            shared_known=np.ones(1, bool),
            local_known=np.empty(0, bool),
            zero_columns=None,
        )


@pytest.mark.parametrize("away", [-1.0, 1.0])
def test_a_fit_converges_where_full_steps_shrink_by_a_tenth_each(away: float) -> None:
    """The share is 2 b r, r the second residual: at x = 0 the slope there is zero. Either sign: to and fro, or on."""
    bend, sigma = 0.5, 1e-3
    measured = Observations(
        np.array([0.1, 0.9 * away]).reshape(1, 2, 1), np.full((1, 2, 1, 1), sigma**2), np.ones((1, 2), bool)
    )
    fit = fit_model(Bent(bend).predict, measured, Frames.of_numbers(1), np.array([0.3 / PRIOR]), np.zeros((1, 0)))
    x = np.roots([2.0 * bend**2, 0.0, 1.0 - 2.0 * bend * 0.9 * away, -0.1])
    best = x[np.abs(x.imag) < 1e-9].real
    assert fit.state == FitState.SETTLED
    assert fit.iterations < 12
    assert_close(PRIOR * fit.shared, best, atol=0.1 * sigma)


def test_a_problem_without_epochs_is_that_of_observations_without_them() -> None:
    model = Saturating(TRUE + np.linspace(-0.02, 0.02, 9))
    unknowns = Frames.of_numbers(9), np.array([0.5]), np.zeros((9, 0))
    values = model.predict(np.array([TRUE / PRIOR]), np.zeros((9, 0))).values
    measured = Observations(values, np.full((9, 1, 1, 1), 1e-10), np.ones((9, 1), bool))
    own = np.arange(9) < 3
    others = replace(measured, is_observed=measured.is_observed & ~own[:, None])
    found = linearise(model.predict, measured, *unknowns).without(own)
    expected = linearise(model.predict, others, *unknowns)
    assert np.abs(expected.residual[own]).max() == 0.0 < np.abs(expected.residual[~own]).min()
    for name in ("residual", "by_local", "by_shared", "local_value", "present"):
        assert np.array_equal(getattr(found, name), getattr(expected, name)), name


@dataclass
class Counted:
    """A model that counts how often it was asked for derivatives by the shared unknowns, and for values alone."""

    model: Saturating
    slopes: int = 0
    values: int = 0

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> SimpleNamespace:
        self.slopes += by_shared
        self.values += not by_shared
        return self.model.predict(shared, local, by_shared)


def _noisy(sigma: float) -> tuple[Saturating, Observations]:
    model = Saturating(TRUE + np.linspace(-0.02, 0.02, 9))
    truth = model.predict(np.array([TRUE / PRIOR]), np.zeros((9, 0))).values
    values = truth + sigma * np.random.default_rng(3).normal(size=truth.shape)
    return model, Observations(values, np.full((9, 1, 1, 1), sigma**2), np.ones((9, 1), bool))


def test_near_the_optimum_derivatives_are_formed_only_before_and_after() -> None:
    model, measured = _noisy(1e-3)
    counted = Counted(model)
    start = np.array([(TRUE + 1e-4) / PRIOR])  # ten standard deviations away
    fit = fit_model(counted.predict, measured, Frames.of_numbers(9), start, np.zeros((9, 0)))
    assert fit.state == FitState.SETTLED
    assert fit.whitened.explained < 1e-4
    assert (counted.slopes, fit.iterations) == (2, 1)
    assert counted.values > 0


def test_shared_unknowns_without_epochs_are_those_of_a_fit_to_the_others() -> None:
    model, measured = _noisy(1e-3)
    frames, out = Frames.of_numbers(9), np.arange(9) < 4
    fit = fit_model(model.predict, measured, frames, np.array([0.3 / PRIOR]), np.zeros((9, 0)))
    others = replace(measured, is_observed=measured.is_observed & ~out[:, None])
    counted = Counted(model)
    found = shared_without(counted.predict, others, fit, out)
    expected = fit_model(model.predict, others, frames, fit.shared, np.zeros((9, 0)))
    sigma = float(np.sqrt(expected.whitened.covariance()[0, 0]))
    assert abs(fit.shared[0] - expected.shared[0]) > 0.3 * sigma
    assert_close(found, expected.shared, atol=0.02 * sigma)
    assert counted.slopes == 0
