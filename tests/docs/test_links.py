"""Every relative link of every page leads to an existing file and heading.

What lies outside of the project is asked for by `make links`, which needs a network.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path
from urllib.parse import unquote

import pytest

from tests.conftest import PROJECT
from tests.docs.pages import MARKDOWN, pages

PAGES = [*pages(), "CHANGELOG.md", *(p.relative_to(PROJECT).as_posix() for p in PROJECT.glob("sample_data/*/*.md"))]
_ELSEWHERE = re.compile(r"[a-z][a-z+.-]+:")


@cache
def links(page: str) -> tuple[str, ...]:
    tokens = MARKDOWN.parse((PROJECT / page).read_text(encoding="utf-8"))
    children = [child for token in tokens for child in token.children or ()]
    return tuple(str(child.attrs.get("href", child.attrs.get("src", ""))) for child in children if child.attrs)


@cache
def anchors(page: Path) -> frozenset[str]:
    """Anchors of the headings as code hosts form them: lower case, hyphens for blanks, no other marks, duplicates
    numbered."""
    tokens = MARKDOWN.parse(page.read_text(encoding="utf-8"))
    found: list[str] = []
    for heading, inline in pairwise(tokens):
        if heading.type == "heading_open":
            words = "".join(child.content for child in inline.children or () if child.type in ("text", "code_inline"))
            slug = re.sub(r"[^\w\- ]", "", words.strip().lower()).replace(" ", "-")
            found.append(f"{slug}-{found.count(slug)}" if slug in found else slug)
    return frozenset(found)


def faults(page: str) -> Iterator[str]:
    for link in links(page):
        path, _, anchor = unquote(link).partition("#")
        target = (PROJECT / page).parent / path if path else PROJECT / page
        if _ELSEWHERE.match(link):
            continue
        if not target.exists():
            yield f"{link}: no such file"
        elif anchor and target.suffix == ".md" and anchor not in anchors(target):
            yield f"{link}: no such heading"


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page: str) -> None:
    assert list(faults(page)) == []


def test_a_page_has_one_title_and_skips_no_level() -> None:
    for page in pages():
        levels = [int(t.tag[1]) for t in MARKDOWN.parse(pages()[page]) if t.type == "heading_open"]
        assert levels.count(1) == 1, page
        assert levels[0] == 1, page
        assert all(after - before <= 1 for before, after in pairwise(levels)), page


def test_headings_become_the_anchors_of_a_code_host(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# What `truing` says, why: 5 %?\n\n## Twice\n\n## Twice\n\n## a_x – b\n", encoding="utf-8")
    assert anchors(page) == {"what-truing-says-why-5-", "twice", "twice-1", "a_x--b"}
