"""docs/glossary.md is what schemas/glossary.csv says, and every page and module that it names exists."""

from __future__ import annotations

import importlib.util

from tests.conftest import PROJECT
from truing.schemas.glossary import glossary, glossary_page


def test_the_page_is_written_from_the_table() -> None:
    page = PROJECT / "docs" / "glossary.md"
    assert page.read_text(encoding="utf-8") == glossary_page(), "run `python -m schemas`"


def test_terms_are_unique_and_in_alphabetical_order() -> None:
    terms = [entry.term.lower() for entry in glossary()]
    assert terms == sorted(set(terms))
    assert len(terms) > 50


def test_every_page_and_module_exists() -> None:
    for entry in glossary():
        assert entry.page or entry.module, entry.term
        assert not entry.page or (PROJECT / "docs" / entry.page).is_file(), entry
        assert not entry.module or importlib.util.find_spec(entry.module) is not None, entry


def test_a_meaning_is_one_short_sentence() -> None:
    for entry in glossary():
        assert entry.meaning.endswith("."), entry.term
        assert 3 <= len(entry.meaning.split()) <= 25, entry.term
