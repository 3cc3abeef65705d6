"""Own items of a kind, joined with those of installed packages (entry points)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from importlib.metadata import entry_points
from typing import TypeVar

Known = TypeVar("Known")


def with_installed(
    own: Iterable[Known],
    group: str,
    kind: str,
    name: Callable[[Known], str],
    wanted: Callable[[Known], bool] = lambda one: True,
) -> dict[str, Known]:
    """Return the project's own items by name, then the wanted items of a group of entry points.

    Raises ValueError if two have the same name.
    """
    found: dict[str, Known] = {}
    installed = (point.load()() for point in sorted(entry_points(group=group)))
    for one in (*own, *filter(wanted, installed)):
        if name(one) in found:
            raise ValueError(f"{kind} {name(one)}: found in two places, expected one")
        found[name(one)] = one
    return found
