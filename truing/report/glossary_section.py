"""Reference of the page: its checks, causes, columns and terms; cells, heads and captions lead to their rows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import chain

from truing.report.diagnosis.assessed_causes import NOISE_ALONE
from truing.report.heads import CAUSE, Head, meaning_of, schema_head
from truing.report.numbers import listed
from truing.report.page import Listing, ReportSection, all_of
from truing.report.rendering.terms import known_name, marked
from truing.report.wordings.catalogue import WORDINGS, cause_meaning, cause_words
from truing.report.wordings.error_classes import ERROR_CLASSES
from truing.schemas.glossary import glossary
from truing.schemas.quality_check import QualityCheck
from truing.schemas.quality_checks import checks_of

_TITLE = "Reference"
_LEAD = "Checks, causes, columns and terms of this page."
_ON_FIRST_SCREEN = ("rms", "noise floor")
_WHAT_IT_IS = Head("what it is", "Effect in general, without its size in this campaign.")
_CHECK_HEADS = (
    schema_head("check"),
    Head("what it asks", "Question of the check to the data."),
    Head("why", "Reason why the answer matters for the results."),
    Head("warns or fails", "Conditions of a warning and of a failure, by default; [qa.limits] may set other limits."),
    Head("what to do", "Remedy if the check warns or fails."),
)
_CAUSE_HEADS = (CAUSE, _WHAT_IT_IS, Head("id", "Name of the cause in campaign.toml and in the artifacts."))
_CLASS_HEADS = (Head("class", "Name of the error in laboratory terms."), Head("what it is", "Definition of the error."))
_COLUMN_HEADS = (
    Head("column", "Text above the column; columns with one meaning share a row."),
    Head("meaning", "What the column, or the term, says."),
    Head("sections", "Sections of this page with such a column."),
)
_TERM_HEADS = (
    Head("term", "Term of the glossary."),
    _COLUMN_HEADS[1],
    Head("symbol", "Symbol of the term in formulas."),
    Head("unit", "Unit of the quantity."),
)


def glossary_section(sections: Sequence[ReportSection], *, bench: bool = False) -> ReportSection | None:
    """Return the explanations of what the tables and captions of the sections name; None where they name nothing.

    ``bench``: a check that both kinds of campaign have asks what it asks of a bench.
    """
    every = [listing for section in all_of(sections) for listing in section.listings]
    checks = checks_of("interferometer" if bench else "photogrammetry")
    causes = {cause_words(cause): (cause_meaning(cause), cause) for cause in WORDINGS}
    causes |= {NOISE_ALONE: ("The measurements scatter otherwise than declared, without a mean effect.", "unexplained")}
    listings = [
        _defined(
            "check", _CHECK_HEADS, {name: _of_check(one) for name, one in checks.items()}, named_in(every, "check")
        ),
        _defined("cause", _CAUSE_HEADS, causes, named_in(every, "cause")),
        _defined(
            "class", _CLASS_HEADS, {name: (words,) for name, words in ERROR_CLASSES.items()}, named_in(every, "class")
        ),
    ]
    titled = [(section.title, head) for section in all_of(sections) for one in section.listings for head in one.heads]
    own = [(_TITLE, head) for listing in listings if listing.rows for head in listing.heads]
    own += [(_TITLE, head) for heads in (_COLUMN_HEADS, _TERM_HEADS) for head in heads]
    columns = _columns([*titled, *own])
    drawn = (caption for section in all_of(sections) for _, caption in section.figures)
    captions = [*_ON_FIRST_SCREEN, *drawn, *(one.caption for one in every), *(row[1] for row in columns.rows)]
    terms = {term.term: (term.meaning, term.symbol, term.unit) for term in glossary()}
    listings += [columns, _defined("term", _TERM_HEADS, terms, _used_terms(captions))]
    shown = tuple(listing for listing in listings if listing.rows)
    return ReportSection("glossary", _TITLE, _LEAD, listings=shown) if titled else None


def _of_check(check: QualityCheck) -> tuple[str, ...]:
    """Return question, reason, conditions and remedy of a check."""
    limits = (("warns", check.criterion.warns), ("fails", check.criterion.fails))
    of = getattr(check.criterion, "of", "")
    told = "; ".join(f"{verb}: {words}" for verb, words in limits if words)
    told = f"{of}: {told}" if of else told
    return tuple(words.replace("`", "") for words in (check.question, check.why, told, check.to_do))


def named_in(listings: Iterable[Listing], head: str) -> set[str]:
    """Return the cells of columns with this head."""
    columns = ((listing, listing.heads.index(head)) for listing in listings if head in listing.heads)
    return {row[k] for listing, k in columns for row in listing.rows}


def _defined(kind: str, heads: tuple[Head, ...], known: Mapping[str, tuple[str, ...]], used: set[str]) -> Listing:
    names = {known_name(cell, known.__contains__) for cell in used} - {""}
    rows = tuple((name, *known[name]) for name in sorted(names))
    return Listing(heads, rows, caption=_CAPTIONS[kind], anchor=kind)


_CAPTIONS = {"check": "Checks", "cause": "Causes", "class": "Error classes", "term": "Terms"}


def _columns(titled: Sequence[tuple[str, str]]) -> Listing:
    """Return a row per meaning of a head: its names, the sentence, and the sections in which it stands."""
    heads: dict[str, tuple[dict[str, None], dict[str, None]]] = {}
    for title, head in titled:
        if meaning := meaning_of(head):
            names, places = heads.setdefault(meaning, ({}, {}))
            names[head] = places[title] = None
    rows = ((listed([*map(str, names)]), meaning, listed([*places], 6)) for meaning, (names, places) in heads.items())
    ordered = tuple(sorted(rows, key=lambda row: row[0].lower()))
    return Listing(_COLUMN_HEADS, ordered, caption="Columns", anchor="column")


def _used_terms(texts: Iterable[str]) -> set[str]:
    used: set[str] = set()
    for text in chain(texts):
        marked(text, used)
    return used
