"""Tooltips of glossary terms in table heads and captions."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

from tests.report.bench_tables import bench_tables
from tests.report.calibration_tables import calibration_tables
from tests.report.campaign_tables import campaign_tables
from tests.report.explained import unexplained, unlinked
from tests.report.test_page import Reader
from truing.report.column_heads import Head, meaning_of
from truing.report.glossary_section import glossary_section
from truing.report.page import ErrorChange, FirstScreen, Listing, PageHead, ReportSection, all_of
from truing.report.rendering.render import render_page
from truing.report.rendering.terms import AMBIGUOUS, marked
from truing.report.sections import build_sections
from truing.report.wordings.catalogue import WORDINGS, cause_meaning, cause_words
from truing.schemas.glossary import Term, glossary
from truing.schemas.point_checks import OF_POINTS
from truing.schemas.quality_checks import CHECKS

_PARTICLES = {
    *("a", "an", "the", "of", "its", "their", "this", "that", "each", "every", "any", "all", "one", "same", "other"),
    *("in", "by", "as", "for", "from", "to", "with", "and", "or", "no", "without", "whose"),
}
TERMS = {term.term: term for term in glossary()}


def test_first_use_of_a_term_shows_its_meaning() -> None:
    used: set[str] = set()
    first, again = (str(marked("Residuals of all arms", used)) for _ in range(2))
    assert first == f'<abbr tabindex="0" title="{TERMS["residual"].meaning}">Residuals</abbr> of all arms'
    assert again == "Residuals of all arms"
    assert used == {"residual"}


@pytest.mark.parametrize("term", [term for term in glossary() if term.term not in AMBIGUOUS], ids=lambda t: t.term)
def test_every_term_is_found_by_its_name(term: Term) -> None:
    used: set[str] = set()
    marked(f"The {term.term}, once", used)
    assert used == {term.term}


@pytest.mark.parametrize("text", ["a targeted test", "pull-out", "polygons", "", "G_B2", "p, all subjects counted"])
def test_parts_of_words_are_no_terms(text: str) -> None:
    assert str(marked(text, set())) == text


def test_longest_term_wins() -> None:
    used: set[str] = set()
    marked("expanded uncertainty and bodies", used)
    assert used == {"expanded uncertainty", "body"}


def test_symbol_alone_is_a_term_and_names_it() -> None:
    assert str(marked("p (corrected)", set())).startswith(
        f'<abbr tabindex="0" title="p-value: {TERMS["p-value"].meaning}">p</abbr>'
    )


def test_text_is_escaped() -> None:
    assert str(marked("<b> & pose", set())).startswith("&lt;b&gt; &amp; <abbr ")


# Compounds of ordinary words that tooltips use in their ordinary sense.
_ORDINARY = {"6×6 matrix", "beam path", "measurement noise", "stated noise", "stated uncertainty"}


def test_every_term_of_a_tooltip_has_an_entry() -> None:
    questions = [check.question for checks in CHECKS.values() for check in checks.values()]
    heads = [meaning_of(head) for kind in EVERY for listing in listings_of(kind) for head in listing.heads]
    texts = [*(term.meaning for term in glossary()), *questions, *map(cause_meaning, WORDINGS), *heads]
    kinds = "noise|floor|matrix|uncertainty|frame|configuration|path|calibration|deviation|adjustment"
    found = {match for text in texts for match in re.findall(rf"[\w×-]+ (?:{kinds})\b", text)}
    plain = {words for words in found if words.split()[0].lower() in _PARTICLES}
    assert {words.lower() for words in found - plain - _ORDINARY} - TERMS.keys() == set()


def test_the_first_screen_explains_the_noise_floor() -> None:
    screen = FirstScreen(
        (("machine", "axis"),), "", ErrorChange("rms of measured minus predicted", "2 µm", "1 µm", "1 µm", "")
    )
    page = render_page(PageHead("c", (("pass", "ok"),), screen=screen), [])
    assert f'<abbr tabindex="0" title="{TERMS["noise floor"].meaning}">noise floor</abbr>' in page


def test_ambiguous_terms_are_terms() -> None:
    assert TERMS.keys() >= AMBIGUOUS
    assert not any(isinstance(marked(term, set()), str) and "<abbr" in marked(term, set()) for term in AMBIGUOUS)


def test_each_section_of_a_page_explains_a_term_once() -> None:
    listings = (Listing(("pose",), (("1",),), caption="Poses"), Listing(("pose",), (("1",),), caption="Residual poses"))
    sections = [ReportSection(name, name, "", listings=listings) for name in ("one", "two")]
    page = render_page(PageHead("campaign", ()), sections)
    assert re.findall(r"<abbr [^>]*>([^<]*)</abbr>", page) == ["Poses", "Residual"] * 2


def test_names_heads_and_terms_lead_to_their_explanation() -> None:
    rows = (("pass", "time-gaps", "poses"), ("pass", "own-check", "poses"))
    heads = ("verdict", Head("check", "Name of the check."), Head("subject", "What it concerns."))
    checks = ReportSection("qa", "Quality", "Two checks.", listings=(Listing(heads, rows, caption="Residuals"),))
    cause = Listing(("cause", "verdict"), (("actuator gain, leg <3>", "found"),))
    causes = ReportSection("diagnosis", "Diagnosis", "One cause.", listings=(cause,))
    meanings = glossary_section([checks, causes])
    assert meanings is not None
    read = Reader(render_page(PageHead("c", (("pass", "ok"),)), [checks, causes, meanings]))
    links = {a["href"]: a["title"] for tag, a in read.elements if tag == "a" and "title" in a}
    assert links["#check-time-gaps"] == OF_POINTS["time-gaps"].question
    assert links["#cause-actuator-gain"] == cause_meaning("actuator-gain")
    assert links["#column-subject"] == "What it concerns."
    assert links["#term-residual"] == TERMS["residual"].meaning
    assert not [place for place in links if "own-check" in place]
    assert set(links) <= {f"#{a['id']}" for _, a in read.elements if "id" in a}


@cache
def listings_of(kind: str) -> tuple[Listing, ...]:
    """All tables of the page of a sort of campaign."""
    tables = {"campaign": campaign_tables, "bench": bench_tables, "calibration": calibration_tables}[kind]
    return tuple(listing for section in all_of(build_sections(tables(), {"poses": {}})) for listing in section.listings)


EVERY = ("campaign", "bench", "calibration")


@pytest.mark.parametrize("kind", EVERY)
def test_every_head_check_and_cause_has_a_sentence_and_a_working_anchor(kind: str) -> None:
    listings = listings_of(kind)
    page = render_page(PageHead("c", (("pass", "ok"),)), [ReportSection("all", "All", "", listings=listings)])
    assert not unexplained(page)
    assert not unlinked(page, "check")
    assert not unlinked(page, "cause")


def test_the_page_of_a_run_explains_all_that_it_shows(workplace: Path) -> None:
    page = (workplace / "runs" / "telescope" / "report.html").read_text(encoding="utf-8")
    assert not unexplained(page)
    assert not unlinked(page, "check")
    assert not unlinked(page, "cause")


@pytest.mark.parametrize("cause", WORDINGS)
def test_a_cause_is_one_short_sentence_without_gaps(cause: str) -> None:
    words = cause_meaning(cause)
    assert re.fullmatch(r"[A-Z](?:(?!  | None|\.).)+\.", words), words
    assert len(words.split()) <= 25


def test_names_of_causes_are_different() -> None:
    nouns = [cause_words(cause) for cause in WORDINGS]
    assert len(set(nouns)) == len(nouns)
