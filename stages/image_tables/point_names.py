"""What a target is called: body/target where both are known, else the name that its code gives it."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pyarrow as pa

Names = NDArray[np.object_]

_CODED = re.compile(r"(?P<family>[A-Za-z][^-]*)-(?P<code>[^.]+)(?P<corner>\.\d+)?")
_KINDS = ("ring8", "ring12", "ring14", "charuco", "aruco", "apriltag", "chessboard")


def own_names(point: Names, targets: pa.Table | None) -> tuple[Names, Names, Names]:
    """Point, body and target (N,) of points called by their codes, as the table image_targets has them.

    A code that the table does not hold keeps its name, which is then its target's too, on a body that is not said.
    """
    given = {} if targets is None else {(row["family"], row["code"]): row for row in targets.to_pylist()}
    found = {name: _own(name, given) for name in set(point.tolist())}
    columns = [np.array([found[name][k] for name in point.tolist()], dtype=object) for k in range(3)]
    return columns[0], columns[1], columns[2]


def _own(name: str, given: dict[tuple[str, str], dict[str, str]]) -> tuple[str, str, str]:
    coded = _CODED.fullmatch(name)
    row = given.get((coded["family"], coded["code"])) if coded else None
    if row is None:
        return name, "", name
    target = row["target"] + ((coded and coded["corner"]) or "")
    return f"{row['body']}/{target}", row["body"], target


def kind_of(name: str) -> str:
    """The kind of target that a code's name tells; a circle where it tells none."""
    return next((kind for kind in _KINDS if name.startswith(kind)), "circle")
