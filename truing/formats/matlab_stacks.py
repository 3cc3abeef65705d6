"""Proposals for MATLAB files with stacks: targets or poses of bodies along three dimensions, and other readings."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from truing.formats.guess import Guess
from truing.formats.named_columns import are_motions

if TYPE_CHECKING:
    from truing.arrays import Array
    from truing.formats.matlab import Variable

_AXES, _DIMENSIONS, _SQUARE = 3, 3, 4
_RIGID = 0.01  # change of distances over the poses, of their size: more is no body
_SMALLEST, _MOST_PAIRS = 0.2, 200
_TIMES, _TEMPERATURES, _ACTUATORS = r"t|time|times|zeit", r"temp(erature)?s?", r"rho|actuators?|stroke"
_NO_NAME = re.compile(r"[^\w.-]")


@dataclass(frozen=True)
class _Stack:
    """A variable as poses of a body, or as its targets: keys that read it, number of poses, change of distances."""

    table: str
    mapping: dict[str, object]
    columns: tuple[str, ...]
    poses: int
    change: float = 0.0


def guess_of_stacks(variables: Mapping[str, Variable], text: str) -> Guess | None:
    """Return a proposal for stacks of matrices or points, a body each, and for the readings of each pose; else None."""
    texts = [value for value in variables.values() if isinstance(value, list)]
    stacks = {
        name: min(found, key=lambda one: one.change)
        for name, value in variables.items()
        if isinstance(value, np.ndarray) and (found := list(_stacks(name, value, texts)))
    }
    counts = {stack.poses for stack in stacks.values()}
    if len(counts) != 1:
        return None
    entries = [_entry(name, stack, text, alone=len(stacks) == 1) for name, stack in stacks.items()]
    return replace(entries[0], other_tables=(*entries[1:], *_readings(variables, counts.pop(), text)))


def _entry(name: str, stack: _Stack, text: str, *, alone: bool) -> Guess:
    keys = {"variable": name, **stack.mapping, "number_rows": {"pose": 1}}
    if alone:
        keys |= {"constants": {"body": "tool"}} if stack.table == "poses" else {}
        return Guess(keys, stack.columns, stack.table, (text,))
    keys |= {"constants": {"body": name.rsplit(".", 1)[-1]}}
    doubt = f"the variable {name} is assumed to be a body"
    return Guess(keys, stack.columns, stack.table, (text,), doubts=(doubt,), answered=frozenset({"body"}))


def _stacks(name: str, value: Array, texts: list[list[str]]) -> Iterator[_Stack]:
    """Yield the possible meanings of a variable, by its shape and its numbers."""
    if value.ndim != _DIMENSIONS or value.dtype.kind not in "iuf":
        return
    for transpose in (False, True):
        stack = np.asarray(value if transpose else np.moveaxis(value, 2, 0), dtype=float)
        count, rows, columns = stack.shape
        keys: dict[str, object] = {"transpose": True} if transpose else {}
        names = tuple(f"m{i}{j}" for i in range(rows) for j in range(columns))
        if count > 1 and columns == _SQUARE and rows in (_AXES, _SQUARE) and np.isfinite(stack).all():
            if are_motions(stack):
                yield _Stack("poses", keys, names, count)
        elif columns == _AXES and rows >= _AXES and (change := _change(stack)) < _RIGID:
            named = _names(rows, texts)
            names_of_targets = [f"{target}_{axis}" for target in named for axis in "xyz"]
            yield _Stack(
                "points",
                {**keys, "names": names_of_targets, "wide": "{target}_{axis}"},
                tuple(names_of_targets),
                count,
                change,
            )
        elif rows == _AXES and columns >= _AXES and (change := _change(np.swapaxes(stack, 1, 2))) < _RIGID:
            named = _names(columns, texts)
            names_of_targets = [f"{axis}_{target}" for axis in "xyz" for target in named]
            yield _Stack(
                "points",
                {**keys, "names": names_of_targets, "wide": "{axis}_{target}"},
                tuple(names_of_targets),
                count,
                change,
            )


def _names(count: int, texts: list[list[str]]) -> list[str]:
    """Return the names of targets: the only texts of that number, else numbers."""
    fitting = [text for text in texts if len(text) == count and len(set(text)) == count]
    if len(fitting) == 1 and not any(_NO_NAME.search(name) for name in fitting[0]):
        return fitting[0]
    return [str(number) for number in range(1, count + 1)]


def _change(points: Array) -> float:
    """Return the change of distances between points (N, M, 3) over the N poses, of their size.

    The fifth of the distances that change least decides, because a stack may hold the points of several bodies.
    """
    if len(points) < 2:
        return np.inf
    pairs = list(combinations(range(points.shape[1]), 2))
    first, second = np.array(pairs[:: max(1, len(pairs) // _MOST_PAIRS)]).T
    distances = np.linalg.norm(points[:, first] - points[:, second], axis=2)
    is_observed = np.isfinite(distances).all(axis=0) & (distances > 0.0).all(axis=0)
    if not is_observed.any():
        return np.inf
    return float(
        np.quantile(np.std(distances[:, is_observed], axis=0) / np.mean(distances[:, is_observed], axis=0), _SMALLEST)
    )


def _readings(variables: Mapping[str, Variable], count: int, text: str) -> Iterator[Guess]:
    """Yield the proposal for variables with a row for each pose, as configurations; none without them."""
    readings_of_stack = {
        name: value
        for name, value in variables.items()
        if isinstance(value, np.ndarray)
        and value.ndim == 2
        and value.dtype.kind in "biuf"
        and (value.shape[0] == count or value.shape == (1, count))
    }
    columns: dict[str, str] = {}
    listed: list[str] = []
    for name, value in readings_of_stack.items():
        short = name.rsplit(".", 1)[-1]
        width = 1 if 1 in value.shape else value.shape[1]
        raw = [short] if width == 1 else [f"{short}_{number}" for number in range(1, width + 1)]
        if width == 1 and len(readings_of_stack) == 1:
            raw = [short]
        elif len(readings_of_stack) == 1:
            raw = [str(number) for number in range(1, width + 1)]
        listed += raw
        columns |= _meaning(short.casefold(), raw, columns, np.ravel(value))
    if readings_of_stack:
        keys = {
            "variable": list(readings_of_stack),
            **({"columns": columns} if columns else {}),
            "number_rows": {"pose": 1},
        }
        yield Guess(keys, tuple(listed), "configurations", (text,))


def _meaning(word: str, raw: list[str], used_columns: Mapping[str, str], values: Array) -> dict[str, str]:
    """Return the columns that a variable means by its name; covariates keep theirs."""
    if len(raw) == 1:
        known = {"time_s": _TIMES, "temperature_c": _TEMPERATURES}
        column_of_word = next((column for column, words in known.items() if re.fullmatch(words, word)), None)
        if column_of_word == "time_s" and not np.all(np.diff(values) > 0.0):
            return {}  # times increase
        return {column_of_word: raw[0]} if column_of_word is not None and column_of_word not in used_columns else {}
    if re.fullmatch(_ACTUATORS, word):
        return {f"rho{number}_mm": name for number, name in enumerate(raw, start=1)}
    return {}
