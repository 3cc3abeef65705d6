"""The pages build as a site without warnings, and the site needs no network."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import truing
from docs.site.versions import built_versions, write_list
from tests.conftest import PROJECT
from tests.docs.pages import blocks, pages

PYTHON_PAGES = [page for page in pages() if page.startswith("docs/reference/python/")]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("sphinx", reason="the site is made by Sphinx, which `make test` installs")
    place = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-d", f"{place}/doctrees"]
    done = subprocess.run(
        [*command, "docs", f"{place}/html/{truing.__version__}"], cwd=PROJECT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return place / "html" / truing.__version__


def test_every_page_is_in_the_site_with_an_empty_list_of_faults(site: Path) -> None:
    """A page that no index lists is a warning, and a warning is an error."""
    made = {path.relative_to(site).with_suffix(".md").as_posix() for path in site.rglob("*.html")}
    assert {page.removeprefix("docs/") for page in pages() if page.startswith("docs/")} <= made


def test_the_site_needs_no_network(site: Path) -> None:
    """Scripts, styles, fonts and pictures lie within; equations are drawings and not scripts."""
    loaded = re.compile(r'<(?:script|img|iframe|link)[^>]* (?:src|href)="(?:https?:)?//[^"]*')
    for page in site.rglob("*.html"):
        assert loaded.findall(page.read_text(encoding="utf-8")) == [], page
    assert [path.name for path in site.rglob("*.css") if re.search(r"url\(['\"]?(https?:)?//", path.read_text())] == []


def test_equations_are_drawn_in_the_page(site: Path) -> None:
    text = (site / "theory" / "rigid-poses.html").read_text(encoding="utf-8")
    assert len(re.findall(r'<svg [^>]*role="img" aria-label="', text)) > 20
    assert r"\sum" not in re.sub(r'aria-label="[^"]*"', "", text)


def test_every_public_name_has_its_place_in_the_reference() -> None:
    listed = [name for page in PYTHON_PAGES for block in blocks(page) for name in block.text.split()]
    assert sorted(name for name in listed if "." not in name) == sorted(truing.__all__)


def test_public_names_are_explained(site: Path) -> None:
    text = "".join((site / page.removeprefix("docs/")).with_suffix(".html").read_text("utf-8") for page in PYTHON_PAGES)
    assert [name for name in truing.__all__ if f'id="truing.{name}"' not in text] == []


def test_results_of_a_search_have_the_text_of_every_page_at_hand(site: Path) -> None:
    """A page opened from a file may fetch no other, so the texts come as a script, for the page of results alone."""
    script = (site / "_static" / "page_texts.js").read_text(encoding="utf-8")
    texts = json.loads(script.removeprefix("const PAGE_TEXTS = ").removesuffix(";\n"))
    assert {page.removeprefix("docs/").removesuffix(".md") for page in pages() if page.startswith("docs/")} <= set(
        texts
    )
    assert "How do I read Excel workbooks?" in texts["how-to/excel"]
    users = [page.name for page in site.rglob("*.html") if "page_texts.js" in page.read_text(encoding="utf-8")]
    assert users == ["search.html"]


def test_a_version_is_in_title_and_folder_and_every_page_offers_the_others(site: Path) -> None:
    text = (site / "how-to" / "excel.html").read_text(encoding="utf-8")
    assert f"truing {truing.__version__}</title>" in text
    assert re.search(r'<script src="[^"]*version_chooser\.js', text)
    assert (site.parent / "versions.js").read_text(encoding="utf-8") == f'showVersions(["{truing.__version__}"]);\n'
    assert f"url={site.name}/index.html" in (site.parent / "index.html").read_text(encoding="utf-8")


def test_versions_side_by_side_are_listed_the_newest_first(tmp_path: Path) -> None:
    for name in ("0.9.0", "0.10.0", "0.2.1"):
        (tmp_path / name / "_static").mkdir(parents=True)
        (tmp_path / name / "_static" / "version_chooser.js").touch()
    (tmp_path / "drafts").mkdir()
    assert built_versions(tmp_path) == ["0.10.0", "0.9.0", "0.2.1"]
    write_list(tmp_path)
    assert "url=0.10.0/index.html" in (tmp_path / "index.html").read_text(encoding="utf-8")


def test_make_docs_builds_into_the_folder_of_the_version() -> None:
    done = subprocess.run(["make", "-n", "docs"], cwd=PROJECT, capture_output=True, text=True)
    assert f"docs build/docs/html/{truing.__version__}\n" in done.stdout


def test_symbols_of_equations_and_of_ranges_are_words_of_the_search(site: Path) -> None:
    """K22 is in no sentence: only in equations as K_{22}, and in K11 .. K66."""
    index = (site / "searchindex.js").read_text(encoding="utf-8")
    found = json.loads(re.fullmatch(r"Search\.setIndex\((.*)\)\s*", index, re.DOTALL)[1])  # type: ignore[index]
    pages_of = {word: {found["docnames"][n] for n in np.atleast_1d(of)} for word, of in found["terms"].items()}
    assert {"causes", "conventions"} <= pages_of["k22"]
    assert "conventions" in pages_of["g_b"]
    assert {"rho", "kappa", "v3_mv"} <= set(pages_of)
