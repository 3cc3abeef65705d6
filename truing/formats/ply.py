"""PLY: its head, and the vertices of binary files.

Source: G. Turk, "The PLY Polygon File Format", 1994.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from truing.formats.cloud_layout import CloudLayout, Element, ListProperty, announced, head_lines, record_of
from truing.formats.raw import Unusable

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
_FORMS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
_PASSED_OVER = ("comment", "obj_info")
_WHOLE = "a whole PLY file"
_LINE_ENDS = b"\r\n"


def ply_layout(path: Path) -> CloudLayout:
    """What the head of a PLY file announces; raises Unusable where it is damaged or announces no vertices."""
    lines = head_lines(path)
    if not lines or lines[0][0] != ["ply"]:
        raise Unusable(f"{_WHOLE}, whose first line is ply", row=1)
    form, elements = "", list[Element]()
    for line, (words, stop) in enumerate(lines[1:], start=2):
        if words == ["end_header"]:
            return _layout(form, elements, stop, line)
        if words[:1] == ["format"] and words[1:2] and words[1] in _FORMS and words[2:] == ["1.0"] and not form:
            form = words[1]
        elif words[:1] == ["element"] and len(words) == 3 and form:
            elements.append(Element(words[1], announced(words[2:], "PLY", line), ()))
        elif words[:1] == ["property"] and elements:
            elements[-1] = _with_property(elements[-1], words[1:], _FORMS[form], line)
        elif words and words[0] not in _PASSED_OVER:
            raise Unusable(f"{_WHOLE}; this line of its head means nothing", row=line, value=" ".join(words)[:40])
    raise Unusable(f"{_WHOLE}, whose head ends with end_header")


def _with_property(element: Element, words: list[str], order: str, line: int) -> Element:
    added: tuple[str, np.dtype] | ListProperty
    if len(words) == 4 and words[0] == "list" and {*words[1:3]} <= _TYPES.keys() and _TYPES[words[1]][0] != "f":
        count, item = (np.dtype(order + _TYPES[name]) for name in words[1:3])
        added = ListProperty(words[3], count, item)
    elif len(words) == 2 and words[0] in _TYPES:
        added = (words[1], np.dtype(order + _TYPES[words[0]]))
    else:
        expected = f"{_WHOLE}: a property with one of the types {', '.join(_TYPES)}"
        raise Unusable(expected, row=line, value=" ".join(words)[:40])
    return Element(element.name, element.count, (*element.properties, added))


def _layout(form: str, elements: list[Element], begin: int, lines: int) -> CloudLayout:
    places = [i for i, element in enumerate(elements) if element.name == "vertex"]
    if len(places) != 1 or not elements[places[0]].properties or not elements[places[0]].count:
        raise Unusable("a whole PLY file with points: one element vertex with properties, and at least one of it")
    at = places[0]
    vertex = elements[at]
    scalars = [(part[0], part[1], 1) for part in vertex.properties if not isinstance(part, ListProperty)]
    if len(scalars) < len(vertex.properties):
        raise Unusable("a PLY file whose vertices have single numbers as properties, no lists")
    kind = "ascii" if form == "ascii" else "binary"
    record = record_of(scalars, "PLY")
    before, after = tuple(elements[:at]), tuple(elements[at + 1 :])
    return CloudLayout("PLY", kind, record, vertex.count, begin, lines, before, after)


def ply_vertices(layout: CloudLayout, data: NDArray[np.uint8]) -> NDArray[np.void]:
    """The vertices of a binary file; raises Unusable where it holds fewer or more bytes than its head announces."""
    begin = _passed(layout.before, data, layout.begin, layout.points)
    end = begin + layout.points * layout.record.itemsize
    if end > len(data):
        held = max(len(data) - begin, 0) // layout.record.itemsize
        raise Unusable(
            f"{_WHOLE}: {layout.points} vertices, as its head announces: export it anew", value=f"{held} vertices"
        )
    rest = data[_passed(layout.after, data, end, layout.points) :]
    if rest[:3].tobytes().strip(_LINE_ENDS):
        raise Unusable(f"{_WHOLE}, which ends where its head says", value=f"{len(rest)} more bytes")
    return data[begin:end].view(layout.record)


def _passed(elements: Sequence[Element], data: NDArray[np.uint8], at: int, vertices: int) -> int:
    """The byte behind elements of a binary file."""
    for element in elements:
        if element.record is not None:
            at += element.count * element.record.itemsize
        else:
            at = _passed_lists(element, data, at, vertices)
        if at > len(data):
            raise _fewer(element)
    return at


def _passed_lists(element: Element, data: NDArray[np.uint8], at: int, vertices: int) -> int:
    """The byte behind elements with lists: all at once where they are equally long, else one by one."""
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


def _record_end(element: Element, data: NDArray[np.uint8], at: int, vertices: int) -> int:
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


def _check_corners(element: Element, part: ListProperty, items: NDArray, vertices: int) -> None:
    """Refuse faces without corners, or with such as are no vertices: where they stand, something else does."""
    if element.names_corners(part) and not (items.size and items.min() >= 0 and items.max() < vertices):
        raise Unusable(f"{_WHOLE}: faces with corners among its {vertices} vertices, where its head says that they are")


def _fewer(element: Element) -> Unusable:
    return Unusable(f"{_WHOLE}: {element.count} of {element.name}, as its head announces")
