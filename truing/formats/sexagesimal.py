"""Angles written in degrees, minutes and seconds, such as ``-12°34'56.7"``."""

from __future__ import annotations

import re

import numpy as np
import pyarrow as pa

from truing.arrays import Mask

UNIT = "dms"
EXPECTED = "an angle in degrees, minutes and seconds, such as -12°34'56.7\""
_SIXTY = 60.0
_ANGLE = re.compile(
    r"(?P<sign>[-+]?)\s*(?P<degrees>\d{1,6})(?:\s*[°º˚d:]\s*|\s*-\s*|\s+)"
    r"(?P<minutes>\d{1,2}(?:[.,]\d*)?)"
    r"(?:(?:\s*['′’m:]\s*|\s*-\s*|\s+)(?P<seconds>\d{1,2}(?:[.,]\d*)?)\s*(?:\"|″|”|''|′′|’’|s)?|\s*['′’m]?)",
    re.IGNORECASE,
)
_MARKED = re.compile(r"[°º˚]")


def degrees_of(text: str) -> float | None:
    """Return the decimal degrees of an angle in degrees, minutes and seconds; None for other texts."""
    match = _ANGLE.fullmatch(text.strip().replace("\u2212", "-"))
    if match is None:
        return None
    minutes, seconds = (float((match[name] or "0").replace(",", ".")) for name in ("minutes", "seconds"))
    is_split = match["seconds"] is not None and not minutes.is_integer()
    if minutes > _SIXTY or seconds > _SIXTY or is_split:  # 60.0 is a rounded 59.97
        return None
    size = float(match["degrees"]) + (minutes + seconds / _SIXTY) / _SIXTY
    return -size if match["sign"] == "-" else size


def parsed_angles(texts: pa.Array) -> tuple[pa.Array, Mask]:
    """Return decimal degrees (N,), null for empty cells, and the mask of texts that are no such angles."""
    cells = [(text or "").strip() for text in texts.to_pylist()]
    angles = [degrees_of(cell) for cell in cells]
    bad = np.array([bool(cell) and angle is None for cell, angle in zip(cells, angles, strict=True)], dtype=bool)
    return pa.array(angles, pa.float64()), bad


def is_marked_angle(text: str) -> bool:
    """True if a text is an angle with the mark of degrees; without it, a time or date may look the same."""
    return _MARKED.search(text) is not None and degrees_of(text) is not None
