"""What an effect follows: displacements of actuators where there are legs, columns of that name where there are not."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from tests.tolerance import assert_close
from truing.simulation.causes.following import Following

DRIVE = Following(columns=("rho2_mm",), centres=(10.0,), half_ranges=(2.0,))


def state(readings, covariates):
    """Readings (B, L) in m, references of 10 mm, and columns by name."""
    legs = SimpleNamespace(rho0=np.full(readings.shape[1], 0.01))
    return SimpleNamespace(indicated=readings, legs=legs, covariates=covariates)


def test_a_drive_of_legs_is_their_displacement():
    readings = 0.01 + np.outer([0.0, 1.0, -1.0], [1.0, 2.0, 3.0])
    followed = Following(columns=("rho2_mm",), centres=(0.0,), half_ranges=(2.0,))
    assert_close(followed.basis(state(readings, {}))[:, 0, 0], [0.0, 1.0, -1.0], atol=1e-12)


def test_bodies_without_legs_may_have_a_column_that_is_called_like_one():
    found = DRIVE.basis(state(np.zeros((3, 0)), {"rho2_mm": np.array([8.0, 10.0, 12.0])}))
    assert_close(found[:, 0, 0], [-1.0, 0.0, 1.0], atol=1e-12)
