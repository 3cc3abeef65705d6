"""What `truing init` makes of files that hold several tables of a photogrammetric network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from truing.formats.guess import Guess

Group = TypeVar("Group")

_ADJUSTED = ("aicon", "colmap", "photomodeler")
_INSTEAD = "not read: the rays beside it give these points with their whole covariance"


def network_tables(guesses: Sequence[tuple[Group, Guess]]) -> list[tuple[Group, Guess]]:
    """An entry for every table of a file; adjusted points are not read where their rays lie beside them."""
    every = [
        (group, replace(guess, table=table, others=()))
        for group, guess in guesses
        for table in (guess.table, *guess.others)
    ]
    has_rays = any(guess.table == "image_points" for _, guess in every)
    return [
        (
            group,
            replace(guess, table=None, notes=(_INSTEAD,), known=True)
            if has_rays and _is_adjusted(group, guess)
            else guess,
        )
        for group, guess in every
    ]


def _is_adjusted(group: Any, guess: Guess) -> bool:
    """Whether a file is a program's list of adjusted points."""
    if guess.table not in ("points", "targets"):
        return False
    return guess.mapping.get("format") in _ADJUSTED or group.example.name.lower().startswith("points3d.bin")
