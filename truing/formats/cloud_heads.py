"""Heads of PLY and PCD, checked before Open3D reads them: damaged ones end its process, or take all memory."""

from __future__ import annotations

import re
from pathlib import Path

from truing.formats.raw import Unusable

_HEAD = 1 << 16
_DIGITS = 18  # a number of more is larger than any file
_POINTS_PER_BYTE = 100  # in PCD, whose compression makes equal points so small
_PLY_BYTES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "float", "int32", "uint32", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}
_PCD_SIZES = {"F": ("4", "8"), "I": ("1", "2", "4", "8"), "U": ("1", "2", "4", "8")}
_PER_FIELD = ("SIZE", "TYPE", "COUNT")


def check_cloud_head(path: Path) -> None:
    """Raise Unusable where a cloud's head is damaged, or announces more points than the file can hold."""
    ending = path.suffix.lower()
    with path.open("rb") as file:
        head = file.read(_HEAD)
    check = {".ply": _ply_points, ".pcd": _pcd_points}.get(ending)
    if check is None:
        return
    name, size = ending.removeprefix(".").upper(), path.stat().st_size
    least = check(head, f"a whole {name} file with points")
    if least > size:
        raise Unusable(f"a whole {name} file; this one announces more points than its size can hold")


def _ply_points(head: bytes, expected: str) -> int:
    """The bytes that the announced elements take at least."""
    begin, end, _ = head.partition(b"end_header")
    lines = [line.decode("latin-1").split() for line in re.split(rb"\r\n|\r|\n", begin)]
    if lines[0] != ["ply"] or not end:
        raise Unusable(expected)
    is_text = ["format", "ascii", "1.0"] in lines
    least, count, own = len(begin), 0, 0
    names: list[str] = []
    for words in (line for line in lines if line and line[0] in ("element", "property")):
        if words[0] == "element":
            least, own = least + count * own, 0
            count = _number(words[2:], expected)
            names.append(words[1])
        elif words[1:2] == ["list"] and len(words) == 5 and {*words[2:4]} <= _PLY_BYTES.keys():
            own += 1
        elif len(words) == 3 and words[1] in _PLY_BYTES and names:
            own += 1 if is_text else _PLY_BYTES[words[1]]
        else:
            raise Unusable(expected)
    if "vertex" not in names or not own:
        raise Unusable(expected)
    return least + count * own


def _pcd_points(head: bytes, expected: str) -> int:
    """The bytes that the announced points take at least; raises where the lines of the head contradict each other."""
    begin, data, _ = head.partition(b"\nDATA")
    lines = [line.decode("latin-1").split() for line in begin.splitlines() if line[:1].isalpha()]
    told = {words[0]: words[1:] for words in lines if words}
    fields = told.get("FIELDS", [])
    per_field = [told.get(name, ["1"] * len(fields)) for name in _PER_FIELD]
    if not data or not fields or len(told) < len(lines) or any(len(words) != len(fields) for words in per_field):
        raise Unusable(expected)
    for size, kind, count in zip(*per_field, strict=True):
        if size not in _PCD_SIZES.get(kind, ()) or not _number([count], expected):
            raise Unusable(expected)
    width, height = (_number(told.get(name, []), expected) for name in ("WIDTH", "HEIGHT"))
    points = _number(told.get("POINTS", [str(width * height)]), expected)
    if width * height != points:
        raise Unusable(expected)
    return points // _POINTS_PER_BYTE


def _number(words: list[str], expected: str) -> int:
    if len(words) != 1 or not words[0].isascii() or not words[0].isdigit():
        raise Unusable(expected)
    return int(words[0][:_DIGITS])
