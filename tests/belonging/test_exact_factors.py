"""Units near one are recognised where a whole group of responses has exactly their factor. Rows of combined loads."""

from __future__ import annotations

import numpy as np
import pytest

from truing.belonging.exact_factors import MainRatios, exact_factor
from truing.belonging.plausible_slips import RecordedColumn
from truing.belonging.relation import DISPLACEMENT_UNITS, ROTATION_UNITS, SlipKind
from truing.belonging.row_order import order_of_all_rows

COLUMNS = [
    *(RecordedColumn(name, "displacement", DISPLACEMENT_UNITS) for name in ("dx", "dy", "dz")),
    *(RecordedColumn(name, "rotation", ROTATION_UNITS) for name in ("rx", "ry", "rz")),
]
EVERY = np.arange(6)


def ratios(factors: np.ndarray, seed: int, scatter: float = 0.02) -> MainRatios:
    """Ratios of six channels, each loaded along its own axis, with stiffnesses off by a few per cent."""
    noise = scatter * np.random.default_rng(seed).normal(size=6)
    found = MainRatios.of_responses(EVERY, np.eye(6), factors * np.exp(noise), np.ones(6))
    assert found is not None
    return found


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("factors", "quantity", "subjects", "factor"),
    [
        (np.where(EVERY >= 3, 1.3558179483314, 1.0), "torque", (), 1.3558179483314),
        (np.where(EVERY < 3, 2.0, 1.0), "displacement", (), 0.5),
        (np.where(EVERY == 1, 0.5, 1.0), "displacement", ("dy",), 2.0),
    ],
)
def test_a_factor_of_a_whole_group_is_a_unit(
    factors: np.ndarray, quantity: str, subjects: tuple[str, ...], factor: float, seed: int
) -> None:
    found = exact_factor(ratios(factors, seed), COLUMNS)
    assert found is not None
    assert (found.slip.quantity, found.slip.subjects) == (quantity, subjects)
    assert found.slip.factor == pytest.approx(factor)
    assert found.after < 0.1 < found.before


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "factors",
    [
        np.ones(6),
        np.array([1.0, 1.0, 1.3558, 1.0, 1.0, 1.0]),  # one axis: a stiffness
        np.array([1.0, 1.0, 1.0, 1.2, 1.5, 1.36]),  # torques that are off by factors of their own
        np.array([1.5, 0.7, 1.3, 1.36, 1.36, 1.36]),  # the others do not agree either
        np.full(6, 2.0),  # the whole machine
    ],
)
def test_stiffnesses_of_their_own_are_no_unit(factors: np.ndarray, seed: int) -> None:
    assert exact_factor(ratios(factors, seed), COLUMNS) is None


def test_no_ratio_has_another_sign_or_several_axes() -> None:
    size = np.where(EVERY == 2, -1.0, 1.0)
    assert MainRatios.of_responses(EVERY, np.eye(6), size, np.ones(6)) is None
    assert MainRatios.of_responses(EVERY, np.eye(6) + np.eye(6, k=1), np.ones(6), np.ones(6)) is None


def combined(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Loads (N, 6) along all axes at once, runs, and six columns that follow them with a zero of each run."""
    rng = np.random.default_rng(seed)
    run = np.repeat(np.arange(5), 14)
    load = rng.uniform(-900.0, 900.0, (len(run), 6))
    value = load @ rng.normal(size=(6, 6)) + 50.0 * rng.normal(size=(5, 6))[run]
    value += 0.01 * np.abs(load) @ rng.normal(size=(6, 6)) + rng.normal(size=value.shape)
    return load, run, value


@pytest.mark.parametrize("shift", [1, -1, 2])
def test_rows_of_combined_loads_are_found_shifted(shift: int) -> None:
    load, run, value = combined(shift + 5)
    assert order_of_all_rows(load, run, value, "signals") is None
    found = order_of_all_rows(load, run, np.roll(value, shift, axis=0), "signals")
    assert found is not None
    assert (found.slip.kind, found.slip.shift) == (SlipKind.ROWS_SHIFTED, shift)


def test_reversed_rows_and_missing_readings_of_combined_loads() -> None:
    load, run, value = combined(3)
    value[::7, 2] = np.nan
    value[:20, 4] = np.nan
    turned = np.concatenate([value[run == number][::-1] for number in range(5)])
    assert order_of_all_rows(load, run, value, "readings") is None
    found = order_of_all_rows(load, run, turned, "readings")
    assert found is not None
    assert found.slip.kind is SlipKind.REVERSED


def test_rows_of_other_loads_are_in_no_order() -> None:
    load, run, value = combined(4)
    value = value[np.random.default_rng(1).permutation(len(value))]
    assert order_of_all_rows(load, run, value, "signals") is None
