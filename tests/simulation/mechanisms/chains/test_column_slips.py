"""A wrong zero is no slip of a column: whichever of the two explains more is told."""

from __future__ import annotations

import numpy as np
import pytest

from truing.arrays import Array, Mask
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


@pytest.mark.parametrize(
    ("recorded", "kind"),
    [
        (TRUE - [0.0, np.pi / 2], ColumnSlipKind.ZEROS),
        (TRUE * [1.0, -1.0], ColumnSlipKind.REVERSED),
    ],
)
def test_a_zero_off_by_a_right_angle_and_a_reversed_column_are_told_apart(
    recorded: Array, kind: ColumnSlipKind
) -> None:
    """Of a joint that hardly moves a reversed column explains either to within a few per cent."""
    nothing = np.zeros(COUNT, int)
    reference = np.tile(np.eye(3), (COUNT, 1, 1, 1))
    conditions = ChainConditions(recorded, {}, tuple(range(COUNT)), nothing, reference, np.zeros(COUNT))
    found = likely_slip(conditions, np.ones(2, bool), start_of)
    assert found is not None
    assert (found.kind, found.readings) == (kind, (1,))
    assert found.after < 1e-3 < 0.01 * found.before
