"""Exports contain exactly the values of the run, and equal tables give equal bytes."""

from __future__ import annotations

import io
import json
import tomllib
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from typer.testing import CliRunner

import truing
from truing.pipeline.command_line import app
from truing.pipeline.problems import ExitCode
from truing.runs.exports import tables as workbook_module
from truing.runs.exports.controller import controller, reasons_for_caution
from truing.runs.exports.summary import summary
from truing.runs.exports.tables import text_tables, workbook

_SPREADSHEET = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"


@pytest.fixture(scope="module")
def run(workplace: Path) -> truing.Run:
    return truing.load(workplace / "runs" / "telescope")


def _sheets(book: bytes) -> dict[str, list[list[str | float]]]:
    """Rows of every sheet, as a reader of the format sees them."""
    with zipfile.ZipFile(io.BytesIO(book)) as parts:
        texts = ["".join(item.itertext()) for item in ElementTree.fromstring(parts.read("xl/sharedStrings.xml"))]
        names = [
            sheet.attrib["name"]
            for sheet in ElementTree.fromstring(parts.read("xl/workbook.xml")).iter(f"{_SPREADSHEET}sheet")
        ]
        trees = [ElementTree.fromstring(parts.read(f"xl/worksheets/sheet{k}.xml")) for k in range(1, len(names) + 1)]
    rows = [[[_read(cell, texts) for cell in row] for row in tree.iter(f"{_SPREADSHEET}row")] for tree in trees]
    return dict(zip(names, rows, strict=True))


def _read(cell: ElementTree.Element, texts: list[str]) -> str | float:
    assert cell.find(f"{_SPREADSHEET}f") is None, "a formula"
    value = cell.findtext(f"{_SPREADSHEET}v", "nan")
    return texts[int(value)] if cell.get("t") == "s" else float(value)


@pytest.mark.slow
def test_csv_gives_every_table_back(run: truing.Run) -> None:
    files = dict(text_tables(run))
    assert set(files) == {f"{path.stem}.csv" for path in run.files.values()}
    poses = pd.read_csv(io.BytesIO(files["poses.csv"]))
    assert np.array_equal(poses["px_mm"], run["poses"]["px_mm"])  # to the last bit
    assert list(poses) == list(run["poses"])


@pytest.mark.slow
def test_the_workbook_lists_and_holds_every_table(run: truing.Run) -> None:
    (name, book), *more = workbook(run)
    sheets = _sheets(book)
    assert (name, more) == ("tables.xlsx", [])
    assert list(sheets) == ["contents", *run]
    assert [row[1] for row in sheets["contents"][1:]] == list(run)
    heads, units, *rows = sheets["poses"]
    assert dict(zip(heads, units, strict=False))["px_mm"] == "mm"
    column = heads.index("px_mm")
    assert np.allclose(
        [row[column] for row in rows], run["poses"]["px_mm"], rtol=1e-15, atol=0
    )  # 16 digits are written
    assert dict(workbook(run))[name] == book


def test_a_text_of_a_campaign_stays_text_in_a_workbook(run: truing.Run, monkeypatch: pytest.MonkeyPatch) -> None:
    hostile = '=HYPERLINK("http://elsewhere")'
    qa = run.table("qa").slice(0, 3)
    reported = qa.set_column(
        qa.schema.get_field_index("message"), "message", pa.array([hostile, "http://elsewhere", None])
    )
    small = truing.Run(run.folder, {"qa": run.files["qa"]}, run.campaign, {"qa": reported})
    monkeypatch.setattr(workbook_module, "ROWS_PER_SHEET", 2)
    sheets = _sheets(dict(workbook(small))["tables.xlsx"])
    assert list(sheets) == ["contents", "qa", "qa (2)"]
    assert hostile in sheets["qa"][2]  # no formula: reading one fails
    assert len(sheets["qa (2)"]) == 3


@pytest.mark.slow
def test_the_summary_says_what_the_page_says(run: truing.Run) -> None:
    reported = json.loads(dict(summary(run))["summary.json"])
    assert [(each["mark"], each["sentence"]) for each in reported["verdicts"]] == list(run.verdicts)
    assert sum(reported["qa"]["verdicts"].values()) == len(run["qa"])
    assert reported["qa"]["failed"] == []
    assert [row["relation"] for row in reported["belonging"]] == run["belonging"]["relation"].tolist()
    found = [cause for cause in reported["causes"] if cause["verdict"] == "found"]
    assert found
    assert all(isinstance(cause["parameters"], dict) for cause in found)
    stated, table = reported["uncertainty"], run["uncertainty"]
    assert [one["expanded_uncertainty"] for one in stated if one["stated"]] == pytest.approx(
        table.loc[table["stated"], "expanded_uncertainty"].tolist()
    )
    assert all(one["reason"] for one in (*reported["not_in_budget"], *(one for one in stated if not one["stated"])))
    assert {name: part["rows"] for name, part in reported["artifacts"].items()} == {
        name: len(run[name]) for name in run
    }


def test_a_controller_gets_the_identified_machine(run: truing.Run) -> None:
    files = dict(controller(run))
    legs = tomllib.loads(files["controller.toml"].decode())["mechanism"]["legs"]
    model = run.model
    assert isinstance(model, truing.ExtendedModel)
    identified = model.model.legs(model.shared)
    assert np.allclose([leg["a_mm"] for leg in legs], 1e3 * identified.a, rtol=0, atol=1e-9)
    table = pd.read_csv(io.BytesIO(files["controller.csv"])).set_index(["of", "name"])
    assert table.loc[("leg2", "b_y"), "value"] == legs[1]["b_mm"][1]
    assert (table.loc["leg3"].loc[["a_x", "b_z", "length"], "sigma"] > 0).all()
    for cause in run["diagnosis"].query("verdict == 'found' and cause != 'unexplained'")["cause"]:
        assert any(str(of).startswith(cause) for of in table.index.get_level_values("of"))


def test_exports_for_controllers_mark_unphysical_parameters(run: truing.Run) -> None:
    pulls = run["pulls"].assign(pull_after=0.5, identifiable=True)
    pulls.loc[(pulls["leg"] == 2) & (pulls["parameter"] == "l"), "pull_after"] = -4.0
    pulls.loc[(pulls["leg"] == 5) & (pulls["parameter"] == "a_x"), "identifiable"] = False
    diagnosis = run["diagnosis"].head(1).assign(cause="actuator-gain", subject="leg3", verdict="suspected")
    adequacy = run["adequacy"].head(1).assign(state="fails")
    assert reasons_for_caution({"pulls": pulls, "diagnosis": diagnosis, "adequacy": adequacy}) == {
        ("leg2", "length"): "far-from-nominal",
        ("leg5", "a_x"): "not-determined",
        ("actuator-gain leg3", ""): "suspected",
        ("model", ""): "inadequate",
    }
    assert reasons_for_caution({"pulls": pulls.assign(pull_after=1.9, identifiable=True)}) == {}


def test_cautions_are_next_to_their_numbers(run: truing.Run) -> None:
    files = dict(controller(run))
    expected = reasons_for_caution(run)
    reported = tomllib.loads(files["controller.toml"].decode()).get("caution", [])
    assert {(one["of"], one.get("name", "")): one["reason_code"] for one in reported} == expected
    table = pd.read_csv(io.BytesIO(files["controller.csv"]), keep_default_na=False)
    marked = {
        (row.of, row.name_): row.caution for row in table.rename(columns={"name": "name_"}).itertuples() if row.caution
    }
    assert set(marked.items()) == {(of, code) for of, code in expected.items() if of[1]}


@pytest.mark.slow
def test_the_command_writes_into_the_run_and_nowhere_else(run: truing.Run, tmp_path: Path) -> None:
    done = CliRunner().invoke(
        app, ["export", str(run.folder), "--to", "json, controller", "--out", str(tmp_path / "x")]
    )
    assert done.exit_code == ExitCode.DONE, done.output
    assert {path.name for path in (tmp_path / "x").iterdir()} == {"summary.json", "controller.toml", "controller.csv"}


@pytest.mark.parametrize(
    ("words", "said"),
    [(["--to", "docx"], "one of csv, xlsx, json, controller"), ([], "a folder that `truing run` has filled")],
)
def test_an_export_that_cannot_be_made_is_a_fault_and_writes_nothing(
    run: truing.Run, tmp_path: Path, words: list[str], said: str
) -> None:
    done = CliRunner().invoke(app, ["export", str(run.folder if words else tmp_path), *words])
    assert done.exit_code == ExitCode.UNUSABLE_CAMPAIGN
    assert said in done.output
    assert not any(tmp_path.iterdir())


def test_a_run_of_another_machine_has_no_robot_description(run: truing.Run, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["export", str(run.folder), "--to", "urdf", "--out", str(tmp_path)])
    assert result.exit_code == ExitCode.UNUSABLE_CAMPAIGN
    assert "the run of an open chain" in " ".join(result.output.split())
    assert not list(tmp_path.iterdir())
