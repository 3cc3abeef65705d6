"""Text of the campaign.toml of `truing init`: a complete one with every key explained, or the keys that are needed."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from truing.pipeline.campaign_folder import is_safe_name
from truing.pipeline.campaign_template import guess_lines
from truing.pipeline.init_entries import RawGroup, shortened_entries
from truing.pipeline.init_machine import as_toml, gives_machine
from truing.pipeline.init_questions import names_a_body
from truing.pipeline.init_robot import SUFFIX, Robot
from truing.pipeline.init_rows import BY_HAND
from truing.report.numbers import count_text

if TYPE_CHECKING:
    from truing.formats.guess import Guess

_TEMPLATE = Path(__file__).with_name("campaign_template.toml")
LOADING_TABLES = {"interferometer", "displacement", "signals", "loads", "quadrature", "positioning", "published"}
_SHOWN_COLUMNS = 40
_FEW = 6
_LONGEST_NOTE = 240
NO_TABLE = "no table has columns of these names"
_MOST_LINES = 32  # of entries in a starter file


def listed_columns(columns: tuple[str, ...], most: int = _SHOWN_COLUMNS) -> str:
    """Names of columns, only the first ones of many."""
    more = f", and {len(columns) - most} more" if len(columns) > most else ""
    return ", ".join(columns[:most]) + more if columns else "unknown"


def printable(text: str) -> str:
    """A text on one line, printable and valid in a TOML comment."""
    return text if text.isprintable() else "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def campaign_text(name: str, guesses: list[tuple[RawGroup, Guess]], robot: Robot | None = None) -> str:
    """Text of a campaign.toml with every key explained; sections that the files give are active."""
    from truing.pipeline.campaign_template import known_sections

    tables = Counter(guess.table for _, guess in guesses)
    kind = kind_of_tables(tables)
    files = (_file_lines(group, guess, alone=tables[guess.table] == 1) for group, guess in guesses)
    parts = {
        "@NAME@": _name(name),
        "@KIND@": json.dumps(kind),
        "@MAPPING_KEYS@": "\n".join(_mapping_keys()),
        "@KNOWN_SECTIONS@": "\n".join(known_sections([guess for _, guess in guesses], robot)),
        "@QUALITY_LIMITS@": "\n".join(_quality_limits(kind)),
        "@FILES@": "\n".join(line for lines in files for line in lines),
    }
    return re.sub("|".join(parts), lambda match: parts[match[0]], _TEMPLATE.read_text(encoding="utf-8"))


def starter_campaign_text(name: str, guesses: list[tuple[RawGroup, Guess]], robot: Robot | None) -> str:
    """Text of a campaign.toml with the keys that this campaign needs."""
    from truing.pipeline.campaign_template import starter_text

    tables = Counter(guess.table for _, guess in guesses)
    every = [guess for _, guess in guesses]
    is_used = [
        guess.table is not None or gives_machine(guess, every, is_described=robot is not None) for guess in every
    ]
    read = [entry for entry, used in zip(guesses, is_used, strict=True) if used]
    remaining = [
        unused for unused, used in zip(guesses, is_used, strict=True) if not used and unused[0].example.suffix != SUFFIX
    ]
    entries = [
        (g, guess, list(_file_lines(g, guess, alone=tables[guess.table] == 1, most=0)))
        for g, guess in read
        if guess.table is not None
    ]
    shown, more = shortened_entries(entries, _MOST_LINES)
    files = [line for _, _, lines in shown for line in lines]
    counted = sum(guess.table == "poses" and "number_rows" in guess.mapping for _, guess, _ in shown)
    if counted > 1:
        files += [
            "",
            "# Several entries number their poses from 1: keep those of this campaign, or change the first number of "
            "the others.",
        ]
    files += _listing(
        "Also found; truing init --all writes their entries:", [_found_words(*entry[:2]) for entry in more]
    )
    files += _listing(
        f"Not read (entries by hand: {BY_HAND}):", [_left_words(group, guess) for group, guess in remaining]
    )
    return starter_text(_name(name), kind_of_tables(tables), [guess for _, guess in read], files, robot)


def _listing(head: str, words: list[str]) -> list[str]:
    """Lines of remarks below a heading; none if there are no remarks."""
    more = [f"#   and {len(words) - _FEW} others"] if len(words) > _FEW else []
    return ["", f"# {head}", *(f"#   {printable(line)}" for line in words[:_FEW]), *more] if words else []


def _found_words(group: RawGroup, guess: Guess) -> str:
    return f"{group.glob}{f', {group.count} files' if group.count > 1 else ''}: {guess.table}"


def _left_words(group: RawGroup, guess: Guess) -> str:
    why = f": {guess.notes[0]}" if guess.notes else f": {NO_TABLE}; columns {listed_columns(guess.columns, _FEW)}"
    return f"{group.glob}{f', {group.count} files' if group.count > 1 else ''}{why}"[:240]


def _name(name: str) -> str:
    return json.dumps(name if is_safe_name(name) else "my-campaign", ensure_ascii=False)


def kind_of_tables(tables: Counter[str | None]) -> str:
    """Kind of campaign that these tables make."""
    return "interferometer" if tables.keys() & LOADING_TABLES else "photogrammetry"


def _mapping_keys() -> Iterator[str]:
    """One line per key of [files.<table>], from its definition."""
    from truing.schemas.mapping import FileMapping

    for key, field in FileMapping.model_fields.items():
        default = field.get_default(call_default_factory=True)
        shown = "" if field.is_required() or default in (None, (), {}) else f"; absent: {as_toml(default)}"
        yield f"#   {key:<12} {field.description or 'as it is written in the files'}{shown}"


def _quality_limits(kind: str) -> Iterator[str]:
    """One line per check of a kind of campaign with settable limits, from its declaration."""
    from truing.schemas.quality_checks import settable

    for name, limits in settable(kind).items():
        verdicts = (("warns", limits.warns), ("fails", limits.fails))
        yield f"#   {name:<17} {limits.of}: {', '.join(f'{verb} {words}' for verb, words in verdicts if words)}"


def _file_lines(group: RawGroup, guess: Guess, *, alone: bool, most: int = _SHOWN_COLUMNS) -> Iterator[str]:
    """Entry of a group of raw files; a comment if the group was not recognised."""
    held = (
        count_text(group.count, "photograph")
        if guess.table == "images"
        else f"columns {listed_columns(guess.columns, most)}"
    )
    yield ""
    if most or guess.table == "images":
        yield f"# {printable(group.glob)}: {printable(held)}"
    mapping = guess.mapping
    notes = [printable(note) for note in guess.notes]
    yield from (f"# {note}" if most or len(note) < _LONGEST_NOTE else f"# {note[:_LONGEST_NOTE]}..." for note in notes)
    if guess.table:
        yield from map(printable, guess_lines(mapping, guess))
    if alone and not mapping and group.glob in (f"{guess.table}.csv", f"{guess.table}.parquet"):
        return
    if guess.table == "images" and not mapping:
        return  # at the standard place
    if guess.known and not guess.table:
        return  # no table
    mark = "" if guess.table else "# "
    heading = f"files.{guess.table or 'points'}"
    yield f"{mark}[{heading}]" if alone or not guess.table else f"{mark}[[{heading}]]"
    for key, value in {"path": group.path or group.glob, **mapping}.items():
        yield f"{mark}{key} = {printable(as_toml(value)) if mark else as_toml(value)}"
    if guess.table in ("points", "targets") and not mark and not names_a_body(guess):
        yield '# constants = { body = "platform" }   # needed: the body that carries these targets'
