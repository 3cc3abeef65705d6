"""Symbols that a page holds in equations, as Greek letters or in a range such as K11 .. K66, as words of its search."""

from __future__ import annotations

import re
import unicodedata
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx

_OF_EQUATIONS = re.compile(
    r"(?:\\(?:hat|bar|tilde|dot|vec|mathbf|mathrm|mathit|boldsymbol)\b)?\{?\\?(?P<base>[A-Za-z]+)\}?"
)
_INDEX = re.compile(r"_(?:\{(?:\\(?:mathrm|text)\{)?(?P<long>[A-Za-z0-9]+)\}*|(?P<short>[A-Za-z0-9]))")
_RANGE = re.compile(
    r"(?<![\w.])(?P<head>[A-Za-z]\w*?)(?P<first>\d{1,2})(?P<tail>_[a-z]+)?[ `]*(?:\.\.|…|to)[ `]*"
    r"(?P=head)(?P<last>\d{1,2})(?(tail)(?P=tail))(?![\w.])"
)
_MATH = (nodes.math, nodes.math_block)


def symbols_of(doctree: nodes.document) -> list[str]:
    """The symbols of a page that its own words do not spell, in order of the alphabet."""
    found: set[str] = set()
    for node in doctree.findall(nodes.Text):
        if isinstance(node.parent, _MATH):
            found |= _of_equation(node.astext())
    text = doctree.astext()
    found |= {name for match in _RANGE.finditer(text) for name in _members(match)}
    greek = {letter for letter in text if "GREEK" in unicodedata.name(letter, "")}
    found |= {unicodedata.name(letter).rsplit(" ", 1)[-1].lower() for letter in greek if letter.isalpha()}
    return sorted(name for name in found if "," not in name)


def _of_equation(tex: str) -> set[str]:
    """Names with their index in one word, with and without an underscore: ``K_{22}`` is K22 and K_22."""
    found = set[str]()
    for match in _OF_EQUATIONS.finditer(tex):
        found.add(match["base"])
        if index := _INDEX.match(tex, match.end()):
            end = index["long"] or index["short"]
            found |= {f"{match['base']}{end}", f"{match['base']}_{end}"}
    return found


def _members(match: re.Match[str]) -> list[str]:
    """Names of a range; both digits of the entries of a matrix count from that of the first."""
    first, last, tail = match["first"], match["last"], match["tail"] or ""
    if len(first) == len(last) == 2 and first[0] == first[1] and last[0] == last[1]:
        counted = range(int(first[0]), int(last[0]) + 1)
        return [f"{match['head']}{row}{column}{tail}" for row in counted for column in counted]
    return [f"{match['head']}{number}{tail}" for number in range(int(first), int(last) + 1)]


def _add_words(app: Sphinx, doctree: nodes.document) -> None:
    if words := symbols_of(doctree):
        doctree.append(nodes.meta(name="keywords", content=", ".join(words)))


def setup(app: Sphinx) -> dict[str, Any]:
    """Add the symbols to each page when it has been read."""
    app.connect("doctree-read", _add_words)
    return {"parallel_read_safe": True, "parallel_write_safe": True, "version": "1"}
