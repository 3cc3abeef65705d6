"""Fixtures: the template of figures, and one browser per session for tests of pages."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.report.browser import PROGRAM, Browser, Page
from truing.report.figure_style import figure_template

Opened = Callable[..., Page]


@pytest.fixture(scope="package", autouse=True)
def _figures_start_with_the_template() -> Iterator[None]:
    """Sections that a test builds alone start their figures as `build_sections` does, which is faster."""
    with figure_template():
        yield


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    if PROGRAM is None:
        pytest.skip("no chromium or chrome here to look at the page with")
    with Browser(tmp_path_factory.mktemp("browser")) as started:
        yield started


@pytest.fixture(scope="session")
def opened(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Opened:
    """Opens a page from its text, as from a folder without a network."""

    def opened_page(html: str, **view: int | str) -> Page:
        file: Path = tmp_path_factory.mktemp("opened") / "report.html"
        file.write_text(html, encoding="utf-8")
        return Page(browser, file.as_uri(), **view)  # type: ignore[arg-type]

    return opened_page
