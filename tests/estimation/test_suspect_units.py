"""Temperatures in another unit than their column says: whole columns, and single rows among others."""

from __future__ import annotations

import numpy as np
import pytest

from truing.estimation.suspect_units import likely_pressure_unit, mistaken_rows, mistaken_unit

WALK = np.linspace(-1.0, 1.5, 9)
FROM_CELSIUS = {"degF": lambda c: 1.8 * c + 32.0, "K": lambda c: c + 273.15}


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
def test_a_mistaken_unit_is_reported(recorded, reference, unit, of_reference, certain, celsius):
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
    ("value", "expected"),
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
def test_a_pressure_gives_its_unit(value, expected):
    assert likely_pressure_unit(value) == expected


def good_column(rng: np.random.Generator) -> np.ndarray:
    """A column as laboratories have it: drift, true steps, day and night, a heating, alone or added."""
    n = int(rng.integers(8, 120))
    at = np.linspace(0.0, 1.0, n)
    value = rng.uniform(15.0, 25.0) + np.cumsum(rng.normal(0.0, rng.choice([0.01, 0.05, 0.2]), n))
    value += rng.uniform(-5.0, 5.0) * at * rng.integers(0, 2)
    value += rng.integers(0, 2) * rng.uniform(1.0, 3.0) * np.sin(2.0 * np.pi * rng.uniform(1.0, 4.0) * at)
    for _ in range(rng.integers(0, 3)):
        value += rng.uniform(-6.0, 6.0) * (at > rng.uniform())
    if rng.integers(0, 2):
        value += rng.choice([10.0, 20.0, 24.0]) * (np.abs(at - rng.uniform(0.2, 0.8)) < rng.uniform(0.05, 0.3))
    return np.round(rng.permutation(value) if rng.integers(0, 4) == 0 else value, int(rng.integers(0, 4)))


def test_two_hundred_good_columns_pass():
    rng = np.random.default_rng(41)
    assert not [k for k in range(200) if mistaken_rows(good_column(rng)) is not None]


@pytest.mark.parametrize("unit", ["degF", "K"])
@pytest.mark.parametrize("part", ["half", "stretch", "alternate", "single", "most"])
def test_a_part_in_another_unit_is_reported_with_its_rows(unit, part):
    rng = np.random.default_rng(5)
    n = 40
    value = 20.0 + np.cumsum(rng.normal(0.0, 0.05, n)) + 2.0 * (np.arange(n) > 30)
    wrong = {
        "half": np.arange(n // 2, n),
        "stretch": np.arange(10, 18),
        "alternate": np.arange(0, n, 2),
        "single": np.array([7]),
        "most": np.arange(4, n),
    }[part]
    mixed = value.copy()
    mixed[wrong] = np.round(FROM_CELSIUS[unit](value[wrong]), 1)
    found = mistaken_rows(mixed)
    assert found is not None
    assert found.unit == unit
    assert found.rows.tolist() == wrong.tolist()
    assert abs(found.celsius - np.median(value[wrong])) < 0.05


def test_rows_are_assessed_in_the_order_in_which_they_were_taken():
    rng = np.random.default_rng(6)
    warmed = 18.0 + 8.0 * np.arange(60) / 60.0 + rng.normal(0.0, 0.02, 60)
    warmed[30:] = FROM_CELSIUS["degF"](warmed[30:])
    shuffled = rng.permutation(60)
    taken = np.argsort(shuffled)
    found = mistaken_rows(warmed[shuffled], taken)
    assert found is not None
    assert sorted(shuffled[found.rows]) == list(range(30, 60))


@pytest.mark.parametrize("to", [45.0, 60.0, 80.0, 120.0, 300.0])
def test_a_true_heating_that_no_conversion_undoes_passes(to):
    rng = np.random.default_rng(8)
    value = np.where(np.arange(40) % 20 < 10, 20.0, to) + rng.normal(0.0, 0.1, 40)
    assert mistaken_rows(value) is None
