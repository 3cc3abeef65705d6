"""Legs of a fitted cause: those without effect are dropped."""

from __future__ import annotations

import numpy as np
import pytest

from truing.simulation.mechanisms.causes.deformation import NonlinearPlatformDeformation
from truing.simulation.mechanisms.causes.drive import ActuatorGain, PeriodicError


def narrowed(legs: tuple[int, ...], gains: list[float], sigma: float) -> tuple[int, ...]:
    own = ActuatorGain(legs)
    return own.narrowed(np.array(gains), np.eye(len(gains)) * sigma**2, 6).legs  # type: ignore[attr-defined]


@pytest.mark.parametrize("found", [(3, 4), (1, 3, 6), ()])
def test_legs_that_do_nothing_next_to_a_large_effect_are_left_out(found: tuple[int, ...]) -> None:
    gains = [0.2 if leg == 3 else 4e-4 for leg in found or range(1, 7)]
    assert narrowed(found, gains, 7e-4) == (3,)


def test_legs_that_err_alike_are_kept_however_surely_they_are_known() -> None:
    assert narrowed((), [0.2, 0.17, 0.21, 0.2, 0.19, 0.22], 1e-5) == ()
    assert narrowed((2, 5), [0.2, 0.01], 7e-4) == (2, 5)


def test_a_leg_that_small_effects_leave_open_is_kept() -> None:
    assert narrowed((2, 5), [0.006, 0.001], 1e-3) == (2, 5)


def test_a_leg_takes_part_if_any_of_its_parameters_is_significant() -> None:
    """A leg whose kappa is nothing takes part by its square; a sine that is nothing, by its cosine."""
    nonlinear = NonlinearPlatformDeformation((1, 2))
    names = [parameter.name for parameter in nonlinear.parameters(6)]
    scale = np.array([parameter.scale for parameter in nonlinear.parameters(6)])
    values = np.array([0.0 if name == "kappa_2" else 5.0 for name in names]) * scale
    assert nonlinear.narrowed(values, np.diag(1e-4 * scale**2), 6) == nonlinear
    none = np.array([0.0 if name.endswith("_2") else 5.0 for name in names]) * scale
    assert nonlinear.narrowed(none, np.diag(1e-4 * scale**2), 6).subject == "leg1"
    periodic = PeriodicError((4,))
    count = len(periodic.parameters(6))
    assert periodic.narrowed(np.full(count, 1e-5), np.eye(count) * 1e-14, 6) == periodic
