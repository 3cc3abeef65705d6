"""Proposals for tables of loads: applied or shown by the sensor, load steps or samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from truing.arrays import Array
from truing.formats.guess import Guess, MappingKeys, OtherWay
from truing.formats.named_loads import LoadMapping
from truing.formats.raw_tables import WRENCH

_SAMPLES = 10  # rows per load from which on they are probably samples of one load step


def proposal_of_loads(loads: LoadMapping, names: tuple[str, ...], mapping: MappingKeys, meant: MappingKeys) -> Guess:
    """Return a proposal for a table of loads, ordered by a column that seems to be time, if any."""
    time = {key: name for key, name in meant.get("columns", {}).items() if key == "time_s"}
    keys = {**loads.mapping, "columns": {**time, **loads.mapping["columns"]}}
    guess = Guess({**mapping, **keys}, names, loads.table, (loads.note,), doubts=loads.doubts)
    if loads.otherwise is None:
        return guess
    taken, value = ("shown", "applied") if loads.is_shown else ("applied", "shown")
    text = "Forces and torques of these columns: loads applied to the sensor, or shown by the sensor"
    doubt = (
        f"forces and torques are assumed to be {'shown by the sensor itself' if loads.is_shown else 'applied loads'}"
    )
    alternative = proposal_of_loads(loads.otherwise, names, mapping, meant)
    return replace(guess, ways=(OtherWay("loads", text, taken, value, alternative, doubt),))


def with_doubt_on_samples(guess: Guess, names: tuple[str, ...], values: Array) -> Guess:
    """Return a proposal, with the doubt whether rows of signals are samples of one load rather than load steps."""
    columns = [guess.mapping["columns"].get(load, load) for load in (*WRENCH, "load")]
    loads = values[:, [names.index(name) for name in columns if name in names]]
    if guess.table != "signals" or not loads.shape[1]:
        return guess
    changes = np.flatnonzero(np.any(np.diff(loads, axis=0) != 0.0, axis=1))
    rows, steps = (int(changes[-1]) + 1, len(changes)) if len(changes) else (len(loads), 1)  # the last may go on
    if rows < _SAMPLES * steps:
        return guess
    doubt = (
        "many rows have the load of the row before: if they are samples, [signals] average_samples = true takes means"
    )
    return replace(guess, doubts=(*guess.doubts, doubt))
