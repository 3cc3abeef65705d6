"""Kelvin and degrees Fahrenheit in the place of degrees Celsius are told where a reference contradicts them."""

from __future__ import annotations

import numpy as np
import pytest

from truing.estimation.suspect_units import likely_pressure_unit, mistaken_unit

WALK = np.linspace(-1.0, 1.5, 9)


@pytest.mark.parametrize(
    ("recorded", "reference", "unit", "of_reference", "certain", "celsius"),
    [
        (293.15 + WALK, 20.0, "K", False, True, 20.25),
        (20.0 + WALK, 293.15, "K", True, True, 20.0),
        (293.15 + WALK, 293.15, "K", True, False, 20.0),
        ([], 293.15, "K", True, False, 20.0),
        (68.0 + WALK, 20.0, "degF", False, True, 20.139),
        (20.0 + WALK, 68.0, "degF", True, True, 20.0),
        (77.15 + WALK, -190.0, "K", False, True, -195.75),
    ],
)
def test_a_mistaken_unit_is_told(recorded, reference, unit, of_reference, certain, celsius):
    found = mistaken_unit(recorded, reference)
    assert (found.unit, found.of_reference, found.certain) == (unit, of_reference, certain)
    assert abs(found.celsius - celsius) < 0.01


def test_single_rows_in_kelvin_are_counted():
    assert mistaken_unit([20.1, 293.2, np.nan, 20.3, 293.4], 20.0).rows == 2


@pytest.mark.parametrize(
    ("recorded", "reference"),
    [
        (20.0 + WALK, 20.0),
        (np.linspace(-190.0, 20.0, 9), 20.0),
        (np.linspace(20.0, 80.0, 9), 20.0),
        (np.linspace(20.0, 300.0, 15), 20.0),
        ([np.nan, np.nan], 20.0),
        (-40.0 + WALK, 20.0),
    ],
)
def test_temperatures_in_degrees_celsius_pass(recorded, reference):
    assert mistaken_unit(recorded, reference) is None


@pytest.mark.parametrize(
    ("value", "told"),
    [
        (1013.0, ""),
        (835.0, ""),
        (101325.0, "1013.2 hPa, in Pa 101325"),
        (101.3, "1013 hPa, in kPa 101.3"),
        (760.0, "1013.3 hPa, in mmHg 760"),
        (29.92, "1013.2 hPa, in inHg 29.92"),
        (1.0, "1000 hPa, in bar 1"),
        (3.0, ""),
    ],
)
def test_a_pressure_tells_its_unit(value, told):
    assert likely_pressure_unit(value) == told
