"""The fit of a model of numbers: it settles where full steps of Gauss-Newton would leave for ever."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from tests.tolerance import assert_close
from truing.inference.fit import FitState, fit_model
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
        )


def test_a_step_that_would_make_things_worse_is_halved() -> None:
    model = Saturating(TRUE + np.linspace(-0.02, 0.02, 9))
    truth = model.predict(np.array([TRUE / PRIOR]), np.zeros((9, 0))).values
    measured = Observations(truth, np.full((9, 1, 1, 1), 1e-10), np.ones((9, 1), bool))
    fit = fit_model(model.predict, measured, Frames.of_numbers(9), np.array([0.0]), np.zeros((9, 0)))
    assert fit.state == FitState.SETTLED
    assert_close(PRIOR * fit.shared, [TRUE], atol=1e-6)
