"""The rows of an axis: commands, how they were approached, events; and which encoders recorded where it stood."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Mask
from truing.simulation.inputs import ORDER, TIME

MOTOR, LOAD, MEASURED = "motor", "load", "measured"
ENCODERS = (MOTOR, LOAD, MEASURED)
# What is at fault between or in the encoders: the transmission, or one of them.
TRANSMISSION = "axis"
COMMAND, DIRECTION, SINCE_TURN = "command", "direction of approach", "travel since the turn"
ROTARY, LINEAR = "rotary", "linear"


@dataclass(frozen=True)
class Axis:
    """An axis: rotary or linear, the encoders (K) that were recorded, the one that the controller holds to the command.

    The loop may be closed on an encoder that was not recorded. Movements up to ``least_move`` (rad, m) turn no
    direction of approach; ``spread`` (rad, m) is how far readings lie from their middle: errors of that size are
    plausible. ``noise`` (rad, m) is one standard deviation of a reading less its command.
    """

    kind: str
    encoders: tuple[str, ...]
    loop: str = MOTOR
    least_move: float = 0.0
    spread: float = 0.0
    noise: float = 0.0

    def response(self, element: str) -> NDArray:
        """Return by how much each encoder (K,) reads more where an element adds one unit, the loop being closed.

        The transmission adds to where the load stands, behind the motor; an encoder adds to its own reading. The
        controller moves the axis until the encoder of its loop reads the command again.
        """
        added = {name: float(name == element) for name in ENCODERS}
        if element == TRANSMISSION:
            added |= {LOAD: 1.0, MEASURED: 1.0}
        return np.array([added[name] - added[self.loop] for name in self.encoders])


@dataclass(frozen=True)
class AxisRows:
    """B rows in the order of the table: names, time (s), command and direction of approach (B,), events (B,) as text.

    Commands are in rad or m. ``order`` is the rank in time over the whole campaign, ``direction`` -1 or 1. ``events``
    are the campaign's: (name, time of the first row after it). ``since_turn`` (B,) is how far the axis came since it
    last turned round, rad or m. ``others`` (B,) are all further columns.
    """

    poses: tuple[int | str, ...]
    time_s: NDArray
    command: NDArray
    direction: NDArray
    since_turn: NDArray
    order: NDArray
    events: tuple[tuple[str, float], ...] = ()
    others: Mapping[str, NDArray] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        poses: Sequence[int | str],
        time_s: NDArray,
        command: NDArray,
        least_move: float,
        events: tuple[tuple[str, float], ...] = (),
        others: Mapping[str, NDArray] | None = None,
    ) -> AxisRows:
        """Return rows with what follows from their order in time; least_move as in `Axis`."""
        order = np.argsort(np.argsort(time_s, kind="stable")).astype(float)
        direction, since_turn = approaches(command, order, least_move)
        return cls(tuple(poses), time_s, command, direction, since_turn, order, events, others or {})

    @property
    def covariates(self) -> dict[str, NDArray]:
        """Return the columns (B,) that something may follow."""
        known = {name: values for name, values in self.others.items() if np.isfinite(values).all()}
        return {**known, TIME: self.time_s, ORDER: self.order, COMMAND: self.command, DIRECTION: self.direction}

    @property
    def readings(self) -> NDArray:
        """Return what predictions are made from: the commands (B, 1)."""
        return self.command[:, None]

    def chosen(self, rows: Mask) -> AxisRows:
        """Return some of the rows."""
        return AxisRows(
            tuple(pose for pose, own in zip(self.poses, rows, strict=True) if own),
            self.time_s[rows],
            self.command[rows],
            self.direction[rows],
            self.since_turn[rows],
            self.order[rows],
            self.events,
            {name: values[rows] for name, values in self.others.items()},
        )


def approaches(command: NDArray, order: NDArray, least: float) -> tuple[NDArray, NDArray]:
    """Return of rows (N,) the direction of approach, -1 or 1, and how far the axis came since it last turned round.

    The direction is that of the last movement larger than ``least`` in the order of time; 1 before any. Rows without a
    command are as the row before.
    """
    direction, travel = np.ones(len(command)), np.zeros(len(command))
    way, current, turn = 1.0, np.nan, np.nan
    for row in np.argsort(order, kind="stable"):
        step = command[row] - current
        if np.isfinite(step) and abs(step) > least:
            if np.sign(step) != way:
                turn = current
            way = float(np.sign(step))
        if np.isfinite(command[row]) and not abs(step) <= least:
            current = command[row]
            turn = turn if np.isfinite(turn) else current
        direction[row], travel[row] = way, abs(np.nan_to_num(current - turn))
    return direction, travel
