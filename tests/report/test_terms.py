"""Tooltips of glossary terms in table heads and captions."""

from __future__ import annotations

import re

import pytest

from truing.report.glossary_section import glossary_section
from truing.report.page import ErrorChange, FirstScreen, Listing, PageHead, ReportSection
from truing.report.rendering.render import render_page
from truing.report.rendering.terms import AMBIGUOUS, marked
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
    assert first == f'<abbr title="{TERMS["residual"].meaning}">Residuals</abbr> of all arms'
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
    assert str(marked("p (corrected)", set())).startswith(f'<abbr title="p-value: {TERMS["p-value"].meaning}">p</abbr>')


def test_text_is_escaped() -> None:
    assert str(marked("<b> & pose", set())).startswith("&lt;b&gt; &amp; <abbr ")


# Compounds of ordinary words that tooltips use in their ordinary sense.
_ORDINARY = {"6×6 matrix", "beam path", "measurement noise", "stated noise", "stated uncertainty"}


def test_every_term_of_a_tooltip_has_an_entry() -> None:
    questions = [check.question for checks in CHECKS.values() for check in checks.values()]
    texts = [*(term.meaning for term in glossary()), *questions, *map(cause_meaning, WORDINGS)]
    kinds = "noise|floor|matrix|uncertainty|frame|configuration|path|calibration|deviation|adjustment"
    found = {match for text in texts for match in re.findall(rf"[\w×-]+ (?:{kinds})\b", text)}
    plain = {words for words in found if words.split()[0].lower() in _PARTICLES}
    assert {words.lower() for words in found - plain - _ORDINARY} - TERMS.keys() == set()


def test_the_first_screen_explains_the_noise_floor() -> None:
    screen = FirstScreen(
        (("machine", "axis"),), "", ErrorChange("rms of measured minus predicted", "2 µm", "1 µm", "1 µm", "")
    )
    page = render_page(PageHead("c", (("pass", "ok"),), screen=screen), [])
    assert f'<abbr title="{TERMS["noise floor"].meaning}">noise floor</abbr>' in page


def test_ambiguous_terms_are_terms() -> None:
    assert TERMS.keys() >= AMBIGUOUS
    assert not any(isinstance(marked(term, set()), str) and "<abbr" in marked(term, set()) for term in AMBIGUOUS)


def test_each_section_of_a_page_explains_a_term_once() -> None:
    listings = (Listing(("pose", "residual"), (("1", "2"),), caption="Poses"), Listing(("pose",), (("1",),)))
    sections = [ReportSection(name, name, "", listings=listings) for name in ("one", "two")]
    page = render_page(PageHead("campaign", ()), sections)
    shown = re.findall(r"<abbr title=[^>]*>([^<]*)</abbr>", page)
    assert shown == ["Poses", "residual"] * 2
    assert '<th scope="col">pose</th>' in page
    assert "docs/glossary.md" in page


def test_names_in_tables_lead_to_their_definition() -> None:
    rows = (("pass", "time-gaps", "poses"), ("pass", "own-check", "poses"))
    checks = ReportSection("qa", "Quality", "Two checks.", listings=(Listing(("verdict", "check", "subject"), rows),))
    cause = Listing(("cause", "verdict"), (("actuator gain, leg <3>", "found"),))
    causes = ReportSection("diagnosis", "Diagnosis", "One cause.", listings=(cause,))
    meanings = glossary_section([checks, causes])
    assert meanings is not None
    page = render_page(PageHead("c", (("pass", "ok"),)), [checks, causes, meanings])
    links = re.findall(r'<a class="defined" href="#([^"]+)" title="([^"]+)">([^<]+)</a>', page)
    assert [(place, text) for place, _, text in links] == [
        ("check-time-gaps", "time-gaps"),
        ("cause-actuator-gain", "actuator gain, leg &lt;3&gt;"),
    ]
    assert all(f'<tr id="{place}">' in page for place, *_ in links)
    assert links[0][1] == OF_POINTS["time-gaps"].question
    assert "<td>own-check</td>" in page


@pytest.mark.parametrize("cause", WORDINGS)
def test_a_cause_is_one_short_sentence_without_gaps(cause: str) -> None:
    words = cause_meaning(cause)
    assert re.fullmatch(r"[A-Z](?:(?!  | None|\.).)+\.", words), words
    assert len(words.split()) <= 25


def test_names_of_causes_are_different() -> None:
    nouns = [cause_words(cause) for cause in WORDINGS]
    assert len(set(nouns)) == len(nouns)
