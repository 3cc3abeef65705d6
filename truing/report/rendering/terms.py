"""Tooltips: the first use of a glossary term in the table heads and captions of a section shows its meaning."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING

from truing.schemas.glossary import Term, glossary

if TYPE_CHECKING:
    from markupsafe import Markup

# Terms that pages also use in another sense, for which a tooltip would be wrong.
AMBIGUOUS = frozenset({"approach", "base", "drive", "evidence", "gain", "prior", "reading", "run", "slip", "verdict"})


def marked(text: str, used: set[str]) -> Markup:
    """Return the text as HTML: terms that are not in ``used`` become ``abbr`` with their meaning, and enter it."""
    from markupsafe import Markup, escape

    parts, end = [], 0
    for found in _pattern().finditer(text):
        term = _by_spelling()[found[0] if found["symbol"] else found["term"].lower()]
        if term.term in used:
            continue
        used.add(term.term)
        title = f"{term.term}: {term.meaning}" if found["symbol"] else term.meaning
        parts += [escape(text[end : found.start()]), Markup('<abbr title="{}">{}</abbr>').format(title, found[0])]
        end = found.end()
    return Markup("").join([*parts, escape(text[end:])])


def anchor(name: str, kind: str) -> str:
    """Return the id of the row that defines a name: ``check-time-gaps``."""
    return f"{kind}-{re.sub(r'[^a-z0-9]+', '-', name.lower())}"


def defined(cell: str, head: str, meanings: Mapping[tuple[str, str], str]) -> Markup | str:
    """Return a cell as a link to the row that defines what it names, with the sentence as tooltip, if there is one.

    ``head``: that of its column; words behind a comma are the subject.
    """
    name = cell.partition(",")[0]
    if (head, name) not in meanings:
        return cell
    from markupsafe import Markup

    link = '<a class="defined" href="#{}" title="{}">{}</a>'
    return Markup(link).format(anchor(name, head), meanings[head, name], cell)


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
    names = "|".join(re.escape(one) for one in spellings if one not in symbols)
    signs = "|".join(re.escape(one) for one in spellings if one in symbols)
    return re.compile(rf"^(?P<symbol>{signs})(?=$| \()|(?<![\w-])(?P<term>(?i:{names}))s?(?![\w-])")
