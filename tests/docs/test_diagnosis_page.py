"""docs/diagnosis.md shows the current diagnosis of the sample campaign."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from docs.experiments import diagnosis
from tests.conftest import PROJECT
from tests.docs.shown import shown

PAGE = (PROJECT / "docs" / "diagnosis.md").read_text(encoding="utf-8")


def _cells(text: str) -> list[list[str]]:
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in text.splitlines()]


def _numbers(cell: str) -> list[float]:
    return [float(number) for number in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", cell)]


@pytest.mark.parametrize("name", ["sample", "pulls"])
def test_tables_of_the_diagnosis_page_are_current(name: str, sample_run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Names to the letter; figures to a twentieth, for the last digits differ between processors."""
    monkeypatch.setattr(diagnosis, "run_folder", lambda _: sample_run)
    found = _cells({"sample": diagnosis.sample_table, "pulls": diagnosis.pulls_table}[name]())
    reported = _cells(shown(PAGE, name))
    assert len(reported) == len(found)
    for row, expected in zip(reported[2:], found[2:], strict=True):
        assert row[:2] == expected[:2] or name == "pulls"
        for cell, other in zip(row[1:], expected[1:], strict=True):
            assert _numbers(cell) == pytest.approx(_numbers(other), rel=0.05, abs=0.11)


def test_links_lead_somewhere() -> None:
    for page in re.findall(r"\]\(([\w.-]+\.md)\)", PAGE):
        assert (PROJECT / "docs" / page).exists(), page
