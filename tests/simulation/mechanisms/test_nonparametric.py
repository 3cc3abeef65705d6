"""Inputs of nonparametric effects: displacements of actuators where there are legs, else columns of that name."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from tests.tolerance import assert_close
from truing.simulation.mechanisms.causes.nonparametric import NonparametricMechanismEffect

DRIVE = NonparametricMechanismEffect(columns=("rho2_mm",), centres=(10.0,), half_ranges=(2.0,))


def state(readings, covariates):
    """Readings (B, L) in m, references of 10 mm, and columns by name."""
    legs = SimpleNamespace(rho0=np.full(readings.shape[1], 0.01))
    return SimpleNamespace(indicated=readings, legs=legs, covariates=covariates)


def test_a_drive_of_legs_is_their_displacement():
    readings = 0.01 + np.outer([0.0, 1.0, -1.0], [1.0, 2.0, 3.0])
    followed = NonparametricMechanismEffect(columns=("rho2_mm",), centres=(0.0,), half_ranges=(2.0,))
    assert_close(followed.functions(state(readings, {}))[:, 0, 0], [0.0, 1.0, -1.0], atol=1e-12)


def test_bodies_without_legs_may_have_a_column_that_is_called_like_one():
    found = DRIVE.functions(state(np.zeros((3, 0)), {"rho2_mm": np.array([8.0, 10.0, 12.0])}))
    assert_close(found[:, 0, 0], [-1.0, 0.0, 1.0], atol=1e-12)
