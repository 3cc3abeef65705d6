"""Lists of targets' image coordinates in pixels, by programs without a format of their own."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from truing.formats.guess import Guess, MappingKeys

if TYPE_CHECKING:
    from truing.formats.proposed_poses import NamedCells

_UNIT = r"(?:[\s_]*[\[(]?\s*(?:px|pix|pixels?)\s*[\])]?)"
_WITH_UNIT = re.compile(rf"(?P<axis>[xyuv]|img_?[xy]|image_?[xy]){_UNIT}", re.IGNORECASE)
# Pairs of names for the coordinate to the right and the one downwards.
_PAIRS = (("u", "v"), ("col", "row"), ("column", "row"), ("px", "py"), ("spalte", "zeile"), ("x", "y"))
_THIRD = {"z", "w"}  # coordinates in space
_NUMBERED = r"([ _]?(name|id|no|nr|number|file))?"
_OF = {
    "image": rf"(image|img|photo(graph)?|picture|pic|foto|bild|aufnahme|view){_NUMBERED}|file(name)?",
    "point": rf"(target|point|pt|marker|mark|code|tag|label|id|name|punkt|ziel|zielmarke|marke){_NUMBERED}",
    "camera": r"cam(era)?|kamera",
    "pose": r"pose|epoch|epoche",
}
_LEAST, _MOST = -100.0, 1e5  # px
_ORIGIN = (
    "x is assumed to point right and y down, with 0 in the middle of the first pixel: "
    "offset = { x_px = -1, y_px = -1 } if pixels count from 1"
)
_ONE_POSE = "all images are taken to show one pose: say which pose each belongs to, if there are several"
_NOTE = "image coordinates of targets in pixels; complete [[cameras]]: width_px, height_px, pixel_um, c_mm"


def rays_of(cells: NamedCells, mapping: MappingKeys) -> Guess | None:
    """Return the proposal for a list of image coordinates; None for other tables.

    A file without a column of images is one image, and its name says which.
    """
    columns = {key: name for key, pattern in _OF.items() if (name := _named(cells.names, pattern)) is not None}
    pair = _coordinates(cells.names, has_image="image" in columns)
    if pair is None or "point" not in columns:
        return None
    values = np.column_stack([cells.numbers(name) for name in pair])
    if not np.isfinite(values).all() or values.min() < _LEAST or values.max() > _MOST:
        return None
    columns |= {"x_px": pair[0], "y_px": pair[1]}
    keys: MappingKeys = {**mapping, "columns": columns}
    doubts = [_ORIGIN]
    if "pose" not in columns:
        keys["constants"] = {"pose": 1}
        doubts.append(_ONE_POSE)
    left = [name for name in cells.names if name not in columns.values()]
    if left:
        keys["ignore"] = "|".join(map(re.escape, left))
    return Guess(keys, cells.names, "image_points", (_NOTE,), doubts=tuple(doubts))


def _coordinates(names: tuple[str, ...], *, has_image: bool) -> tuple[str, str] | None:
    """Return the names of the coordinates to the right and downwards, where no third one is in the table."""
    plain = {name.strip().lower(): name for name in names}
    if plain.keys() & _THIRD:
        return None
    with_unit = [(match["axis"].lower()[-1], name) for name in names if (match := _WITH_UNIT.fullmatch(name.strip()))]
    for first, other in (("x", "y"), ("u", "v")):
        found = [[name for axis, name in with_unit if axis == wanted] for wanted in (first, other)]
        if all(len(each) == 1 for each in found):
            return found[0][0], found[1][0]
    for first, other in _PAIRS:
        if first in plain and other in plain and (first != "x" or has_image):
            return plain[first], plain[other]
    return None


def _named(names: tuple[str, ...], pattern: str) -> str | None:
    found = [name for name in names if re.fullmatch(pattern, name.strip(), re.IGNORECASE)]
    return found[0] if len(found) == 1 else None


def pattern_of_images(names: tuple[str, ...]) -> str | None:
    """Return the pattern of pose and image in names of files such as pose2_image3.csv; None for other names."""
    parts = [re.fullmatch(r"(.*?pose[ _-]?)(\d+)(\D+)(\d+)(\D*)", name, re.IGNORECASE) for name in names]
    matches = [match for match in parts if match is not None]
    fixed = {(match[1], match[3], match[5]) for match in matches}
    if len(matches) < len(names) or len(fixed) != 1:
        return None
    before, between, after = (re.escape(part) for part in fixed.pop())
    return rf"{before}(?P<pose>\d+){between}(?P<image>\d+){after}"
