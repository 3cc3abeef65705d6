"""The unit `grad` of a column, for `truing init`: a degree in German, and the four-hundredth of a turn elsewhere."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from truing.arrays import Array
from truing.formats.guess import Guess, OtherWay
from truing.formats.units import UnknownUnit, conversion

_GRAD = re.compile(r".*[\s\[({_/,]grade?s?\s*[\])}]?\s*", re.I)
_GERMAN = re.compile(
    r"winkel|\bsoll|\bist\b|ablesung|anzeige|achse|richtung|abweichung|gelenk|zeit|\bnr\b", re.IGNORECASE
)
_FRENCH = re.compile(r"consigne|lecture|mesur[eé]|écart|heure|\bsens\b|gisement|angle de|axe", re.I)
_TURN = 400.0  # gon
_NEARLY = 1.02
_KEY = "unit_of_angle"


def with_unit_of_grad(guess: Guess, names: Sequence[str], values: Array) -> Guess:
    """Return a proposal with the question what ``grad`` means, if a column of angles has it; numbers (N, W) beyond a
    turn of 360, or words of the other heads, tell which is more probable."""
    columns = {column: raw for column, raw in guess.mapping.get("columns", {}).items() if isinstance(raw, str)}
    angles = {column: raw for column, raw in columns.items() if raw in names and is_grad(raw) and _is_angle(column)}
    if not angles:
        return guess
    guess_in_gon = _in_gon(guess, angles)
    numbers = values[:, [list(names).index(raw) for raw in angles.values()]]
    taken = "gon" if _is_gon(names, numbers) else "deg"
    shown = next(iter(angles.values()))
    text = f"Unit of {shown}: grad is a degree in German, and 1/400 of a turn (gon) elsewhere"
    doubt = f"{shown} and the like are assumed to be in {taken} (grad: deg in German, gon elsewhere)"
    first, second = (guess_in_gon, guess) if taken == "gon" else (guess, guess_in_gon)
    way = OtherWay(_KEY, text, taken, "deg" if taken == "gon" else "gon", second, doubt)
    return replace(first, ways=(*first.ways, way))


def is_grad(name: str) -> bool:
    """True if a raw column's name ends in the unit grad."""
    return _GRAD.fullmatch(name) is not None


def _is_gon(names: Sequence[str], numbers: Array) -> bool:
    known = np.abs(numbers[np.isfinite(numbers)])
    is_beyond_turn = known.size > 0 and 360.0 * _NEARLY < float(known.max()) <= _TURN * _NEARLY
    words = " ".join(names)
    is_german = _GERMAN.search(words) is not None
    return is_beyond_turn or (not is_german and (_FRENCH.search(words) is not None or "Grad" not in words))


def _in_gon(guess: Guess, angles: Mapping[str, str]) -> Guess:
    units = {**guess.mapping.get("units", {}), **dict.fromkeys(angles, "gon")}
    return replace(guess, mapping={**guess.mapping, "units": units})


def _is_angle(column: str) -> bool:
    try:
        conversion(column.rsplit("_", 1)[-1], "deg")
    except UnknownUnit:
        return False
    return True
