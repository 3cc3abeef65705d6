"""Every example of docs/how-to is read to the table on its page, and every mistake gives the printed message."""

from __future__ import annotations

import csv
import io
import math

import pytest
from typer.testing import CliRunner

from tests.docs.how_to_pages import FOLDER, Example, Slip, examples, slips, write_listing
from truing.pipeline.command_line import app
from truing.pipeline.in_memory import stage_line
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import CampaignFaults

PAGES = sorted(FOLDER.glob("*.md"))
EXAMPLES = [example for page in PAGES for example in examples(page)]
SLIPS = [(examples(page)[0], slip) for page in PAGES for slip in slips(page)]
KEYS = {
    "image",
    "camera",
    "point",
    "parameter",
    "pose",
    "body",
    "target",
    "run",
    "step",
    "channel",
    "figure",
    "subject",
    "target_mm",
    "direction",
    "cycle",
}
READERS = {
    *("aicon", "c3d", "colmap", "keysight", "laser-tracker", "leica-gsi", "metashape", "photomodeler", "quadrature"),
    *("rays", "renishaw", "v-stars", "excel", "matlab", "poses", "inspection-reports"),
}


def first_stage(example: Example) -> str:
    """The stage that reads the example's files."""
    return "images" if "[files.image_points]" in example.files["campaign.toml"] else "ingest"


def test_every_instrument_has_an_example_and_its_slips():
    assert {example.page for example in EXAMPLES} == READERS
    assert {example.page for example, _ in SLIPS} == READERS
    assert all(example.tables for example in EXAMPLES)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.page)
def test_the_example_gives_its_tables(tmp_path, example: Example):
    line = stage_line(example.write(tmp_path)).call(first_stage(example))
    if not {f"{file}.parquet" for file in example.tables} <= {ARTIFACTS[name].file for name in line.tables}:
        line.call("pose", "deformation")
    for file, text in example.tables.items():
        (name,) = (name for name in line.tables if ARTIFACTS[name].file == f"{file}.parquet")
        found = line.tables[name].to_pylist()
        shown = list(csv.DictReader(io.StringIO(text)))
        if name == "observations":
            assert len(found) == len(shown)
        for expected in shown:
            (row,) = [row for row in found if all(_same(row[key], expected[key]) for key in KEYS & expected.keys())]
            for key, value in expected.items():
                assert _same(row[key], value), (key, row[key], value)


def _same(value, text: str) -> bool:
    """Return True if a value equals the text on the page; numbers to half of their last digit."""
    if isinstance(value, float) and text:
        digits = len(text.partition(".")[2])
        return math.isclose(value, float(text), abs_tol=0.5001 * 10.0**-digits)
    return ("" if value is None else str(value)) == text


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.page)
def test_the_example_has_no_fault(tmp_path, example: Example):
    done = CliRunner().invoke(app, ["check", str(example.write(tmp_path))])
    assert (done.exit_code, done.stderr) == (0, ""), done.output


@pytest.mark.parametrize(("example", "slip"), SLIPS, ids=lambda one: getattr(one, "page", ""))
def test_a_slip_is_answered_as_the_page_says(tmp_path, example: Example, slip: Slip):
    example.write(tmp_path)
    text = example.files[slip.file]
    assert slip.instead_of in text
    write_listing(tmp_path / slip.file, text.replace(slip.instead_of, slip.written, 1))
    with pytest.raises(CampaignFaults) as reported:
        stage_line(tmp_path).call(first_stage(example))
    assert slip.said in [str(fault) for fault in reported.value.faults]


EXPANSION = """[interferometer.material]
axis = { expansion_per_k = 11.5e-6, expansion_sigma_per_k = 0.5e-6 }
[files.positioning]
constants = { material_temperature_c = 20.4 }
"""


@pytest.mark.parametrize(
    ("page", "old", "new", "table", "column", "values"),
    [
        ("c3d", "offset = { pose = 1 }", r"select = { frame = '\d*0' }", "observations", "pose", {0}),
        (
            "c3d",
            "offset = { pose = 1 }",
            "from_name = '(?P<trial>\\w+)\\.c3d'\njoin = { pose = \"{trial}-{frame}\" }",
            "observations",
            "pose",
            {"lift-0", "lift-1"},
        ),
        ("renishaw", "[files.positioning]\n", EXPANSION, "reading_corrections", "correction", {"material"}),
    ],
)
def test_settings_mentioned_in_how_to_pages_work(tmp_path, page, old, new, table, column, values):
    folder = examples(FOLDER / f"{page}.md")[0].write(tmp_path)
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    assert old in text
    assert all(
        line in (FOLDER / f"{page}.md").read_text() for line in new.splitlines() if "select" in line or "axis" in line
    )
    (folder / "campaign.toml").write_text(text.replace(old, new), encoding="utf-8")
    assert set(stage_line(folder).call("ingest").tables[table][column].to_pylist()) == values
