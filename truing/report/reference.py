"""Reference of a page: its columns and terms; cells, heads and captions lead to their rows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from truing.report.column_heads import Head, meaning_of
from truing.report.numbers import listed
from truing.report.page import Depth, Listing, ReportSection, all_of
from truing.report.rendering.terms import known_name, marked
from truing.schemas.glossary import glossary

_TITLE = "Reference"
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


def reference(
    sections: Sequence[ReportSection], known: Sequence[Listing] = (), above: Sequence[str] = ()
) -> ReportSection | None:
    """Return the explanations of the columns and terms of the sections; None where they have no column.

    ``known``: tables that explain other names of the sections; ``above``: captions before the first section.
    """
    every = [(section.title, listing) for section in all_of(sections) for listing in section.listings]
    titled = [(title, head) for title, listing in every for head in listing.heads]
    fixed_heads = [(_TITLE, head) for listing in known if listing.rows for head in listing.heads]
    fixed_heads += [(_TITLE, head) for heads in (_COLUMN_HEADS, _TERM_HEADS) for head in heads]
    columns = _columns([*titled, *fixed_heads])
    drawn = (caption for section in all_of(sections) for _, caption in section.figures)
    captions = [*above, *drawn, *(listing.caption for _, listing in every), *(row[1] for row in columns.rows)]
    terms = {term.term: (term.meaning, term.symbol, term.unit) for term in glossary()}
    listings = [*known, columns, defined("term", _TERM_HEADS, terms, _used_terms(captions))]
    shown = tuple(listing for listing in listings if listing.rows)
    *first, last = (listing.caption.lower() for listing in shown)
    lead = f"{' and '.join(filter(None, (', '.join(first), last))).capitalize()} of this page."
    return ReportSection("glossary", _TITLE, lead, listings=shown, depth=Depth.APPENDIX) if titled else None


def defined(kind: str, heads: tuple[Head, ...], known: Mapping[str, tuple[str, ...]], used: set[str]) -> Listing:
    """Return a row for each known name with which a used cell begins."""
    names = {known_name(cell, known.__contains__) for cell in used} - {""}
    rows = tuple((name, *known[name]) for name in sorted(names))
    return Listing(heads, rows, caption=_CAPTIONS[kind], anchor=kind)


_CAPTIONS = {"check": "Checks", "cause": "Causes", "class": "Error classes", "term": "Terms"}


def _columns(titled: Sequence[tuple[str, str]]) -> Listing:
    """Return a row per meaning of a head: its names, the sentence, and the sections in which it stands."""
    heads: dict[str, tuple[dict[str, None], dict[str, None]]] = {}
    for title, head in titled:
        if meaning := meaning_of(head):
            names, titles = heads.setdefault(meaning, ({}, {}))
            names[head] = titles[title] = None
    rows = ((listed([*map(str, names)]), meaning, listed([*titles], 6)) for meaning, (names, titles) in heads.items())
    ordered = tuple(sorted(rows, key=lambda row: row[0].lower()))
    return Listing(_COLUMN_HEADS, ordered, caption="Columns", anchor="column")


def _used_terms(texts: Iterable[str]) -> set[str]:
    used: set[str] = set()
    for text in texts:
        marked(text, used)
    return used
