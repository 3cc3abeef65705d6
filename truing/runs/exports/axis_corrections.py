"""Export of corrections of an axis for its controller: a table over the command, for either direction of approach."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from truing.runs.exports.csv_text import csv_bytes
from truing.simulation.axis.extended_model import ExtendedAxis, depends_on_path, positioning_errors
from truing.simulation.axis.rows import LOAD, MEASURED, ROTARY, AxisRows

_MOST_TARGETS, _EVEN = 500, 101  # with more commands, so many are spread evenly over the travel
_UNITS = {True: ("deg", np.pi / 180.0, "arcsec", np.pi / 648000.0), False: ("mm", 1e-3, "um", 1e-6)}
_APART_S = 100.0  # at rest
_CLEAR_MOVES = 2.0  # times the least movement that changes the direction of approach


def axis_corrections(model: ExtendedAxis, run: Mapping[str, pd.DataFrame], caution: str) -> Iterator[tuple[str, bytes]]:
    """Yield ``axis_corrections.csv``: what to add to each command so that the axis stands where it was sent.

    Corrections are those of the outside instrument, without one of the encoder at the load outside the loop; nothing is
    yielded without either. They are zero at the command nearest to zero, approached from below, because a constant
    has no meaning. ``caution`` is a reason code for all of them, or empty.
    """
    observed = [name for name in (MEASURED, LOAD) if name in model.axis.encoders and name != model.axis.loop]
    if not observed or "axis_errors" not in run or not any(depends_on_path(effect) for effect in model.effects):
        return
    per_command, command_si, unit, si = _UNITS[model.axis.kind == ROTARY]
    commands = _commands(run["axis_errors"]["command"].to_numpy(float) * command_si, model.axis.least_move)
    rows, count = _from_both_sides(commands, model.axis.least_move), len(commands)
    upwards, downwards = np.arange(1, 1 + count), np.arange(2 * count + 1, count + 1, -1)
    origin = int(upwards[np.argmin(np.abs(commands))])
    errors, sigmas = positioning_errors(model, rows, origin)
    encoder = model.axis.encoders.index(observed[0])
    table = [
        [f"command_{per_command}"]
        + [f"{what}_{unit}" for side in ("from_below", "from_above") for what in (side, f"sigma_{side}")]
        + ["caution"]
    ]
    for command, up, down in zip(commands, upwards, downwards, strict=True):
        sizes = [size for row in (up, down) for size in (-errors[row, encoder] / si, sigmas[row, encoder] / si)]
        table.append([f"{command / command_si:.9g}", *(f"{round(size, 6) + 0.0:.6g}" for size in sizes), caution])
    yield "axis_corrections.csv", csv_bytes(table)


def _commands(command: NDArray, least_move: float) -> NDArray:
    """Return the targets, ascending; values spread evenly over the travel where a recording has more of them."""
    targets = np.unique(command[np.isfinite(command)].round(12))
    travel = float(np.ptp(targets))
    is_dense = len(targets) > 1 and np.diff(targets).min() <= _CLEAR_MOVES * least_move
    if len(targets) <= _MOST_TARGETS and not is_dense:
        return targets
    steps = min(_EVEN - 1, int(travel / (_CLEAR_MOVES * least_move))) if least_move > 0.0 else _EVEN - 1
    return np.linspace(targets[0], targets[-1], max(steps, 1) + 1)


def _from_both_sides(commands: NDArray, least_move: float) -> AxisRows:
    """Return rows up and down through all commands, each pass begun outside of the travel."""
    step = max(float(np.diff(commands).max(initial=0.0)), _CLEAR_MOVES * least_move)
    path = np.concatenate([[commands[0] - step], commands, [commands[-1] + step], commands[::-1]])
    return AxisRows.of(tuple(range(len(path))), _APART_S * np.arange(len(path)), path, least_move)
