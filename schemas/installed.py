"""Own items of a kind, joined with those of installed packages (entry points)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from importlib.metadata import entry_points
from typing import TypeVar

Known = TypeVar("Known")


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
