"""Reading of XML files, with the line of every element; documents that may expand without limit are refused."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

from truing.formats.raw import Unusable

Lines = dict[ElementTree.Element, int]

_LARGEST = 1 << 27
_DEEPEST = 100  # nesting levels; a project has about ten


def read_xml(path: Path) -> tuple[ElementTree.Element, Lines]:
    """Return the root of a document, and the line of every element; raises Unusable if the file is no plain XML.

    A document with declarations of its own may expand without limit, and is refused.
    """
    with path.open("rb") as stream:
        content = stream.read(_LARGEST + 1)
    if len(content) > _LARGEST or b"\0" in content or b"<!DOCTYPE" in content or b"<!ENTITY" in content:
        raise Unusable(f"XML of at most {_LARGEST >> 20} MB, in UTF-8 and without declarations")
    try:
        return _parsed(content)
    except (expat.ExpatError, ValueError, LookupError) as error:
        row = error.lineno if isinstance(error, expat.ExpatError) else None
        raise Unusable("an undamaged XML file", row=row, value=str(error)[:80]) from None


def _parsed(content: bytes) -> tuple[ElementTree.Element, Lines]:
    """Return a document, and the line of every element, from 1; raises ExpatError for damaged XML."""
    parser, builder = expat.ParserCreate(), ElementTree.TreeBuilder()
    lines: Lines = {}
    depth = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > _DEEPEST:  # deeper trees would overflow the stack when walked or freed
            raise Unusable(f"XML nested at most {_DEEPEST} deep", row=parser.CurrentLineNumber, value=f"<{tag}>"[:80])
        lines[builder.start(tag, attributes)] = parser.CurrentLineNumber

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    parser.Parse(content, True)
    return builder.close(), lines
