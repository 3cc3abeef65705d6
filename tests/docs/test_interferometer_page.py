"""Statements and tables of docs/interferometer.md are those of its command."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import numpy as np

from docs.experiments import interferometer, interferometer_bench
from tests.docs.shown import shown
from tests.real.interferometer_logs import LINES
from tests.sensor_campaign import campaign_toml
from tests.stages.line import run_line
from tests.tolerance import assert_between, assert_close
from truing.report.measured_loads import corrections

PAGE = interferometer.PAGE.read_text(encoding="utf-8")


def _cells(name: str) -> list[list[str]]:
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in shown(PAGE, name).splitlines()[2:]]


def _number(cell: str) -> float:
    return float(re.search(r"[-+]?\d+(?:\.\d+)?", cell.replace("−", "-"))[0])  # type: ignore[index]


def test_tables_that_take_no_time_are_those_of_the_command() -> None:
    assert shown(PAGE, "worth") == interferometer.MADE["worth"]()


def test_every_table_of_the_page_has_its_maker() -> None:
    names = re.findall(r"<!-- table (\w+) -->", PAGE)
    assert sorted(names) == sorted(interferometer.MADE | interferometer.MEASURED)
    assert "to be made" not in PAGE


def test_published_indices_are_ours() -> None:
    for row in _cells("air"):
        assert max(abs(_number(row[4])), abs(_number(row[6]))) < 0.5


def test_short_arcs_are_refused_and_long_ones_known_as_stated() -> None:
    for degrees, given, stated, largest in _cells("arcs"):
        if float(degrees) <= 90:
            assert given.startswith("0 of")
        if float(degrees) >= 120:
            assert given == "40 of 40"
            assert_between(float(largest) / float(stated), 0.6, 1.8)


def test_counts_go_wrong_as_often_as_foreseen() -> None:
    for _, _, formula, counted, _ in _cells("counting"):
        share = _number(formula) / 100
        spread = 400 * np.sqrt(share * (1 - share) / 100000)
        assert_close(_number(counted), _number(formula), atol=spread + 1e-3)


def test_six_runs_do_not_see_an_eccentric_load_and_thirty_six_do() -> None:
    few, many = _cells("compliance")
    assert (few[1], many[1]) == ("6 of 36", "36 of 36")
    assert min(float(few[3]), float(few[4]), float(many[3])) > 0.05
    assert many[4] == "below 1e-9"
    z = np.array([[float(cell) for cell in row[1:]] for row in _cells("entries")])
    assert (np.abs(z[[1, 3, 5], 2]) > 100).all()
    assert np.abs(np.delete(z, 2, axis=1)).max() < 3.5


def test_the_slit_report_has_one_wrong_line() -> None:
    rows = _cells("positioning")
    assert [row[0] for row in rows] == list(LINES)
    assert [row[0] for row in rows if row[3] == "differs"] == ["E"]
    assert "12.94" in PAGE


def test_the_flagged_axis_is_the_one_that_is_cut_off() -> None:
    assert [row[0] for row in _cells("signals") if row[4] == "yes"] == ["Y"]
    assert [row[0] for row in _cells("signals") if row[5] != "0 %"] == ["Y"]


def test_the_bench_is_the_published_sensor() -> None:
    """Its simulated deformations are those of Table 2 of the paper, per kN and kN m."""
    reported = np.diag(interferometer_bench.sensor_compliance()) * 1e3
    scale = np.repeat([1e6, 1 / interferometer_bench.ARCSEC], 3)
    assert_close(reported * scale, [230, 190, 27, 82, 79, 67], atol=2e-3)


def test_the_example_of_what_is_known_of_beams_frame_and_surroundings_gives_its_table(tmp_path: Path) -> None:
    section = PAGE.split("## What you know of beams, frame and surroundings")[1].split("\n## ")[0]
    toml, raw, reported = (re.findall(rf"```{kind}\n(.*?)```", section, re.S)[0] for kind in ("toml", "text", "csv"))
    (tmp_path / "campaign.toml").write_text(campaign_toml(more=toml))
    (tmp_path / "interferometer.csv").write_text(raw)
    tables, output = run_line(tmp_path, "ingest", "pose")
    found = tables["reading_corrections"].to_pylist()
    for row, shown_row in zip(found, csv.DictReader(io.StringIO(reported)), strict=True):
        assert (row["subject"], row["correction"], row["unit"]) == (shown_row["subject"], shown_row["correction"], "um")
        assert_close([row["largest"], row["sigma"]], [float(shown_row[k]) for k in ("largest", "sigma")], atol=6e-5)
    assert "corrected for the geometry of beams: dz by" in output["pose"].figure
    shown_on_page = corrections({"reading_corrections": tables["reading_corrections"].to_pandas()}).rows
    assert [row[:2] for row in shown_on_page] == [
        ("dz", "refractive index of the air"),
        ("dz", "temperature of the material"),
    ]
    assert "0.86" in shown_on_page[1][2]
