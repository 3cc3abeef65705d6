"""Section of the page that defines its checks, causes and terms, one sentence each; cells and heads lead to it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import chain

from truing.report.page import Listing, ReportSection, all_of
from truing.report.rendering.terms import marked
from truing.report.wordings.catalogue import WORDINGS, cause_meaning, cause_words
from truing.schemas.glossary import glossary
from truing.schemas.quality_checks import CHECKS

_LEAD = "Checks, causes and terms of this page. docs/qa.md, docs/causes.md and docs/glossary.md say more of each."


def glossary_section(sections: Sequence[ReportSection], *, bench: bool = False) -> ReportSection | None:
    """Return the definitions of what the tables of the sections name; None where they name nothing of it.

    ``bench``: a check that both kinds of campaign have asks what it asks of a bench.
    """
    every = [listing for section in all_of(sections) for listing in section.listings]
    own = CHECKS["interferometer" if bench else "photogrammetry"]
    questions = {name: check.question for name, check in own.items()}
    meanings = {cause_words(cause): cause_meaning(cause) for cause in WORDINGS}
    terms = {term.term: term.meaning for term in glossary()}
    texts = chain.from_iterable((listing.caption, *listing.heads) for listing in every)
    listings = (
        _defined("check", "what it asks", questions, named_in(every, "check")),
        _defined("cause", "what it is", meanings, named_in(every, "cause")),
        _defined("term", "meaning", terms, _used_terms(texts)),
    )
    shown = tuple(listing for listing in listings if listing.rows)
    return ReportSection("glossary", "Glossary", _LEAD, listings=shown) if shown else None


def named_in(listings: Iterable[Listing], head: str) -> set[str]:
    """Return the kind of name in columns with this head: the words before a comma, behind which is the subject."""
    columns = ((listing, listing.heads.index(head)) for listing in listings if head in listing.heads)
    return {row[k].partition(",")[0] for listing, k in columns for row in listing.rows}


def _defined(kind: str, head: str, known: dict[str, str], used: set[str]) -> Listing:
    rows = tuple((name, known[name]) for name in sorted(used & known.keys()))
    return Listing((kind, head), rows, caption=f"{kind.capitalize()}s", anchor=kind)


def _used_terms(texts: Iterable[str]) -> set[str]:
    used: set[str] = set()
    for text in texts:
        marked(text, used)
    return used
