"""Recorded direction of approach of an axis: a column such as ``Richtung`` with ``+`` and ``-``, for `truing init`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from truing.arrays import Array
from truing.formats.guess import Guess, MappingKeys, OtherWay
from truing.formats.units import bare_and_unit

DIRECTION = (
    r"((travel|approach)[ _])?direction|dir|((an|ver)?fahr|dreh|anfahr|bewegungs)?richtung|drehsinn|approach|anfahrt"
    r"|sens([ _]de[ _](rotation|déplacement|marche|l'approche|mesure))?|approche|sense|\+ ?/ ?-|±"
)
WORDS = {
    "forward": (
        *("+", "+1", "1", "forward", "forwards", "fwd", "up", "increasing", "plus", "pos", "positive", "out", "↑"),
        *("vorwärts", "vor", "hin", "auf", "aufwärts", "steigend", "positiv"),
        *("aller", "avant", "montée", "montee", "croissant", "positif"),
    ),
    "backward": (
        *("-", "–", "−", "-1", "0", "backward", "backwards", "bwd", "back", "down", "decreasing", "minus", "neg"),
        *("negative", "reverse", "rev", "return", "in", "↓"),
        *("rückwärts", "rück", "zurück", "rueck", "zurueck", "her", "ab", "abwärts", "fallend", "negativ"),
        *("retour", "arrière", "arriere", "descente", "décroissant", "negatif", "négatif"),
    ),
}
_KEY = "approach"
_AGREES = 0.9  # share of the movements between successive rows that decides what the words mean
_EVEN = 0.5
_COMMANDS = ("command_deg", "command_mm")


def direction_of(cell: str) -> str | None:
    """Return ``forward`` or ``backward`` for a word of a direction; None for others."""
    return next((word for word, names in WORDS.items() if cell.strip().casefold() in names), None)


def with_direction(guess: Guess, names: Sequence[str], rows: Sequence[Sequence[str]], values: Array) -> Guess:
    """Return a proposal of an axis that reads the recorded direction of approach; unchanged without such a column.

    values (N, W): the numbers of the columns with these names. Where successive rows move as the words say, or always
    the opposite way, the movements decide what the words mean; otherwise the user is asked.
    """
    ways = tuple(replace(way, guess=with_direction(way.guess, names, rows, values)) for way in guess.ways)
    guess, columns = replace(guess, ways=ways), guess.mapping.get("columns", {})
    command = next((str(columns[name]) for name in _COMMANDS if isinstance(columns.get(name), str)), "")
    raw = next((name for name in names if re.fullmatch(DIRECTION, bare_and_unit(name)[0].casefold())), None)
    if guess.table != "configurations" or command not in names or raw is None or raw in columns.values():
        return guess
    cells = [row[list(names).index(raw)].strip() for row in rows]
    words = sorted(set(filter(None, cells)))
    if len(words) != len(WORDS):
        return guess
    signs = _signs(words)
    agreement = _agreement(cells, signs, values[:, list(names).index(command)])
    if agreement is not None and (agreement >= _AGREES or agreement <= 1.0 - _AGREES):
        meant = signs if agreement >= _AGREES else _opposite(signs)
        note = f"{raw} is read as the direction of approach; the rows move to larger commands at {_up(meant)}"
        return replace(_reading(guess, raw, meant), notes=(*guess.notes, note))
    up, down = _up(signs), _up(_opposite(signs))
    text = f"{raw}: its word for an approach by movement to larger commands, which the order of rows does not show"
    doubt = f"{raw} = {up} is assumed to be a movement to larger commands"
    way = OtherWay(_KEY, text, up, down, _reading(guess, raw, _opposite(signs)), doubt)
    return replace(_reading(guess, raw, signs), ways=(*ways, way))


def _signs(words: Sequence[str]) -> dict[str, int]:
    """Return 1 or -1 by word; where the words are not known, the first is 1."""
    known = {word: direction_of(word) for word in words}
    if set(known.values()) != set(WORDS):
        return dict(zip(words, (1, -1), strict=True))
    return {word: 1 if direction == "forward" else -1 for word, direction in known.items()}


def _opposite(signs: Mapping[str, int]) -> dict[str, int]:
    return {word: -sign for word, sign in signs.items()}


def _up(signs: Mapping[str, int]) -> str:
    return next(word for word, sign in signs.items() if sign > 0)


def _agreement(cells: Sequence[str], signs: Mapping[str, int], command: Array) -> float | None:
    """Return the share of the movements between successive rows that have the recorded sign, of the less clear word.

    A half where the words differ in it, as where both passes are written with rising commands. None where rows of
    either word show no movement, as in a file that is sorted by commands.
    """
    recorded = np.array([float(signs.get(cell, np.nan)) for cell in cells])[1:]
    step = np.sign(np.diff(command))
    known = np.isfinite(recorded) & np.isfinite(step) & (step != 0.0)
    of_words = [known & (recorded == sign) for sign in (1.0, -1.0)]
    shares = [float(np.mean(step[rows] == recorded[rows])) for rows in of_words if rows.any()]
    if len(shares) < len(of_words):
        return None
    return min(shares) if min(shares) > _EVEN else max(shares) if max(shares) < _EVEN else _EVEN


def _reading(guess: Guess, raw: str, signs: Mapping[str, int]) -> Guess:
    """Return a proposal that reads the raw column as direction of approach."""
    mapping: MappingKeys = {**guess.mapping, "columns": {**guess.mapping["columns"], "approach": raw}}
    ignored = [part for part in str(mapping.pop("ignore", "")).split("|") if part and not re.fullmatch(part, raw)]
    mapping |= {"ignore": "|".join(ignored)} if ignored else {}
    words = {re.escape(word): str(sign) for word, sign in signs.items() if word != str(sign)}
    mapping |= {"rename": {**guess.mapping.get("rename", {}), "approach": words}} if words else {}
    return replace(guess, mapping=mapping)
