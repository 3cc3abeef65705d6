"""A wrong joint zero and a slip of a column are distinguished by what explains more."""

from __future__ import annotations

import numpy as np
import pytest

from truing.arrays import Array, Mask
from truing.belonging.joint_rows import column_slip
from truing.report.belonging import slip_words
from truing.simulation.mechanisms.chains.column_slips import ColumnSlipKind, likely_slip
from truing.simulation.mechanisms.chains.conditions import ChainConditions
from truing.simulation.mechanisms.chains.start_values import StartValues

COUNT = 30
RNG = np.random.default_rng(4)
# The second joint moves by a few degrees about 45 degrees only.
TRUE = np.column_stack([RNG.uniform(-1.5, 1.5, COUNT), np.pi / 4 + RNG.uniform(-0.05, 0.05, COUNT)])


def places(readings: Array) -> Array:
    """Tip (B, 1, 2), m, of an arm of two links in the plane."""
    first, both = readings[:, 0], readings.sum(1)
    return np.column_stack([np.cos(first) + np.cos(both), np.sin(first) + np.sin(both)])[:, None]


MEASURED = places(TRUE) + 1e-4 * RNG.normal(size=(COUNT, 1, 2))
SPREAD = float(np.std(MEASURED))


def start_of(chosen: Mask, given: ChainConditions) -> StartValues:
    errors = (MEASURED - places(given.readings))[chosen]
    return StartValues(
        np.eye(3)[None], np.zeros((1, 3)), np.zeros((1, 3)), np.eye(3)[None], float(np.std(errors)), SPREAD, errors
    )


def conditions_at(readings: Array) -> ChainConditions:
    reference = np.tile(np.eye(3), (COUNT, 1, 1, 1))
    none = np.zeros(COUNT, int)
    return ChainConditions(readings, {}, tuple(range(COUNT)), none, reference, np.zeros(COUNT))


@pytest.mark.parametrize(
    ("recorded", "kind"),
    [
        (TRUE - [0.0, np.pi / 2], ColumnSlipKind.ZEROS),
        (TRUE * [1.0, -1.0], ColumnSlipKind.REVERSED),
    ],
)
def test_a_zero_off_by_a_right_angle_and_a_reversed_column_are_distinguished(
    recorded: Array, kind: ColumnSlipKind
) -> None:
    """Of a joint that hardly moves a reversed column explains either to within a few per cent."""
    found = likely_slip(conditions_at(recorded), np.ones(2, bool), start_of)
    assert found is not None
    assert (found.kind, found.readings) == (kind, (1,))
    assert found.after < 1e-3 < 0.01 * found.before


@pytest.mark.parametrize(
    ("factor", "kind"),
    [
        (10.0 / 9.0, ColumnSlipKind.GON),
        (180.0 / np.pi, ColumnSlipKind.DEGREES),
        (np.pi / 180.0, ColumnSlipKind.RADIANS),
    ],
)
@pytest.mark.parametrize("columns", [(0,), (0, 1)])
def test_angles_in_another_unit_are_named(factor: float, kind: ColumnSlipKind, columns: tuple[int, ...]) -> None:
    recorded = TRUE.copy()
    recorded[:, columns] *= factor
    found = likely_slip(conditions_at(recorded), np.ones(2, bool), start_of)
    assert found is not None
    assert (found.kind, found.readings) == (kind, columns)
    assert "gon in place of degrees" in slip_words(column_slip(ColumnSlipKind.GON, ["j1_deg"]))


LINKS = np.array([0.9, 0.7, 0.4])
TURNS = np.random.default_rng(5).uniform(-1.0, 1.0, (COUNT, 3))


def wire(readings: Array) -> Array:
    """Lengths (B, 1, 1), m, of a wire from a post to the tip of an arm of three links in the plane."""
    ways = np.cumsum(readings, 1)
    tip = np.stack([np.cos(ways) @ LINKS, np.sin(ways) @ LINKS], -1)
    return np.linalg.norm(tip - [0.3, -1.1], axis=1)[:, None, None]


@pytest.mark.parametrize(
    "offset", [(0.0, np.pi / 2, 0.0), (0.0, -np.pi / 2, 0.0), (0.0, np.pi, 0.0), (0.0, np.pi / 2, -np.pi / 2)]
)
def test_zeros_off_by_right_angles_are_named_from_the_length_of_one_wire(offset: tuple[float, ...]) -> None:
    """A search from zero ends at other zeros, which explain nothing."""
    measured = wire(TURNS) + 1e-4 * np.random.default_rng(6).normal(size=(COUNT, 1, 1))
    spread, eye = float(np.std(measured)), np.eye(3)[None]

    def start(chosen: Mask, given: ChainConditions) -> StartValues:
        errors = (measured - wire(given.readings))[chosen]
        return StartValues(eye, np.zeros((1, 3)), np.zeros((1, 3)), eye, float(np.std(errors)), spread, errors)

    found = likely_slip(conditions_at(TURNS - np.array(offset)), np.ones(3, bool), start)
    assert found is not None
    assert found.kind is ColumnSlipKind.ZEROS
    own = dict(zip(found.readings, found.offsets, strict=True))
    assert own == pytest.approx({k: offset[k] for k in np.flatnonzero(offset)}, abs=1e-3)


@pytest.mark.parametrize(
    ("sign", "kind"), [(1.0, ColumnSlipKind.SUBTRACTED), (-1.0, ColumnSlipKind.ADDED)], ids=["sum", "difference"]
)
def test_a_joint_that_counts_from_a_fixed_direction_is_named(sign: float, kind: ColumnSlipKind) -> None:
    turns = np.random.default_rng(6).uniform(-1.0, 1.0, (COUNT, 2))
    measured = places(turns)

    def start(chosen: Mask, given: ChainConditions) -> StartValues:
        errors = (measured - places(given.readings))[chosen]
        places_of_frames = np.eye(3)[None], np.zeros((1, 3)), np.zeros((1, 3)), np.eye(3)[None]
        return StartValues(*places_of_frames, float(np.std(errors)), float(np.std(measured)), errors)

    recorded = turns + sign * turns[:, [0]] * [0.0, 1.0]
    found = likely_slip(conditions_at(recorded), np.ones(2, bool), start)
    assert found is not None
    assert (found.kind, found.readings) == (kind, (0, 1))
    assert found.after < 1e-9
