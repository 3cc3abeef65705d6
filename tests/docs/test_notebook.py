"""The example notebook runs, and its recorded output is current except for machine-dependent numbers."""

from __future__ import annotations

import json
import re

import pytest

from docs.experiments.notebook import NOTEBOOK, code_cells, outputs, recorded, text_of
from tests.conftest import PROJECT

DOCUMENT = recorded()


def test_the_notebook_is_executed_and_smaller_than_one_megabyte():
    cells = code_cells(DOCUMENT)
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    assert all(cell["outputs"] for cell in cells)
    assert {tag for cell in cells for tag in cell["metadata"]["tags"]} == {"exact", "runs"}
    assert NOTEBOOK.stat().st_size < 1_000_000
    pictures = [one for cell in cells for one in cell["outputs"] if "image/png" in one.get("data", {})]
    assert len(pictures) >= 2


def test_the_notebook_is_valid_by_its_schema():
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not here to say what a notebook is")
    nbformat.validate(json.loads(NOTEBOOK.read_text(encoding="utf-8")))


def test_cells_of_the_notebook_run_with_the_recorded_output(workplace, tmp_path):
    """With the whole sample campaign, and the run of a cut one in place of its own: the recorded one takes too long."""
    (tmp_path / "sample_data").symlink_to(PROJECT / "sample_data")
    (tmp_path / "runs").symlink_to(workplace / "runs")
    found = list(outputs(DOCUMENT, tmp_path, lambda figure: ""))
    for cell, shown in zip(code_cells(DOCUMENT), found, strict=True):
        assert [one["output_type"] for one in shown] == [one["output_type"] for one in cell["outputs"]]
        if cell["metadata"]["tags"] == ["exact"]:
            assert text_of(shown) == text_of(cell["outputs"]), "".join(cell["source"])
        else:
            assert _skeleton(text_of(shown)) == _skeleton(text_of(cell["outputs"]))


def _skeleton(text: str) -> list[str]:
    """First words of a text without its numbers: head of a table, title of a picture, mark of a sentence."""
    return re.sub(r"[-+]?\d[\d.]*(e-?\d+)?", "#", text.strip().splitlines()[0]).split()[:1]
