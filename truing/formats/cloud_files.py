"""Files of point clouds, PLY and PCD: headers, and points of binary files.

Sources: G. Turk, "The PLY Polygon File Format", 1994; Point Cloud Library, "The PCD (Point Cloud Data) file format";
its compression: M. Lehmann, LibLZF.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from truing.formats.raw import Unusable

LONGEST_HEAD = 1 << 16
_MOST_DIGITS = 18  # a number with more digits is larger than any file
_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_PLY_FORMS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
_PASSED_OVER = ("comment", "obj_info")
_WHOLE_PLY = "an undamaged PLY file"
_LINE_ENDS = b"\r\n"
_KEYS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
_PCD_FORMS = ("ascii", "binary", "binary_compressed")
_SIZES = {"F": ("4", "8"), "I": ("1", "2", "4", "8"), "U": ("1", "2", "4", "8")}
_WHOLE_PCD = "an undamaged PCD file"
_LARGEST_RATIO = 100  # LZF expands 3 bytes to at most 264
_MOST_PER_POINT = 1 << 16


@dataclass(frozen=True)
class ListProperty:
    """A list property of a PLY element: types of its count and of its values."""

    name: str
    count: np.dtype
    item: np.dtype


@dataclass(frozen=True)
class PlyElement:
    """An element of a PLY file, such as vertices or faces, with its properties by name and type."""

    name: str
    count: int
    properties: tuple[tuple[str, np.dtype] | ListProperty, ...]

    def fits(self, words: list[bytes], vertices: int) -> bool:
        """True if the words of a line of text can be an element; corners of faces are vertex numbers."""
        at = 0
        for part in self.properties:
            is_list = isinstance(part, ListProperty)
            count = _counted(words[at : at + 1]) if is_list else 1
            at += is_list
            if count is None or at + count > len(words):
                return False
            if is_list and self.names_corners(part) and not _are_corners(words[at : at + count], vertices):
                return False
            at += count
        return at == len(words)

    def names_corners(self, part: object) -> bool:
        """True if a property holds the vertices of a face."""
        return (
            self.name == "face" and isinstance(part, ListProperty) and part.name in ("vertex_indices", "vertex_index")
        )

    @property
    def record(self) -> np.dtype | None:
        """Type of one element in a binary file; None if lists make the sizes differ."""
        scalars = [part for part in self.properties if not isinstance(part, ListProperty)]
        return np.dtype(scalars) if len(scalars) == len(self.properties) else None


def _counted(words: list[bytes]) -> int | None:
    return int(words[0]) if words and words[0].isdigit() and len(words[0]) <= _MOST_DIGITS else None


def _are_corners(words: list[bytes], vertices: int) -> bool:
    numbers = [_counted([word]) for word in words]
    return bool(numbers) and all(number is not None and number < vertices for number in numbers)


@dataclass(frozen=True)
class CloudLayout:
    """Content of a header.

    ``form``: ascii, binary or binary_compressed; ``record``: type of one point; ``begin`` and ``lines``: bytes and
    lines of the header; ``before`` and ``after``: other elements of a PLY file before and after the points.
    """

    kind: str
    form: str
    record: np.dtype
    points: int
    begin: int
    lines: int
    before: tuple[PlyElement, ...] = ()
    after: tuple[PlyElement, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """A name for each number of a point; numbers of a field with several are counted from 0."""
        column_names: list[str] = []
        for name in self.record.names or ():
            width = int(np.prod(self.record[name].shape, dtype=int))
            column_names += [name] if not self.record[name].shape else [f"{name}[{i}]" for i in range(width)]
        return tuple(column_names)

    def columns(self, records: NDArray[np.void]) -> list[NDArray]:
        """Return the points' numbers, one array per name in ``names``: integers as int64, others as float64."""
        singles: list[NDArray] = []
        for name in self.record.names or ():
            values = records[name].reshape(len(records), -1)
            singles += [_plain(values[:, i]) for i in range(values.shape[1])]
        return singles


def _plain(values: NDArray) -> NDArray:
    is_whole_number = values.dtype.kind in "iu" and values.dtype.str[1:] != "u8"  # uint64 exceeds int64
    return np.ascontiguousarray(values, dtype=np.int64 if is_whole_number else np.float64)


def head_lines(path: Path) -> list[tuple[list[str], int]]:
    """Yield the words of a file's first lines, each with the byte at which the next line begins.

    All lines end like the first one, since binary data after the header may contain any byte.
    """
    with path.open("rb") as file:
        head = file.read(LONGEST_HEAD)
    first = min((at for at in (head.find(b"\n"), head.find(b"\r")) if at >= 0), default=len(head))
    end = b"\r\n" if head[first : first + 2] == b"\r\n" else head[first : first + 1] or b"\n"
    lines, at = [], 0
    while (stop := head.find(end, at)) >= 0:
        lines.append((head[at:stop].decode("latin-1").split(), stop + len(end)))
        at = stop + len(end)
    return lines


def announced_number(words: list[str], kind: str, line: int) -> int:
    """Return the only number of a header line; raises Unusable without one."""
    if len(words) != 1 or not words[0].isascii() or not words[0].isdigit():
        raise Unusable(f"an undamaged {kind} file, which announces a number here", row=line, value=" ".join(words)[:40])
    return int(words[0][:_MOST_DIGITS])


def record_of(fields: list[tuple[str, np.dtype, int]], kind: str) -> np.dtype:
    """Return the type of one point from names, types and counts; raises Unusable for a duplicate name."""
    names = [name for name, _, _ in fields]
    twice = {name for name in names if names.count(name) > 1} - {"_"}  # PCD's name for padding bytes
    if twice:
        raise Unusable(f"an undamaged {kind} file, in which every field has a name of its own", value=sorted(twice)[0])
    titled = [(f"_{i}" if name == "_" else name, *rest) for i, (name, *rest) in enumerate(fields)]
    return np.dtype([(name, one) if count == 1 else (name, one, (count,)) for name, one, count in titled])


def ply_layout(path: Path) -> CloudLayout:
    """Return the header of a PLY file; raises Unusable if it is damaged or announces no vertices."""
    lines = head_lines(path)
    if not lines or lines[0][0] != ["ply"]:
        raise Unusable(f"{_WHOLE_PLY}, whose first line is ply", row=1)
    form, elements = "", list[PlyElement]()
    for line, (words, stop) in enumerate(lines[1:], start=2):
        if words == ["end_header"]:
            return _layout_of_ply(form, elements, stop, line)
        if words[:1] == ["format"] and words[1:2] and words[1] in _PLY_FORMS and words[2:] == ["1.0"] and not form:
            form = words[1]
        elif words[:1] == ["element"] and len(words) == 3 and form:
            elements.append(PlyElement(words[1], announced_number(words[2:], "PLY", line), ()))
        elif words[:1] == ["property"] and elements:
            elements[-1] = _with_property(elements[-1], words[1:], _PLY_FORMS[form], line)
        elif words and words[0] not in _PASSED_OVER:
            raise Unusable(f"{_WHOLE_PLY}; this line of its header is not valid", row=line, value=" ".join(words)[:40])
    raise Unusable(f"{_WHOLE_PLY}, whose header ends with end_header")


def _with_property(element: PlyElement, words: list[str], order: str, line: int) -> PlyElement:
    added: tuple[str, np.dtype] | ListProperty
    if len(words) == 4 and words[0] == "list" and {*words[1:3]} <= _TYPES.keys() and _TYPES[words[1]][0] != "f":
        count, item = (np.dtype(order + _TYPES[name]) for name in words[1:3])
        added = ListProperty(words[3], count, item)
    elif len(words) == 2 and words[0] in _TYPES:
        added = (words[1], np.dtype(order + _TYPES[words[0]]))
    else:
        expected = f"{_WHOLE_PLY}: a property with one of the types {', '.join(_TYPES)}"
        raise Unusable(expected, row=line, value=" ".join(words)[:40])
    return PlyElement(element.name, element.count, (*element.properties, added))


def _layout_of_ply(form: str, elements: list[PlyElement], begin: int, lines: int) -> CloudLayout:
    indices = [i for i, element in enumerate(elements) if element.name == "vertex"]
    if len(indices) != 1 or not elements[indices[0]].properties or not elements[indices[0]].count:
        raise Unusable("an undamaged PLY file with points: one element vertex with properties, and at least one of it")
    at = indices[0]
    vertex = elements[at]
    scalars = [(part[0], part[1], 1) for part in vertex.properties if not isinstance(part, ListProperty)]
    if len(scalars) < len(vertex.properties):
        raise Unusable("a PLY file whose vertices have single numbers as properties, no lists")
    kind = "ascii" if form == "ascii" else "binary"
    record = record_of(scalars, "PLY")
    before, after = tuple(elements[:at]), tuple(elements[at + 1 :])
    return CloudLayout("PLY", kind, record, vertex.count, begin, lines, before, after)


def ply_vertices(layout: CloudLayout, data: NDArray[np.uint8]) -> NDArray[np.void]:
    """Return the vertices of a binary file; raises Unusable if its size differs from the announced one."""
    begin = _byte_after(layout.before, data, layout.begin, layout.points)
    end = begin + layout.points * layout.record.itemsize
    if end > len(data):
        rows_in_file = max(len(data) - begin, 0) // layout.record.itemsize
        raise Unusable(
            f"{_WHOLE_PLY}: {layout.points} vertices, as its header announces: export it again",
            value=f"{rows_in_file} vertices",
        )
    trailing = data[_byte_after(layout.after, data, end, layout.points) :]
    if trailing[:3].tobytes().strip(_LINE_ENDS):
        raise Unusable(f"{_WHOLE_PLY}, which ends where its header says", value=f"{len(trailing)} more bytes")
    return data[begin:end].view(layout.record)


def _byte_after(elements: Sequence[PlyElement], data: NDArray[np.uint8], at: int, vertices: int) -> int:
    """Return the byte after some elements of a binary file."""
    for element in elements:
        if element.record is not None:
            at += element.count * element.record.itemsize
        else:
            at = _passed_lists(element, data, at, vertices)
        if at > len(data):
            raise _fewer(element)
    return at


def _passed_lists(element: PlyElement, data: NDArray[np.uint8], at: int, vertices: int) -> int:
    """Return the byte after elements with lists: at once for equal lengths, else one by one."""
    if not element.count:
        return at
    stride = _record_end(element, data, at, vertices) - at
    stop = at + element.count * stride
    only = element.properties[0]
    if len(element.properties) == 1 and isinstance(only, ListProperty) and stop <= len(data):
        records = data[at:stop].reshape(element.count, stride)
        counts = records[:, : only.count.itemsize]
        if (counts == counts[0]).all():
            items = np.ascontiguousarray(records[:, only.count.itemsize :]).reshape(-1).view(only.item)
            _check_corners(element, only, items, vertices)
            return stop
    for _ in range(element.count):
        at = _record_end(element, data, at, vertices)
    return at


def _record_end(element: PlyElement, data: NDArray[np.uint8], at: int, vertices: int) -> int:
    for part in element.properties:
        if not isinstance(part, ListProperty):
            at += part[1].itemsize
            continue
        first = at + part.count.itemsize
        if first > len(data):
            raise _fewer(element)
        count = int(data[at:first].view(part.count)[0])
        at = first + count * part.item.itemsize
        if count < 0 or at > len(data):
            raise _fewer(element)
        _check_corners(element, part, data[first:at].view(part.item), vertices)
    return at


def _check_corners(element: PlyElement, part: ListProperty, items: NDArray, vertices: int) -> None:
    """Refuse faces without corners, or with corners that are no vertices: such data are something else."""
    if element.names_corners(part) and not (items.size and items.min() >= 0 and items.max() < vertices):
        raise Unusable(
            f"{_WHOLE_PLY}: faces with corners among its {vertices} vertices, at the place given by its header"
        )


def _fewer(element: PlyElement) -> Unusable:
    return Unusable(f"{_WHOLE_PLY}: {element.count} of {element.name}, as its header announces")


def pcd_layout(path: Path) -> CloudLayout:
    """Return the header of a PCD file; raises Unusable if its lines are damaged or inconsistent."""
    reported: dict[str, tuple[int, list[str]]] = {}
    for line, (words, stop) in enumerate(head_lines(path), start=1):
        if not words or words[0].startswith("#"):
            continue
        if words[0] not in _KEYS or words[0] in reported:
            raise Unusable(f"{_WHOLE_PCD}; this line of its header is not valid", row=line, value=" ".join(words)[:40])
        reported[words[0]] = (line, words[1:])
        if words[0] == "DATA":
            return _layout_of_pcd(reported, stop, line)
    raise Unusable(f"{_WHOLE_PCD}, whose header ends with DATA")


def _layout_of_pcd(reported: dict[str, tuple[int, list[str]]], begin: int, lines: int) -> CloudLayout:
    form = reported["DATA"][1]
    if len(form) != 1 or form[0] not in _PCD_FORMS:
        raise Unusable(f"{_WHOLE_PCD}: DATA {', '.join(_PCD_FORMS)}", row=lines, value=" ".join(form)[:40])
    for key in ("FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT"):
        if key not in reported:
            raise Unusable(f"{_WHOLE_PCD}, whose header has a line {key}")
    width, height = (announced_number(reported[key][1], "PCD", reported[key][0]) for key in ("WIDTH", "HEIGHT"))
    points = (
        announced_number(reported["POINTS"][1], "PCD", reported["POINTS"][0])
        if "POINTS" in reported
        else width * height
    )
    if points != width * height:
        raise Unusable(f"{_WHOLE_PCD}: as many POINTS as WIDTH times HEIGHT, {width * height}", value=str(points))
    if not points:
        raise Unusable("an undamaged PCD file with points", value="0 points")
    return CloudLayout("PCD", form[0], _record(reported), points, begin, lines)


def _record(reported: dict[str, tuple[int, list[str]]]) -> np.dtype:
    names = reported["FIELDS"][1]
    counts = reported["COUNT"][1] if "COUNT" in reported else ["1"] * len(names)
    columns = {"SIZE": reported["SIZE"][1], "TYPE": reported["TYPE"][1], "COUNT": counts}
    for key, words in columns.items():
        if len(words) != len(names) or not names:
            raise Unusable(f"{_WHOLE_PCD}: as many of {key} as of FIELDS, {len(names)}", value=str(len(words)))
    fields = []
    for name, size, kind, count in zip(names, *columns.values(), strict=True):
        if size not in _SIZES.get(kind, ()):
            raise Unusable(
                f"{_WHOLE_PCD}: types F of 4 or 8 bytes, I or U of 1, 2, 4 or 8", value=f"{kind} {size}"[:40]
            )
        number = announced_number(
            [count], "PCD", reported["COUNT"][0] if "COUNT" in reported else reported["FIELDS"][0]
        )
        if not 1 <= number <= _MOST_PER_POINT:
            raise Unusable(f"{_WHOLE_PCD}: a COUNT of 1 to {_MOST_PER_POINT}", value=count[:40])
        fields.append((name, np.dtype(f"<{kind.lower()}{size}"), number))
    return record_of(fields, "PCD")


def pcd_points(layout: CloudLayout, data: NDArray[np.uint8]) -> NDArray[np.void]:
    """Return the points of a binary file; raises Unusable if its size differs from the announced one."""
    compressed = data[layout.begin :]
    if layout.form == "binary_compressed":
        return _decompress_by_fields(layout, _decompressed(layout, compressed))
    size = layout.points * layout.record.itemsize
    if len(compressed) < size:
        expected = f"{_WHOLE_PCD}: {layout.points} points, as its header announces: export it again"
        raise Unusable(expected, value=f"{len(compressed) // layout.record.itemsize} points")
    _refuse_trailing_data(compressed[size:])
    return compressed[:size].view(layout.record)


def _refuse_trailing_data(trailing: NDArray[np.uint8]) -> None:
    """Refuse data after the points, except zeros, which pad a page of memory."""
    if trailing.any() and trailing.tobytes()[:3].strip(b"\r\n"):
        raise Unusable(f"{_WHOLE_PCD}, which ends where its header says", value=f"{len(trailing)} more bytes")


def _decompressed(layout: CloudLayout, compressed: NDArray[np.uint8]) -> NDArray[np.uint8]:
    if len(compressed) < 8:
        raise Unusable(f"{_WHOLE_PCD}; this one ends after its header")
    packed, size = (int(number) for number in compressed[:8].view("<u4"))
    if size != layout.points * layout.record.itemsize:
        announced_size = f"{layout.points * layout.record.itemsize} bytes of points, as its header announces"
        raise Unusable(f"{_WHOLE_PCD}: {announced_size}: export it again", value=f"{size} bytes")
    if packed > len(compressed) - 8 or size > _LARGEST_RATIO * packed:
        raise Unusable(f"{_WHOLE_PCD}: {packed} bytes of compressed points", value=f"{len(compressed) - 8} bytes")
    _refuse_trailing_data(compressed[8 + packed :])
    plain = lzf_decompressed(compressed[8 : 8 + packed].tobytes(), size)
    if plain is None:
        raise Unusable(f"{_WHOLE_PCD}; its compressed points are damaged")
    return np.frombuffer(plain, dtype=np.uint8)


def _decompress_by_fields(layout: CloudLayout, plain: NDArray[np.uint8]) -> NDArray[np.void]:
    """Return the points of compressed data, which are stored field by field."""
    records = np.empty(layout.points, dtype=layout.record)
    at = 0
    for name in layout.record.names or ():
        kind = layout.record[name]
        stop = at + layout.points * kind.itemsize
        records[name] = plain[at:stop].view(kind.base).reshape(layout.points, *kind.shape)
        at = stop
    return records


def lzf_decompressed(data: bytes, size: int) -> bytes | None:
    """Return the ``size`` bytes of decompressed LZF data; None if the data are damaged."""
    out, at = bytearray(), 0
    try:
        while at < len(data) and len(out) <= size:
            control = data[at]
            at += 1
            if control < 32:  # a literal run of control + 1 bytes
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
            again = out[start : start + length]  # shorter if it overlaps its own output
            out += (again * (length // len(again) + 1))[:length]
    except IndexError:
        return None
    return bytes(out) if len(out) == size and at == len(data) else None
