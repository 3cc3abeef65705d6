"""Verdicts of whole runs of small campaigns: page, log, summary and exit code agree."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from tests.broken.good import axis as positioned_axis
from tests.pipeline.test_sample_campaign import bodies_campaign
from tests.report.diagnosis_tables import row, rows
from truing.pipeline.command_line import app
from truing.pipeline.in_memory import StageLine, stage_line
from truing.pipeline.problems import ExitCode
from truing.runs.exports.summary import summary
from truing.runs.recorded_run import load
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.sections import Requirement
from truing.schemas.verdict import SECTIONS, Relation
from truing.stages.calibration.model_rows import requirement_rows
from truing.stages.calibration.run import incomplete_picture, wrong_poses


def by_section(line: StageLine) -> dict[str, dict[str, object]]:
    return {row["section"]: row for row in line.tables["verdict"].to_pylist()}


def truing(*arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, list(arguments))
    return done.exit_code, done.output


def test_drives_without_a_mechanism_are_not_tested_and_no_simulation_is_mentioned(tmp_path: Path) -> None:
    bodies_campaign(tmp_path / "bodies")
    line = stage_line(tmp_path / "bodies").call()
    assert {row["relation"] for row in line.tables["diagnosis"].to_pylist()} == {Relation.BODIES_SURVEY.value}
    simulation = by_section(line)["simulation"]
    assert (simulation["state"], simulation["reason_code"]) == ("not tested", "no-mechanism")
    assert "elevation_deg" in str(simulation["explanation"])
    page = str(line.tables["report"])
    assert str(simulation["explanation"]) in page
    assert "simulation agrees" not in page


@pytest.fixture(scope="module")
def refused(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, tuple[int, str]]:
    """Positions in metres where millimetres are expected: campaign, run, exit code and output."""
    home = tmp_path_factory.mktemp("refused")
    folder, out = positioned_axis(home / "campaign"), home / "run"
    head, *rows = (folder / "positioning.csv").read_text().splitlines()
    cells = [row.rsplit(",", 1) for row in rows]
    (folder / "positioning.csv").write_text("\n".join([head, *(f"{a},{float(b) / 1e3:.7f}" for a, b in cells)]) + "\n")
    return folder, out, truing("run", str(folder), "--out", str(out))


def test_data_that_do_not_belong_together_end_with_3_and_say_why_everywhere(
    refused: tuple[Path, Path, tuple[int, str]],
) -> None:
    folder, out, (code, said) = refused
    assert code == ExitCode.FAILED_CHECK
    rows = pq.read_table(out / "verdict.parquet").to_pylist()
    assert (rows[0]["section"], rows[0]["state"]) == ("campaign", "fails")
    assert rows[0]["decided_by"] in ("belonging", "quality")
    assert "verdict: fails" in said
    (mark, first), *_ = load(out).verdicts
    assert (mark, first) == ("fail", rows[0]["explanation"])
    reported = json.loads(dict(summary(load(out)))["summary.json"])
    assert reported["verdict"][0]["explanation"] == first
    assert truing("run", str(folder), "--out", str(out), "--qa=warn")[0] == ExitCode.DONE


def test_the_exit_code_follows_the_verdict_and_without_one_the_checks(
    refused: tuple[Path, Path, tuple[int, str]], tmp_path: Path
) -> None:
    folder, _, _ = refused
    code, said = truing("run", str(folder), "--out", str(tmp_path / "run"), "--only", "qa")
    assert code == ExitCode.FAILED_CHECK
    assert "QA: 1 failed (positions-against-targets run X)" in said
    assert not (tmp_path / "run" / "verdict.parquet").exists()


def test_every_row_of_a_run_names_a_section_of_the_reference(refused: tuple[Path, Path, tuple[int, str]]) -> None:
    rows = pq.read_table(refused[1] / "verdict.parquet").to_pylist()
    assert [row["section"] for row in rows][1:] == [
        name for name in SECTIONS if name in {row["section"] for row in rows}
    ]


@pytest.mark.parametrize(("rms", "fails"), [(4.0, False), (60.0, True)])
def test_a_calibration_knows_of_a_picture_that_fails(rms: float, fails: bool) -> None:
    reported = rows(row("actuator-gain", rms_after=rms))
    tables = {"diagnosis": pa.Table.from_pandas(reported, preserve_index=False)}
    assert bool(incomplete_picture(tables)) is fails


@pytest.mark.parametrize(
    ("cause", "step", "subject", "verdict", "wrong"),
    [
        ("measurement-scale", "instrument", "", "found", True),
        ("measurement-scale", "instrument", "", "rejected", False),
        ("targets-swapped", "instrument", "targets P1 and P2", "found", False),
        ("actuator-gain", "drive", "", "found", False),
    ],
)
def test_recorded_poses_assess_no_calibration_where_all_are_found_wrong(
    cause: str, step: str, subject: str, verdict: str, wrong: bool
) -> None:
    reported = rows(row(cause, verdict=verdict, subject=subject, settings=json.dumps({"step": step})))
    assert bool(wrong_poses({"diagnosis": pa.Table.from_pandas(reported, preserve_index=False)})) is wrong


@pytest.mark.parametrize("why_not", ["", "5.15 times the declared noise"])
def test_requirements_are_met_by_a_model_that_fits_alone(why_not: str) -> None:
    noise = np.full((20, 6), 1e-12)
    error = np.random.default_rng(1).normal(0.0, 1e-6, (20, 6))
    error[:, 1] = 1e-3
    asked = Requirement(x_mm=0.1, y_mm=0.1)
    table = requirement_rows(asked, ("6-pus", "linear"), error, noise, np.ones(20, bool), why_not).table()
    verdicts = {row["component"]: row for row in table.to_pylist()}
    assert verdicts["y"]["verdict"] == "fails"
    assert verdicts["x"]["verdict"] == ("not evaluated" if why_not else "meets")
    assert ("5.15 times the declared noise" in verdicts["x"]["message"]) is bool(why_not)


def test_an_undecided_requirement_holds_the_poses_that_decide_it_and_no_other_does() -> None:
    noise = np.full((20, 6), 1e-12)
    error = np.random.default_rng(1).normal(0.0, 1e-5, (20, 6))
    asked = Requirement(x_mm=0.025, y_mm=1.0, z_mm=1e-6)
    further = []
    for held in (True, False):
        held_out = np.full(20, held)
        table = requirement_rows(asked, ("6-pus", "linear"), error, noise, held_out).table()
        assert not ARTIFACTS["requirements"].faults(table)
        x, y, z = table.to_pylist()
        assert (x["verdict"], y["verdict"], z["verdict"]) == ("undecided", "meets", "fails")
        facts = ("measurements", "lower_expected", "upper_expected")
        assert {row[name] for row in (y, z) for name in facts} == {None}
        assert {row["poses_judged"] for row in (x, y, z)} == {20}
        assert x["p_value"] > 0.05 > max(y["p_value"], z["p_value"])
        assert x["lower"] < x["lower_expected"] < x["error"] < x["upper_expected"] <= x["requirement"] < x["upper"]
        further.append(x["measurements"])
    # Next to further ones, poses that were fitted to count no more.
    assert further[1] == further[0] + 20
