"""Names of targets: body/target if both are known, else by code; and whether a survey has the name."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.schemas.faults import Fault
from truing.schemas.near_names import meant_by

Names = NDArray[np.object_]

_CODED = re.compile(r"(?P<family>[A-Za-z][^-]*)-(?P<code>[^.]+)(?P<corner>\.\d+)?")
_KINDS = ("ring8", "ring12", "ring14", "charuco", "aruco", "apriltag", "chessboard")
_SHOWN = 3


def survey_names(point: Names, targets: pa.Table | None) -> tuple[Names, Names, Names]:
    """Point, body and target (N,) of points called by their codes, as the table image_targets has them.

    A code that the table does not hold keeps its name, which is also its target's name, on an unknown body.
    """
    row_of_code = {} if targets is None else {(row["family"], row["code"]): row for row in targets.to_pylist()}
    name_of_point = {name: _survey_name(name, row_of_code) for name in set(point.tolist())}
    columns = [np.array([name_of_point[name][k] for name in point.tolist()], dtype=object) for k in range(3)]
    return columns[0], columns[1], columns[2]


def _survey_name(name: str, name_pairs: dict[tuple[str, str], dict[str, str]]) -> tuple[str, str, str]:
    coded = _CODED.fullmatch(name)
    row = name_pairs.get((coded["family"], coded["code"])) if coded else None
    if row is None:
        return name, "", name
    target = row["target"] + ((coded and coded["corner"]) or "")
    return f"{row['body']}/{target}", row["body"], target


def kind_of(name: str) -> str:
    """Kind of target by the name of its code; a circle if the name has none."""
    return next((kind for kind in _KINDS if name.startswith(kind)), "circle")


def unknown_to_survey(rays: pa.Table, survey: pa.Table, bars: pa.Table | None) -> Iterator[Fault]:
    """A fault if every ray has a name, but the survey contains none of them except ends of scale bars.

    Rays without a name are named by the survey's geometry later on.
    """
    names = set(zip(*(rays.column(name).to_pylist() for name in ("point", "body", "target")), strict=True))
    if any(not target for _, _, target in names):
        return
    ends = set() if bars is None else {*bars.column("first").to_pylist(), *bars.column("second").to_pylist()}
    unknown = sorted((body, target) for point, body, target in names if point not in ends)
    known = set(zip(survey.column("body").to_pylist(), survey.column("target").to_pylist(), strict=True))
    targets = {target for _, target in known}
    if unknown and not any((body, target) in known or (not body and target in targets) for body, target in unknown):
        shown = ", ".join(f"{body}/{target}" if body else target for body, target in unknown[:_SHOWN])
        expected = f"rays to targets that the survey has ({', '.join(sorted(targets)[:_SHOWN])}, ...)"
        expected += meant_by((name for _, name in unknown), targets)
        yield Fault("image_points", expected, column="target", value=f"{shown}, ...")
