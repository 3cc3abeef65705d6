"""The pages on both papers have one row for every numbered equation, table and figure, with a verdict and a place."""

from __future__ import annotations

import re

import pytest

from tests.docs.pages import pages
from truing.schemas.artifacts import ARTIFACTS

VERDICTS = ("as printed", "misprint, corrected", "not checkable: ", "no counterpart")
# Page: how many equations, tables and figures the paper numbers.
NUMBERED = {"docs/telescope-report.md": (40, 7, 18), "docs/force-sensor-paper.md": (37, 5, 17)}

NAMED = re.compile(r"(?:^|; |in )`([a-z_]+)`")


def rows(page: str) -> list[list[str]]:
    table = pages()[page].partition("Every equation, table and figure\n")[2].split("| --- |", 1)[1]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()[1:] if line]


@pytest.mark.parametrize("page", NUMBERED)
def test_every_number_of_the_paper_has_one_row(page: str) -> None:
    counts = zip(("eq.", "Table", "Figure"), NUMBERED[page], strict=True)
    assert [row[0] for row in rows(page)] == [f"{kind} {k + 1}" for kind, n in counts for k in range(n)]


@pytest.mark.parametrize("page", NUMBERED)
def test_every_row_has_meaning_source_and_verdict(page: str) -> None:
    for number, meaning, there, own, verdict, _figure in rows(page):
        assert 1 <= len(meaning.split()) <= 6, number
        assert verdict.startswith(VERDICTS), number
        assert "Python" not in own, number  # a command, an artifact, or a section of the page
        is_absent = there.startswith("none") and own.startswith("none")
        assert (verdict == "no counterpart") == is_absent, number


@pytest.mark.parametrize("page", NUMBERED)
def test_artifacts_of_the_rows_exist(page: str) -> None:
    named = {name for row in rows(page) for name in NAMED.findall(row[3])}
    assert named
    assert named <= set(ARTIFACTS)
