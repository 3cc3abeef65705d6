"""Own items of a kind, joined with those of installed packages (entry points)."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable
from functools import lru_cache
from importlib import metadata
from typing import TypeVar, cast

Known = TypeVar("Known")


def entry_points(group: str) -> metadata.EntryPoints:
    """Return the entry points of a group of all packages on the path.

    They are read again only if the path or the time of one of its folders has changed, as by an installation: one look
    into all installed packages takes longer than many a stage, and a run asks a dozen times.
    """
    return _entry_points(tuple((place, _changed(place)) for place in sys.path)).select(group=group)


@lru_cache(maxsize=1)
def _entry_points(path: tuple[tuple[str, int], ...]) -> metadata.EntryPoints:
    # Before Python 3.12 a call without a group returns another type, which selects a group in the same way.
    return cast(metadata.EntryPoints, metadata.entry_points())


def _changed(place: str) -> int:
    """Time of the last change of a folder or archive of the path, ns; 0 if it is not there."""
    try:
        return os.stat(place or os.curdir).st_mtime_ns
    except OSError:
        return 0


def with_installed(
    built_in: Iterable[Known],
    group: str,
    kind: str,
    name: Callable[[Known], str],
    wanted: Callable[[Known], bool] = lambda item: True,
) -> dict[str, Known]:
    """Return the project's own items by name, then the wanted items of a group of entry points.

    Raises ValueError if two have the same name.
    """
    by_name: dict[str, Known] = {}
    installed = (point.load()() for point in sorted(entry_points(group=group)))
    for item in (*built_in, *filter(wanted, installed)):
        if name(item) in by_name:
            raise ValueError(f"{kind} {name(item)}: found in two places, expected one")
        by_name[name(item)] = item
    return by_name
