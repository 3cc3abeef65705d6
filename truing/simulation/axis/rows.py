"""Data of an axis: `Axis` with its encoders and control loop, and `AxisRows` with commands, approaches and events."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Mask
from truing.estimation.interferometry.iso230 import is_in_motion
from truing.simulation.inputs import ORDER, TIME, histories, is_row_number, rates

MOTOR, LOAD, MEASURED = "motor", "load", "measured"
ENCODERS = (MOTOR, LOAD, MEASURED)
# Element that may have an error besides the encoders: the transmission between them.
TRANSMISSION = "axis"
COMMAND, DIRECTION, SINCE_TURN = "command", "direction of approach", "travel since the turn"
ROTARY, LINEAR = "rotary", "linear"
_AHEAD = 0.5  # of the smallest step between commands: start of a movement that no row shows
_KNOWN = 0.8  # share of the rows of a recording in motion whose rates have to be known


@dataclass(frozen=True)
class Axis:
    """An axis: rotary or linear, K recorded encoders, and the encoder of the position loop.

    The loop may be closed on an encoder that was not recorded. Movements up to ``least_move`` (rad, m) do not change
    the direction of approach; ``spread`` (rad, m) is the spread of the readings about their centre: errors of that size
    are plausible. ``noise`` (rad, m) is one standard deviation of a reading minus its command.
    ``period`` (rad, m) is the declared period of a periodic error.
    """

    kind: str
    encoders: tuple[str, ...]
    loop: str = MOTOR
    least_move: float = 0.0
    spread: float = 0.0
    noise: float = 0.0
    period: float | None = None

    def response(self, element: str) -> NDArray:
        """Return the change of each encoder's reading (K,) if an element adds one unit, with the loop closed.

        The transmission adds to the position of the load, behind the motor; an encoder adds to its own reading. The
        controller moves the axis until the encoder of its loop reads the command again.
        """
        return self._responses[element]

    @cached_property
    def _responses(self) -> dict[str, NDArray]:
        moved = {TRANSMISSION: (LOAD, MEASURED)} | {name: (name,) for name in ENCODERS}
        return {
            element: np.array([float(name in affected) - float(self.loop in affected) for name in self.encoders])
            for element, affected in moved.items()
        }


@dataclass(frozen=True)
class AxisRows:
    """B rows in the order of the table: names, time (s), command (rad or m) and direction of approach (B,).

    ``order`` is the rank in time over the whole campaign, ``direction`` -1 or 1, in motion that of the rate. ``events``
    are the campaign's: (name, time of the first row after it). ``since_turn`` (B,) is the travel since the last
    reversal, ``travelled`` (B,) the path since the first row, rad or m. ``stops`` (B, 3) are states of stop operators.
    ``rate`` (B,) is that of the command, per s, 0 at rest and where unknown. ``others`` (B,) are all other columns.
    ``is_timed``: False if times number the rows, as where none were recorded; then the order alone is known.
    """

    poses: tuple[int | str, ...]
    time_s: NDArray
    command: NDArray
    direction: NDArray
    since_turn: NDArray
    travelled: NDArray
    order: NDArray
    stops: NDArray
    rate: NDArray
    events: tuple[tuple[str, float], ...] = ()
    others: Mapping[str, NDArray] = field(default_factory=dict)
    is_timed: bool = True

    @classmethod
    def of(
        cls,
        poses: Sequence[int | str],
        time_s: NDArray,
        command: NDArray,
        least_move: float,
        events: tuple[tuple[str, float], ...] = (),
        others: Mapping[str, NDArray] | None = None,
        recorded: NDArray | None = None,
    ) -> AxisRows:
        """Return rows with the quantities that follow from their order in time; least_move as in `Axis`.

        recorded (B,): direction of approach as written down, -1 or 1, else unknown; it has precedence over the order.
        """
        order = np.argsort(np.argsort(time_s, kind="stable")).astype(float)
        moves = _Movements.of(command, order, least_move, recorded)
        direction, since_turn = (each[moves.own] for each in approaches(moves.command, moves.order, least_move))
        path = path_travelled(moves.command, moves.order)[moves.own]
        stops = histories(moves.command[:, None], moves.order)[moves.own, 0]
        rate = _rate(command, time_s, order)
        direction = np.where(rate == 0.0, direction, np.sign(rate))
        known, timed = others or {}, not is_row_number(time_s)
        return cls(tuple(poses), time_s, command, direction, since_turn, path, order, stops, rate, events, known, timed)

    @cached_property
    def waves(self) -> dict[float, NDArray]:
        """Sine and cosine (B, 2) of the commands by their period, rad or m, as far as they were needed."""
        return {}

    @property
    def covariates(self) -> dict[str, NDArray]:
        """Columns (B,) that effects may depend on."""
        known = {name: values for name, values in self.others.items() if np.isfinite(values).all()}
        timed = {TIME: self.time_s} if self.is_timed else {}
        return {**known, **timed, ORDER: self.order, COMMAND: self.command, DIRECTION: self.direction}

    @property
    def readings(self) -> NDArray:
        """Inputs of predictions: the commands (B, 1)."""
        return self.command[:, None]

    def subset(self, rows: Mask) -> AxisRows:
        """Return some of the rows."""
        return AxisRows(
            tuple(pose for pose, is_used in zip(self.poses, rows, strict=True) if is_used),
            self.time_s[rows],
            self.command[rows],
            self.direction[rows],
            self.since_turn[rows],
            self.travelled[rows],
            self.order[rows],
            self.stops[rows],
            self.rate[rows],
            self.events,
            {name: values[rows] for name, values in self.others.items()},
            self.is_timed,
        )


@dataclass(frozen=True)
class _Movements:
    """Commands (M,), rad or m, and their order (M,): B rows at ``own`` (B,), and starts of movements that no row shows.

    A recorded direction may differ from that of the rows, as where a command is repeated at a reversal. The axis then
    went away and came back, so a start on that side is inserted before.
    """

    command: NDArray
    order: NDArray
    own: NDArray

    @classmethod
    def of(cls, command: NDArray, order: NDArray, least: float, recorded: NDArray | None) -> _Movements:
        rows = np.arange(len(command))
        if recorded is None or not (np.abs(recorded) == 1.0).any():
            return cls(command, order, rows)
        before = _rows_with_unseen_movement(command, order, least, recorded)
        starts = command[before] - recorded[before] * _start(command, least)
        return cls(np.append(command, starts), np.append(order, order[before] - 0.5), rows)


def _rows_with_unseen_movement(command: NDArray, order: NDArray, least: float, recorded: NDArray) -> NDArray:
    """Return the numbers of rows that were approached from another side than the rows before show."""
    found, sense, current = list[int](), 0.0, np.nan
    for row in np.argsort(order, kind="stable"):
        step = command[row] - current
        if abs(step) > least:
            sense = float(np.sign(step))
        if np.isfinite(command[row]) and not abs(step) <= least:
            current = command[row]
        if np.isfinite(command[row]) and abs(recorded[row]) == 1.0 and recorded[row] != sense:
            found.append(int(row))
            sense = float(recorded[row])
    return np.array(found, int)


def _start(command: NDArray, least: float) -> float:
    """Return the distance, rad or m, between a command and the start of a movement that no row shows."""
    steps = np.diff(np.unique(command[np.isfinite(command)]))
    steps = steps[steps > least]
    return max(_AHEAD * float(steps.min()) if len(steps) else 0.0, 2.0 * least, np.finfo(float).tiny)


def approaches(command: NDArray, order: NDArray, least: float) -> tuple[NDArray, NDArray]:
    """Return for rows (N,) the direction of approach, -1 or 1, and the travel since the last reversal.

    The direction is that of the last movement larger than ``least`` in order of time; 1 before any. Rows without a
    command keep the values of the row before.
    """
    direction, travel = np.ones(len(command)), np.zeros(len(command))
    sense, current, turn = 1.0, np.nan, np.nan
    for row in np.argsort(order, kind="stable"):
        step = command[row] - current
        if np.isfinite(step) and abs(step) > least:
            if np.sign(step) != sense:
                turn = current
            sense = float(np.sign(step))
        if np.isfinite(command[row]) and not abs(step) <= least:
            current = command[row]
            turn = turn if np.isfinite(turn) else current
        direction[row], travel[row] = sense, abs(np.nan_to_num(current - turn))
    return direction, travel


def _rate(command: NDArray, time_s: NDArray, order: NDArray) -> NDArray:
    """Return the rate (N,) of the command of an axis recorded in motion, per s; 0 at rest, and where most are unknown.

    Each way between two reversals has its own speed.
    """
    rate, in_time = np.zeros(len(command)), np.argsort(order, kind="stable")
    if not is_in_motion(command[in_time], time_s[in_time]):
        return rate
    sense = np.sign(np.diff(command[in_time]))
    begins = 2 + np.flatnonzero((np.diff(sense) != 0.0) & (sense[:-1] != 0.0))  # at a stop, the way that follows
    for part in np.split(in_time, begins):
        moving = rates(command[part, None], time_s[part])
        rate[part] = 0.0 if moving is None else moving[:, 0]
    return rate if np.mean(rate != 0.0) > _KNOWN else np.zeros(len(command))


def path_travelled(command: NDArray, order: NDArray) -> NDArray:
    """Return the path (N,) since the first row in order of time; rows without a command add nothing."""
    in_time, path = np.argsort(order, kind="stable"), np.zeros(len(command))
    known = in_time[np.isfinite(command[in_time])]
    path[known] = np.cumsum(np.abs(np.diff(command[known], prepend=command[known[:1]])))
    return path
