"""Damages of a campaign: small changes of a file, each a function of the campaign's folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.changed_files import replace_text
from truing.pipeline.problems import ExitCode

Spoil = Callable[[Path], None]


@dataclass(frozen=True)
class Broken:
    """One broken campaign: its name, the good one it is made from, what is done to it, how its run must end.

    ``says``: regular expressions, each of which the messages must match. ``whole``: run all stages, where it is a later
    one that must speak; else the run ends with QA.
    """

    name: str
    of: str  # telescope, bench or axis
    spoil: Spoil
    says: tuple[str, ...]
    code: ExitCode = ExitCode.UNUSABLE_CAMPAIGN
    whole: bool = False


def toml(old: str, new: str, times: int = 1) -> Spoil:
    """Replace a text of campaign.toml."""
    return replaced("campaign.toml", old, new, times)


def appended(file: str, text: str) -> Spoil:
    """Put a text at the end of a file."""

    def spoil(folder: Path) -> None:
        with open(folder / file, "a", encoding="utf-8") as out:
            out.write(text)

    return spoil


def replaced(file: str, old: str, new: str, times: int = 1) -> Spoil:
    """Replace a text in a file."""
    return lambda folder: replace_text(folder / file, old, new, times)


def whole(file: str, content: bytes) -> Spoil:
    """Give a file another content."""
    return lambda folder: _write(folder / file, content)


def cut(file: str, share: float) -> Spoil:
    """Leave the first part of a file, as a copy that was interrupted does."""

    def spoil(folder: Path) -> None:
        content = (folder / file).read_bytes()
        (folder / file).write_bytes(content[: int(share * len(content))])

    return spoil


def gone(file: str) -> Spoil:
    """Remove a file."""
    return lambda folder: (folder / file).unlink()


def cells(file: str, column: str, change: Callable[[str], str], rows: Callable[[dict[str, str]], bool]) -> Spoil:
    """Change the cells of a column in the rows that are meant."""

    def spoil(folder: Path) -> None:
        names, *lines = (line.split(",") for line in (folder / file).read_text(encoding="utf-8").splitlines())
        place, changed = names.index(column), 0
        for line in lines:
            if rows(dict(zip(names, line, strict=True))):
                line[place], changed = change(line[place]), changed + 1
        assert changed, f"no row of {file} is meant"
        text = "".join(",".join(line) + "\n" for line in (names, *lines))
        (folder / file).write_text(text, encoding="utf-8")

    return spoil


def cell(file: str, row: int, column: str, value: str) -> Spoil:
    """Give one cell another text; rows are counted from 0, the head aside."""

    def spoil(folder: Path) -> None:
        lines = (folder / file).read_text(encoding="utf-8").splitlines()
        parts = lines[row + 1].split(",")
        parts[lines[0].split(",").index(column)] = value
        lines[row + 1] = ",".join(parts)
        (folder / file).write_text("\n".join(lines) + "\n", encoding="utf-8")

    return spoil


def without(file: str, rows: Callable[[dict[str, str]], bool]) -> Spoil:
    """Remove the rows that are meant."""

    def spoil(folder: Path) -> None:
        head, *lines = (folder / file).read_text(encoding="utf-8").splitlines()
        names = head.split(",")
        kept = [line for line in lines if not rows(dict(zip(names, line.split(","), strict=True)))]
        assert len(kept) < len(lines), f"no row of {file} is meant"
        (folder / file).write_text("\n".join([head, *kept]) + "\n", encoding="utf-8")

    return spoil


def without_column(file: str, column: str) -> Spoil:
    """Remove a column."""

    def spoil(folder: Path) -> None:
        lines = [line.split(",") for line in (folder / file).read_text(encoding="utf-8").splitlines()]
        place = lines[0].index(column)
        text = "".join(",".join(line[:place] + line[place + 1 :]) + "\n" for line in lines)
        (folder / file).write_text(text, encoding="utf-8")

    return spoil


def scaled(factor: float) -> Callable[[str], str]:
    """A cell's number times a factor."""
    return lambda text: repr(factor * float(text))


def both(*spoils: Spoil) -> Spoil:
    """One after the other."""

    def spoil(folder: Path) -> None:
        for spoil in spoils:
            spoil(folder)

    return spoil


def every(row: dict[str, str]) -> bool:
    """Every row is meant."""
    return True


def _write(path: Path, content: bytes) -> None:
    path.write_bytes(content)
