"""Slips of the hand in the rows of single axes, made in the files of drawn campaigns; shares no code with truing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd

Change = Callable[[pd.DataFrame, np.random.Generator], None]


@dataclass(frozen=True)
class AxisSlip:
    """A slip with its change of the table, the columns concerned, and words that its message should hold."""

    name: str
    change: Change
    columns: tuple[str, ...]
    words: tuple[str, ...]


def _scaled(column: str, factor: float) -> Change:
    def change(table: pd.DataFrame, rng: np.random.Generator) -> None:
        table[column] = np.round(table[column] * factor, 9)

    return change


def _exchanged(first: str, other: str) -> Change:
    def change(table: pd.DataFrame, rng: np.random.Generator) -> None:
        table[[first, other]] = table[[other, first]].to_numpy()

    return change


def _rolled(column: str, rows: int) -> Change:
    def change(table: pd.DataFrame, rng: np.random.Generator) -> None:
        table[column] = np.roll(table[column].to_numpy(), rows)

    return change


def _way_back_reversed(column: str, command: str) -> Change:
    """The readings of every second sweep typed in the order of the first: from the lowest command to the highest."""

    def change(table: pd.DataFrame, rng: np.random.Generator) -> None:
        values, sent = table[column].to_numpy().copy(), table[command].to_numpy()
        ends = [0, *(np.flatnonzero(np.diff(np.sign(np.diff(sent))) != 0) + 1).tolist(), len(sent)]
        for first, last in zip(ends[1::2], ends[2::2], strict=False):
            values[first:last] = values[first:last][::-1]
        table[column] = values

    return change


def _deviation(column: str, command: str, factor: float) -> Change:
    def change(table: pd.DataFrame, rng: np.random.Generator) -> None:
        difference = table[column] - table[command]
        table[column] = np.round(factor * (difference - difference.mean()), 6)

    return change


def slips(unit: str, channels: tuple[str, ...], loop: str) -> list[AxisSlip]:
    """Slips that a table with these encoders can have."""
    command = f"command_{unit}"
    factors = (
        {"radians": np.pi / 180.0, "turns": 1 / 360.0, "gon": 1 / 0.9, "arc seconds": 3600.0, "arc minutes": 60.0}
        if unit == "deg"
        else {"metres": 1e-3, "inches": 1 / 25.4, "micrometres": 1e3, "centimetres": 0.1}
    )
    found: list[AxisSlip] = []
    for name in ("command", *channels):
        column = f"{name}_{unit}"
        found += [
            AxisSlip(f"{name} in {word}", _scaled(column, factor), (name,), (word,)) for word, factor in factors.items()
        ]
        found.append(AxisSlip(f"{name} with the opposite sign", _scaled(column, -1.0), (name,), ("opposite sign",)))
    for name in channels:
        column = f"{name}_{unit}"
        found.append(AxisSlip(f"{name} and command exchanged", _exchanged(column, command), (name,), ("exchanged",)))
        for rows in (1, -2):
            found.append(AxisSlip(f"{name} shifted by {rows}", _rolled(column, rows), (name,), ("shifted",)))
        found.append(AxisSlip(f"{name}: way back reversed", _way_back_reversed(column, command), (name,), ("order",)))
        if name != loop:
            found.append(
                AxisSlip(f"{name} holds deviations", _deviation(column, command, 1.0), (name,), ("deviation",))
            )
    for k, first in enumerate(channels):
        for other in channels[k + 1 :]:
            change = _exchanged(f"{first}_{unit}", f"{other}_{unit}")
            found.append(AxisSlip(f"{first} and {other} exchanged", change, (first, other), ("exchanged",)))
    return found
