"""The picture of a report in README.md shows the current statements; pixels are not compared."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from docs.experiments.report_picture import AGAIN, FACTS, PICTURE, shown_facts
from truing import load


@pytest.mark.slow
def test_the_image_agrees_with_the_page(sample_run: Path) -> None:
    reported, now = json.loads(FACTS.read_text(encoding="utf-8")), shown_facts(load(sample_run))
    assert json.loads(json.dumps(now)) == reported, f"draw the picture again by: {AGAIN}"


def test_the_image_was_drawn_with_the_stated_values() -> None:
    assert PICTURE.read_bytes().startswith(b"\x89PNG")
    reported = json.loads(FACTS.read_text(encoding="utf-8"))
    assert reported["verdict"]
    assert [figure["title"] for figure in reported["figures"]]
