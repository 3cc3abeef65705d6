"""Search for the files of a path or glob of campaign.toml, with a limit on visited entries, and for companion files."""

from __future__ import annotations

import errno
import fnmatch
import os
import re
from collections.abc import Collection, Iterator
from pathlib import Path
from time import monotonic

from truing.schemas.settings_text import is_special

MOST_ENTRIES = 200_000
SECONDS = 10.0
_WILD = re.compile(r"[*?[]")
_ANY_DEPTH = "**"
_BESIDE = {".phc": (".ior", ".eor")}
_OF_MODEL = ("cameras", "images")


class TooManyEntries(Exception):
    """A glob that visits more folder entries, or takes longer, than allowed."""

    expected = (
        f"a pattern that finds its files among at most {MOST_ENTRIES} entries of folders, within {SECONDS:g} s; "
        "name the folders that they lie in"
    )


_NO_DATA = {".toml", ".md", ".html", ".pdf", ".yaml", ".yml", ".json"}
_NAMED = 4


def find_files(folder: Path, pattern: str) -> list[str]:
    """Return the files of a path or glob, as reached from ``folder``: ``pose2`` before ``pose10``.

    Entries of /proc, /sys and /dev are excluded. Raises TooManyEntries.
    """
    if "\0" in pattern:
        return []
    if is_raw_file(folder / pattern):
        return [pattern]
    if not _WILD.search(pattern) or pattern.endswith(("/", os.sep)):
        return []
    pattern = pattern.replace(os.sep, "/")
    anchor = Path(pattern).anchor.replace(os.sep, "/")
    parts = [part for part in pattern[len(anchor) :].split("/") if part not in ("", ".")]
    parts = [part for part, after in zip(parts, [*parts[1:], ""], strict=True) if (part, after) != (_ANY_DEPTH,) * 2]
    try:
        names = set(_Search().below(str(folder / anchor), anchor, parts))
    except RecursionError:
        raise TooManyEntries from None
    except re.error:
        return []
    return sorted((name for name in names if is_raw_file(folder / name)), key=_natural)


def words_on_unread_files(folder: Path, read: Collection[str] = ()) -> str:
    """Return a hint that names the files at the top of a folder except ``read``; empty if there are none."""
    paths = folder.iterdir() if folder.is_dir() else ()  # the folder may vanish during a run
    names = sorted(path.name for path in paths if not path.name.startswith(".") and is_raw_file(path))
    names = [name for name in names if Path(name).suffix.lower() not in _NO_DATA and name not in read]
    unread = [name for name in names if name.isprintable()]
    more = f" and {len(unread) - _NAMED} more" if len(unread) > _NAMED else ""
    return f"; no entry reads {', '.join(unread[:_NAMED])}{more}" if unread else ""


def is_raw_file(path: Path) -> bool:
    """True if a path is a regular file outside of system folders; False for invalid names."""
    try:
        return path.is_file() and not is_special(path)
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            return False
        raise


class _Search:
    """A walk through folders that counts visited entries."""

    def __init__(self) -> None:
        self._left, self._until = MOST_ENTRIES, monotonic() + SECONDS

    def below(
        self, folder: str, reached: str, parts: list[str], above: frozenset[tuple[int, int]] = frozenset()
    ) -> Iterator[str]:
        """Yield the names, as ``reached`` from the campaign, that the parts of a pattern match in a folder.

        Rules of `glob`: names with a leading dot need a pattern with one, and ``**`` matches any number of folders.
        ``above``: folders passed so far, to stop circles of links.
        """
        plain = next((i for i, part in enumerate(parts) if _WILD.search(part)), len(parts))
        if plain:
            inner = "/".join(parts[:plain])
            yield from self._step(os.path.join(folder, inner), reached + inner, parts[plain:])
        elif parts[0] == _ANY_DEPTH:
            yield from self._at_any_depth(folder, reached, parts[1:] or ["*"], above)
        else:
            fits = re.compile(fnmatch.translate(os.path.normcase(parts[0]))).match
            for entry in self._entries(folder):
                if fits(os.path.normcase(entry.name)) and (parts[0].startswith(".") or not entry.name.startswith(".")):
                    yield from self._step(entry.path, reached + entry.name, parts[1:])

    def _step(self, folder: str, reached: str, remaining_parts: list[str]) -> Iterator[str]:
        if not remaining_parts:
            yield reached
        elif os.path.isdir(folder):
            yield from self.below(folder, f"{reached}/", remaining_parts)

    def _at_any_depth(
        self, folder: str, reached: str, remaining_parts: list[str], above: frozenset[tuple[int, int]]
    ) -> Iterator[str]:
        try:
            status = os.stat(folder)
        except OSError:
            return
        identity = (status.st_dev, status.st_ino)
        if identity in above:
            return
        yield from self.below(folder, reached, remaining_parts)
        for entry in self._entries(folder):
            if not entry.name.startswith(".") and _is_folder(entry):
                yield from self._at_any_depth(
                    entry.path, f"{reached}{entry.name}/", remaining_parts, above | {identity}
                )

    def _entries(self, folder: str) -> Iterator[os.DirEntry[str]]:
        try:
            with os.scandir(folder) as entries:
                for entry in entries:
                    self._left -= 1
                    if self._left < 0 or monotonic() > self._until:
                        raise TooManyEntries
                    yield entry
        except OSError:  # no folder, or no permission
            return


def _is_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir()
    except OSError:
        return False


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)]


def companion_files(path: Path) -> tuple[Path, ...]:
    """Return the files read together with one: of the same name with another ending, else the only one with that
    ending."""
    stem, ending = _parts(path)
    if stem.lower() == "points3d":
        return tuple(one for name in _OF_MODEL if is_raw_file(one := path.with_name(f"{name}{ending}")))
    siblings = (_siblings(path.parent, stem, other) for other in _BESIDE.get(ending, ()))
    return tuple(companion for companion in siblings if companion is not None)


def format_suffix(path: Path) -> str:
    """Return the ending that determines the format, in lower case and without that of a compression."""
    return _parts(path)[1]


def _siblings(folder: Path, stem: str, ending: str) -> Path | None:
    try:
        others = sorted(path for path in folder.iterdir() if format_suffix(path) == ending and is_raw_file(path))
    except OSError:
        return None
    same = [path for path in others if _parts(path)[0] == stem]
    return same[0] if same else others[0] if len(others) == 1 else None


def _parts(path: Path) -> tuple[str, str]:
    plain = Path(re.sub(r"\.(gz|bz2|xz|zip)$", "", path.name, flags=re.IGNORECASE))
    return plain.stem, plain.suffix.lower()
