"""Exports that the look of a file gives away: programs by their columns, and targets side by side in one row."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

Known = tuple[dict[str, Any], tuple[str, ...], str]
"""Keys for [files.points], the names of the columns, and what to look at again."""

_TRACKER = {"feature", "id", "x", "y", "z"}
_METASHAPE = re.compile(r"#?\s*Label[,;\t].*\bX_est\b")
_WHERE = "say under from_name or constants which pose and body it is"
_FLAGS_FROM = 7  # columns of an adjustment's list after id, three coordinates and three sigmas
_BETWEEN = ("_", ".", ":", "-", " ", "")
_UNIT_BEHIND = re.compile(r"[\s_]*[\[(/]?\s*(mm|cm|um|µm|m|in)\s*[\])]?$")
_FEWEST = 2  # targets side by side
# what forces, motions and settings are called: their components are no coordinates
_NO_POINTS = re.compile(
    r"force|moment|torque|\bload|sensor|accel|gyro|veloc|speed|goal|command|setpoint|roll|pitch|yaw|"
    r"(?:^|[ _])q[wxyz]\b",
    re.I,
)


def metashape(lines: Sequence[str]) -> Known | None:
    """Markers of Metashape's reference pane, whose line of names begins like a comment."""
    heading = next((line for line in lines[:10] if _METASHAPE.match(line)), None)
    if heading is None:
        return None
    note = f"Metashape: measured are X_est Y_est Z_est, taken to be in m; {_WHERE}"
    names = tuple(re.split(r"[,;\t]", heading.lstrip("# ")))
    return {"format": "metashape", "constants": {"body": "body"}}, names, note


def tracker(names: Sequence[str], thousands: str | None) -> Known | None:
    """A laser tracker's list of readings."""
    if not ({name.casefold() for name in names} >= _TRACKER and thousands == ","):
        return None
    note = "a laser tracker's export: say under from_name or constants which body and target it is"
    return {"format": "tracker", "constants": {"body": "body"}}, tuple(names), note


def adjusted_points(records: Sequence[Sequence[str]], is_number: Callable[[str], bool]) -> Known | None:
    """A list of points without header: V-STARS' ``id x y z sx sy sz``, or AICON's, with rays and flags."""
    width = len(records[0])
    names = tuple(str(i + 1) for i in range(width))
    if width < 4 or not all(is_number(cell) for record in records for cell in record[1:]):
        return None
    if is_id(records) and width >= _FLAGS_FROM and _are_sigmas(records):
        if width >= _FLAGS_FROM + 2 and all(cell.isdigit() for record in records for cell in record[_FLAGS_FROM:]):
            note = f"AICON: id x y z sx sy sz rays used, where 0 under used is a point to leave out; {_WHERE}"
            return {"format": "aicon", "select": {"used": "1"}, "constants": {"body": "body"}}, names, note
        return _vstars(names)
    return _vstars(names) if width <= _FLAGS_FROM + 1 and all(record[0][:1].isalpha() for record in records) else None


def coded_alone(lines: Sequence[str], separators: str = ",;\t ") -> dict[str, Any]:
    """The ``select`` of coded targets, which keep their numbers from bundle to bundle, where others are among them."""
    names = [re.split(f"[{separators}]", line.strip(), maxsplit=1)[0] for line in lines if line.strip()]
    coded = sum(re.fullmatch(r"CODE\d+", name) is not None for name in names)
    return {"select": {"target": r"CODE\d+"}} if 0 < coded < len(names) else {}


def _vstars(names: tuple[str, ...]) -> Known:
    note = f"V-STARS: id x y z sx sy sz; {_WHERE}"
    return {"format": "vstars", "constants": {"body": "body"}}, names, note


def is_id(records: Sequence[Sequence[str]]) -> bool:
    """Whether the first column holds numbers of points: whole, each once, beside coordinates that are not."""
    first = [record[0] for record in records]
    marks = [re.search(r"\d[.,]\d", cell) is not None for record in records for cell in record[1:4]]
    return all(cell.isdigit() for cell in first) and len(set(first)) == len(first) and bool(marks) and all(marks)


def _are_sigmas(records: Sequence[Sequence[str]]) -> bool:
    """Whether columns 5 to 7 are positive and mostly below one."""
    cells = [cell.replace(",", ".") for record in records for cell in record[4:7]]
    values = [float(cell) if re.fullmatch(r"\d+\.\d+", cell) else -1.0 for cell in cells]
    return all(value >= 0.0 for value in values) and sum(value < 1.0 for value in values) > 0.5 * len(values)


def wide_template(names: Sequence[str]) -> tuple[str, str | None] | None:
    """The template of coordinates of several targets in one row, and their unit where the names end with one."""
    found = [_UNIT_BEHIND.search(name) for name in names]
    behind = {match[0] for name, match in zip(names, found, strict=True) if match and re.search(r"[xyzXYZ]", name)}
    best: tuple[int, int, str, str | None] = (0, 0, "", None)
    for rank, between in enumerate(_BETWEEN):
        for ending in ("", *sorted(behind)):
            for template in (f"{{target}}{between}{{axis}}{ending}", f"{{axis}}{between}{{target}}{ending}"):
                count = _targets_of(template, names)
                unit = _UNIT_BEHIND.search(ending)
                best = max(best, (count, -rank, template, unit[1] if unit else None), key=lambda one: one[:2])
    return best[2:] if best[0] >= _FEWEST and not _NO_POINTS.search(" ".join(names)) else None


def _targets_of(template: str, names: Sequence[str]) -> int:
    """How many targets have all three coordinates by a template."""
    pattern = (
        re.escape(template).replace(r"\{target\}", r"(?P<target>\w.*?)").replace(r"\{axis\}", "(?P<axis>[xyzXYZ])")
    )
    axes: dict[str, set[str]] = {}
    for name in names:
        if match := re.fullmatch(pattern, name):
            axes.setdefault(match["target"], set()).add(match["axis"].lower())
    return sum(len(found) == 3 for found in axes.values())
