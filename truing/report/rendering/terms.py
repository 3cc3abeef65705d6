"""Explanations on the page: heads, names in cells, and the first use of a term, with a tooltip and a link."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING

from truing.report.column_heads import meaning_of
from truing.schemas.glossary import Term, glossary

if TYPE_CHECKING:
    from markupsafe import Markup

# Terms that pages also use in another sense, for which a tooltip would be wrong.
AMBIGUOUS = frozenset({"approach", "base", "drive", "evidence", "gain", "prior", "reading", "run", "slip", "verdict"})
_LONGEST = 40  # characters of an id
COLUMN, TERM = "column", "term"  # kinds of rows of the reference, besides check and cause


@dataclass(frozen=True)
class Meanings:
    """Ids of the rows that explain something, with their sentence: by kind and name, and of columns by sentence."""

    by_name: Mapping[tuple[str, str], tuple[str, str]] = field(default_factory=dict)
    columns: Mapping[str, str] = field(default_factory=dict)


NO_MEANINGS = Meanings()


def marked(text: str, used: set[str], meanings: Meanings = NO_MEANINGS) -> Markup:
    """Return the text as HTML with a tooltip on each term that is not in ``used``; the term is then added to ``used``.

    A term with a row in the reference is a link to it. Any other term can be focused with the keyboard.
    """
    from markupsafe import Markup, escape

    parts, end = [], 0
    for match in _pattern().finditer(text):
        term = _by_spelling()[match[0] if match["symbol"] else match["term"].lower()]
        if term.term in used:
            continue
        used.add(term.term)
        title = f"{term.term}: {term.meaning}" if match["symbol"] else term.meaning
        anchor, _ = meanings.by_name.get((TERM, term.term), ("", ""))
        link = '<a class="defined" href="#{2}" title="{0}">{1}</a>' if anchor else _WITHOUT_ROW
        parts += [escape(text[end : match.start()]), Markup(link).format(title, match[0], anchor)]
        end = match.end()
    return Markup("").join([*parts, escape(text[end:])])


_WITHOUT_ROW = '<abbr tabindex="0" title="{0}">{1}</abbr>'


def anchors(rows: Sequence[tuple[str, ...]], kind: str) -> tuple[str, ...]:
    """Return an id for each row that explains its first cell, all different: ``check-time-gaps``."""
    seen: Counter[str] = Counter()
    ids = []
    for row in rows:
        name = f"{kind}-{re.sub(r'[^a-z0-9]+', '-', row[0].lower()).strip('-')[:_LONGEST]}"
        seen[name] += 1
        ids.append(name if seen[name] == 1 else f"{name}-{seen[name]}")
    return tuple(ids)


def defined(cell: str, head: str, meanings: Meanings) -> Markup | str:
    """Return a cell as a link to the row that defines its name, with the sentence as tooltip, if there is one.

    ``head``: that of its column.
    """
    anchor, meaning = meanings.by_name.get(
        (head, known_name(cell, lambda name: (head, name) in meanings.by_name)), ("", "")
    )
    return _link(cell, anchor, meaning) if anchor else cell


def known_name(cell: str, is_known: Callable[[str], bool]) -> str:
    """Return the known name with which a cell begins; empty if it begins with none.

    Words behind a comma or in brackets are the subject: ``creep (load fz)``. Words behind *of* may be inputs:
    ``nonparametric effect of time``.
    """
    name = cell.partition(",")[0]
    name = name if is_known(name) else name.partition(" (")[0]
    while name and not is_known(name):
        name = name.rpartition(" of ")[0]
    return name


def explained(head: str, meanings: Meanings) -> Markup | str:
    """Return a head as a link to the row of its column, with the sentence as tooltip, if it has one."""
    anchor = meanings.columns.get(meaning := meaning_of(head), "")
    return _link(head, anchor, meaning) if anchor else head


def _link(text: str, anchor: str, meaning: str) -> Markup:
    from markupsafe import Markup

    return Markup('<a class="defined" href="#{}" title="{}">{}</a>').format(anchor, meaning, text)


@cache
def _by_spelling() -> dict[str, Term]:
    """Terms by name, by plural where it is irregular, and by symbol, where only one term has it."""
    terms = [term for term in glossary() if term.term not in AMBIGUOUS]
    symbols = [term.symbol for term in terms]
    named = {term.term.lower(): term for term in terms}
    plural = {f"{name[:-1]}ies": term for name, term in named.items() if name.endswith("y")}
    return {term.symbol: term for term in terms if symbols.count(term.symbol) == 1} | plural | named


@cache
def _pattern() -> re.Pattern[str]:
    """Any term as a word of its own, the longest first; a symbol only where a head begins with it and has no more."""
    spellings = sorted(_by_spelling(), key=len, reverse=True)
    symbols = {term.symbol for term in glossary()}
    names = "|".join(re.escape(spelling) for spelling in spellings if spelling not in symbols)
    signs = "|".join(re.escape(spelling) for spelling in spellings if spelling in symbols)
    return re.compile(rf"^(?P<symbol>{signs})(?=$| \()|(?<![\w-])(?P<term>(?i:{names}))s?(?![\w-])")
