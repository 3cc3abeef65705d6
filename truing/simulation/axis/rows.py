"""The rows of an axis: commands, how they were approached, events; and which encoders recorded where it stood."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from truing.simulation.targets import Targets

MOTOR, LOAD, MEASURED = "motor", "load", "measured"
ENCODERS = (MOTOR, LOAD, MEASURED)
# What is at fault between or in the encoders: the transmission, or one of them.
TRANSMISSION = "axis"
ORDER, TIME, COMMAND, DIRECTION = "order", "time_s", "command", "direction of approach"
ROTARY, LINEAR = "rotary", "linear"
# Encoders are no base, platform or leg.
_NO_BODY, _NO_LEG = 3, -1


@dataclass(frozen=True)
class Axis:
    """An axis: rotary or linear, the encoders (K) that were recorded, the one that the controller holds to the command.

    The loop may be closed on an encoder that was not recorded. Movements up to ``least_move`` (rad, m) turn no
    direction of approach; ``spread`` (rad, m) is how far readings lie from their middle: errors of that size are
    plausible.
    """

    kind: str
    encoders: tuple[str, ...]
    loop: str = MOTOR
    least_move: float = 0.0
    spread: float = 0.0

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
    are the campaign's: (name, time of the first row after it). ``covariates`` (B,) are all further columns.
    """

    poses: tuple[int | str, ...]
    time_s: NDArray
    command: NDArray
    direction: NDArray
    order: NDArray
    events: tuple[tuple[str, float], ...] = ()
    covariates: Mapping[str, NDArray] = field(default_factory=dict)

    @property
    def readings(self) -> NDArray:
        """Return what predictions are made from: the commands (B, 1)."""
        return self.command[:, None]

    def chosen(self, rows: NDArray[np.bool_]) -> AxisRows:
        """Return some of the rows."""
        return AxisRows(
            tuple(pose for pose, own in zip(self.poses, rows, strict=True) if own),
            self.time_s[rows],
            self.command[rows],
            self.direction[rows],
            self.order[rows],
            self.events,
            {name: values[rows] for name, values in self.covariates.items()},
        )


@dataclass(frozen=True)
class AxisScene:
    """What the campaign of an axis offers to causes: its rows, encoders, and which readings (B, K) were recorded."""

    axis: Axis
    rows: AxisRows
    seen: NDArray | None = None
    word_of_target: str = "encoder"
    photographed: bool = False
    rays: None = None

    @property
    def covariates(self) -> Mapping[str, NDArray]:
        """Return the columns (B,) that noise may follow."""
        own = self.rows
        known = {name: values for name, values in own.covariates.items() if np.isfinite(values).all()}
        return {**known, TIME: own.time_s, ORDER: own.order, COMMAND: own.command, DIRECTION: own.direction}

    @property
    def shape(self) -> NDArray:
        """Return the places of the encoders: they have none."""
        return np.zeros((len(self.axis.encoders), 0))

    @property
    def recorded(self) -> NDArray:
        """Return which readings (B, K) were recorded: all, where that is not told."""
        shape = len(self.rows.poses), len(self.axis.encoders)
        return np.ones(shape, bool) if self.seen is None else self.seen


def encoder_targets(axis: Axis) -> Targets:
    """Return the encoders as what is measured."""
    count = len(axis.encoders)
    return Targets(np.full(count, _NO_BODY), np.full(count, _NO_LEG), axis.encoders, ("encoder",) * count)


def directions_of_approach(command: NDArray, order: NDArray, least: float) -> NDArray:
    """Return -1 or 1 (N,): the direction of the last movement larger than ``least`` in the order of time; 1 before any.

    Rows without a command keep the direction of the row before.
    """
    found, last, standing = np.ones(len(command)), 1.0, np.nan
    for row in np.argsort(order, kind="stable"):
        step = command[row] - standing
        if np.isfinite(step) and abs(step) > least:
            last = float(np.sign(step))
        if np.isfinite(command[row]) and not abs(step) <= least:
            standing = command[row]
        found[row] = last
    return found
