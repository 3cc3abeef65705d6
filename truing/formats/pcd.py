"""PCD: its head, and the points of binary files.

Source: Point Cloud Library, "The PCD (Point Cloud Data) file format"; compression: M. Lehmann, LibLZF.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from truing.formats.cloud_layout import CloudLayout, announced, head_lines, record_of
from truing.formats.raw import Unusable

_KEYS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
_FORMS = ("ascii", "binary", "binary_compressed")
_SIZES = {"F": ("4", "8"), "I": ("1", "2", "4", "8"), "U": ("1", "2", "4", "8")}
_WHOLE = "a whole PCD file"
_LARGEST_RATIO = 100  # LZF makes 3 bytes of 264 at best
_MOST_PER_POINT = 1 << 16


def pcd_layout(path: Path) -> CloudLayout:
    """What the head of a PCD file announces; raises Unusable where its lines are damaged or contradict each other."""
    told: dict[str, tuple[int, list[str]]] = {}
    for line, (words, stop) in enumerate(head_lines(path), start=1):
        if not words or words[0].startswith("#"):
            continue
        if words[0] not in _KEYS or words[0] in told:
            raise Unusable(f"{_WHOLE}; this line of its head means nothing", row=line, value=" ".join(words)[:40])
        told[words[0]] = (line, words[1:])
        if words[0] == "DATA":
            return _layout(told, stop, line)
    raise Unusable(f"{_WHOLE}, whose head ends with DATA")


def _layout(told: dict[str, tuple[int, list[str]]], begin: int, lines: int) -> CloudLayout:
    form = told["DATA"][1]
    if len(form) != 1 or form[0] not in _FORMS:
        raise Unusable(f"{_WHOLE}: DATA {', '.join(_FORMS)}", row=lines, value=" ".join(form)[:40])
    for key in ("FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT"):
        if key not in told:
            raise Unusable(f"{_WHOLE}, whose head has a line {key}")
    width, height = (announced(told[key][1], "PCD", told[key][0]) for key in ("WIDTH", "HEIGHT"))
    points = announced(told["POINTS"][1], "PCD", told["POINTS"][0]) if "POINTS" in told else width * height
    if points != width * height:
        raise Unusable(f"{_WHOLE}: as many POINTS as WIDTH times HEIGHT, {width * height}", value=str(points))
    if not points:
        raise Unusable("a whole PCD file with points", value="0 points")
    return CloudLayout("PCD", form[0], _record(told), points, begin, lines)


def _record(told: dict[str, tuple[int, list[str]]]) -> np.dtype:
    names = told["FIELDS"][1]
    counts = told["COUNT"][1] if "COUNT" in told else ["1"] * len(names)
    columns = {"SIZE": told["SIZE"][1], "TYPE": told["TYPE"][1], "COUNT": counts}
    for key, words in columns.items():
        if len(words) != len(names) or not names:
            raise Unusable(f"{_WHOLE}: as many of {key} as of FIELDS, {len(names)}", value=str(len(words)))
    fields = []
    for name, size, kind, count in zip(names, *columns.values(), strict=True):
        if size not in _SIZES.get(kind, ()):
            raise Unusable(f"{_WHOLE}: types F of 4 or 8 bytes, I or U of 1, 2, 4 or 8", value=f"{kind} {size}"[:40])
        number = announced([count], "PCD", told["COUNT"][0] if "COUNT" in told else told["FIELDS"][0])
        if not 1 <= number <= _MOST_PER_POINT:
            raise Unusable(f"{_WHOLE}: a COUNT of 1 to {_MOST_PER_POINT}", value=count[:40])
        fields.append((name, np.dtype(f"<{kind.lower()}{size}"), number))
    return record_of(fields, "PCD")


def pcd_points(layout: CloudLayout, data: NDArray[np.uint8]) -> NDArray[np.void]:
    """The points of a binary file; raises Unusable where it holds fewer or more bytes than its head announces."""
    held = data[layout.begin :]
    if layout.form == "binary_compressed":
        return _by_fields(layout, _decompressed(layout, held))
    size = layout.points * layout.record.itemsize
    if len(held) < size:
        expected = f"{_WHOLE}: {layout.points} points, as its head announces: export it anew"
        raise Unusable(expected, value=f"{len(held) // layout.record.itemsize} points")
    _refuse_more(held[size:])
    return held[:size].view(layout.record)


def _refuse_more(rest: NDArray[np.uint8]) -> None:
    """Refuse what follows the points; zeros fill a page of memory up, and mean nothing."""
    if rest.any() and rest.tobytes()[:3].strip(b"\r\n"):
        raise Unusable(f"{_WHOLE}, which ends where its head says", value=f"{len(rest)} more bytes")


def _decompressed(layout: CloudLayout, held: NDArray[np.uint8]) -> NDArray[np.uint8]:
    if len(held) < 8:
        raise Unusable(f"{_WHOLE}; this one ends behind its head")
    packed, size = (int(number) for number in held[:8].view("<u4"))
    if size != layout.points * layout.record.itemsize:
        expected = (
            f"{_WHOLE}: {layout.points * layout.record.itemsize} bytes of points, as its head announces: export it anew"
        )
        raise Unusable(expected, value=f"{size} bytes")
    if packed > len(held) - 8 or size > _LARGEST_RATIO * packed:
        raise Unusable(f"{_WHOLE}: {packed} bytes of compressed points", value=f"{len(held) - 8} bytes")
    _refuse_more(held[8 + packed :])
    plain = lzf_decompressed(held[8 : 8 + packed].tobytes(), size)
    if plain is None:
        raise Unusable(f"{_WHOLE}; its compressed points are damaged")
    return np.frombuffer(plain, dtype=np.uint8)


def _by_fields(layout: CloudLayout, plain: NDArray[np.uint8]) -> NDArray[np.void]:
    """Points from compressed data, in which all values of a field stand before those of the next."""
    records = np.empty(layout.points, dtype=layout.record)
    at = 0
    for name in layout.record.names or ():
        kind = layout.record[name]
        stop = at + layout.points * kind.itemsize
        records[name] = plain[at:stop].view(kind.base).reshape(layout.points, *kind.shape)
        at = stop
    return records


def lzf_decompressed(data: bytes, size: int) -> bytes | None:
    """Return the ``size`` bytes that LZF data stand for; None where the data are damaged."""
    out, at = bytearray(), 0
    try:
        while at < len(data) and len(out) <= size:
            control = data[at]
            at += 1
            if control < 32:  # so many bytes, less one, as they are
                out += data[at : at + control + 1]
                at += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += data[at]
                at += 1
            back = ((control & 31) << 8 | data[at]) + 1
            at += 1
            start, length = len(out) - back, length + 2
            if start < 0:
                return None
            again = out[start : start + length]  # shorter where it reaches into what it makes
            out += (again * (length // len(again) + 1))[:length]
    except IndexError:
        return None
    return bytes(out) if len(out) == size and at == len(data) else None
