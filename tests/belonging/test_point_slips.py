"""Slips in readings, rows, points and the description of a mechanism are found under their own names."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from tests.belonging import point_slips
from tests.belonging.point_slips import ROUNDED_SLIPS, Files, PointSlip, read_files, write_files
from tests.belonging.pose_slips import POSE_SLIPS
from tests.blind.generator.case import hide
from tests.made_once import made_once
from tests.stages.line import run_line
from truing.belonging.relation import SlipKind
from truing.pipeline.command_line import app
from truing.pipeline.problems import ExitCode
from truing.stages.common.belonging import reason_withheld
from truing.stages.declaration import Outcome

# Two machines, with effects in them that a good campaign may have: the slip has to be found next to these.
MACHINES = {"6-pus": ("platform-deformation-matrix", "telescope"), "ups": ("actuator-gain", "hexapod")}
REFUSED_BY_INGEST = (  # a body that is a thousand times too large or small is a fault of the file
    "lengths in inches",
    "a in m",
    "points and survey in m",
    "points and survey in inches",
    "points in m",
    "survey in inches",
)
ALL_SLIPS = (*point_slips.ALL_SLIPS, *POSE_SLIPS)
SEEN_LATER = [slip for slip in ALL_SLIPS if slip.name not in REFUSED_BY_INGEST]


@pytest.fixture(scope="module", params=MACHINES)
def files(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Files:
    cause, layout = MACHINES[request.param]

    def write(place: Path) -> None:
        hide((cause,), layout, 40.0, 4).write(place / "good")

    return read_files(made_once(tmp_path_factory, f"belonging-{request.param}", write) / "good")


def _checked(files: Files, folder: Path) -> tuple[dict[str, pa.Table], dict[str, Outcome]]:
    return run_line(write_files(files, folder), "ingest", "qa")


def _slips(rows: list[dict]) -> list[dict]:
    return [slip for row in rows for slip in (*json.loads(row["slips"]), *json.loads(row["rivals"]))]


def test_good_campaigns_with_effects_in_them_belong_together(files: Files, tmp_path: Path) -> None:
    made, _ = _checked(files, tmp_path / "c")
    assert {row["state"] for row in made["belonging"].to_pylist()} == {"ok"}
    assert not reason_withheld(made)


@pytest.mark.parametrize("slip", SEEN_LATER, ids=lambda slip: slip.name)
def test_a_slip_fails_its_relation_under_its_own_name(files: Files, slip: PointSlip, tmp_path: Path) -> None:
    if slip.name == "u downwards" and files.toml["mechanism"]["type"] == "ups":
        pytest.skip("a leg of variable length has no direction of its own")
    if slip.name == "survey of another body" and files.toml["mechanism"]["type"] == "ups":
        pytest.skip("these two bodies differ so much in size that the file is refused")
    slipped = copy.deepcopy(files)
    slip.make(slipped)
    made, said = _checked(slipped, tmp_path / "c")
    failed = [row for row in made["belonging"].to_pylist() if row["state"] == "fails"]
    own = [row for row in failed if row["relation"] == slip.relation]
    assert own
    assert any(name.startswith(slip.relation) for name in said["qa"].failed_checks)
    assert reason_withheld(made)
    if slip.kind:
        kinds = {one["kind"] for one in _slips(own)}
        # what moves all rows by one is also an exchange of each with the next
        assert slip.kind in kinds or {slip.kind, *kinds} == {SlipKind.ROWS_EXCHANGED, SlipKind.ROWS_SHIFTED}


def test_the_factor_of_another_unit_is_the_one_that_mends_it(files: Files, tmp_path: Path) -> None:
    slipped = copy.deepcopy(files)
    slipped.configurations[slipped.rho] /= 25.4
    made, _ = _checked(slipped, tmp_path / "c")
    (slip,) = _slips([row for row in made["belonging"].to_pylist() if row["state"] == "fails"])
    assert slip["factor"] == pytest.approx(25.4)
    assert slip["subjects"] == []


def test_two_slips_at_once_are_both_named(files: Files, tmp_path: Path) -> None:
    slipped = copy.deepcopy(files)
    rho = slipped.rho
    slipped.configurations[rho] = 1e-3 * slipped.configurations[[rho[1], rho[0], *rho[2:]]].to_numpy()
    made, _ = _checked(slipped, tmp_path / "c")
    kinds = {slip["kind"] for slip in _slips([r for r in made["belonging"].to_pylist() if r["state"] == "fails"])}
    assert {"unit", "columns-exchanged"} <= kinds


def test_the_command_line_reports_a_slip_before_and_in_a_run(files: Files, tmp_path: Path) -> None:
    slipped = copy.deepcopy(files)
    slipped.configurations[slipped.rho] *= 1e-3
    folder = write_files(slipped, tmp_path / "c")
    looked = CliRunner().invoke(app, ["check", str(folder)])
    assert looked.exit_code == ExitCode.FAILED_CHECK
    assert "multiply by 1000" in looked.output
    done = CliRunner().invoke(app, ["run", str(folder), "--out", str(tmp_path / "run")])
    assert done.exit_code == ExitCode.FAILED_CHECK
    assert not pq.read_table(tmp_path / "run" / "diagnosis.parquet").num_rows
    assert not pq.read_table(tmp_path / "run" / "calibration.parquet").num_rows
    entry = '\n[[accept]]\ncheck = "readings-against-poses"\nreason = "a trial"\nby = "M. Keller"\non = 2026-03-01\n'
    (folder / "campaign.toml").write_text((folder / "campaign.toml").read_text() + entry)
    assert CliRunner().invoke(app, ["check", str(folder)]).exit_code == ExitCode.DONE


@pytest.mark.parametrize(
    ("name", "where"),
    [
        pytest.param("inches in a stretch", ["from pose {0} to pose {1}"], id="a stretch"),
        pytest.param("inches in every second row", ["every second pose from {2} to {3}"], id="every second pose"),
        pytest.param("inches on a day", ["day 2"], id="a day"),
    ],
)
def test_a_slip_in_some_rows_is_named_with_these_rows(
    files: Files, name: str, where: list[str], tmp_path: Path
) -> None:
    slipped = copy.deepcopy(files)
    next(slip for slip in ALL_SLIPS if slip.name == name).make(slipped)
    made, _ = _checked(slipped, tmp_path / "c")
    (slip,) = _slips([row for row in made["belonging"].to_pylist() if row["state"] == "fails"])
    pose, count = files.configurations["pose"].tolist(), len(files.configurations)
    odd = pose[1::2]
    first, last = pose[count // 4], pose[count * 3 // 5 - 1]
    assert slip["factor"] == pytest.approx(25.4)
    assert slip["subjects"] == [one.format(first, last, odd[0], odd[-1]) for one in where]


@pytest.mark.parametrize(
    ("name", "factor", "where"),
    [
        pytest.param("platform mirrored in a stretch", 1.0, "from pose {0} to pose {1}", id="mirrored"),
        pytest.param("platform in m in every second pose", 1e3, "every second pose from {2} to {3}", id="every second"),
        pytest.param("bodies exchanged in every second pose", 1.0, "every second pose from {2} to {3}", id="bodies"),
    ],
)
def test_a_slip_in_the_points_of_some_poses_is_named_with_these_and_blames_no_reading(
    files: Files, name: str, factor: float, where: str, tmp_path: Path
) -> None:
    slipped = copy.deepcopy(files)
    next(slip for slip in ALL_SLIPS if slip.name == name).make(slipped)
    made, _ = _checked(slipped, tmp_path / "c")
    failed = [row for row in made["belonging"].to_pylist() if row["state"] == "fails"]
    assert {row["relation"] for row in failed} == {"points-against-survey"}
    pose, count = files.configurations["pose"].tolist(), len(files.configurations)
    wanted = where.format(pose[count // 4], pose[count * 3 // 5 - 1], pose[1], pose[1::2][-1])
    (slip,) = [one for one in _slips(failed) if "platform" in one["subjects"]]
    assert (slip["factor"], slip["subjects"][0]) == (pytest.approx(factor), wanted)


def test_wrong_rows_that_no_slip_explains_get_no_name(files: Files, tmp_path: Path) -> None:
    slipped = copy.deepcopy(files)
    count = len(slipped.configurations)
    rows = slice(count // 4, count // 2)
    spread = np.ptp(slipped.configurations[slipped.rho].to_numpy(), axis=0)
    drawn = np.random.default_rng(7).normal(0.0, 0.5, (count // 2 - count // 4, 6))
    slipped.configurations.loc[slipped.configurations.index[rows], slipped.rho] += drawn * spread
    made, _ = _checked(slipped, tmp_path / "c")
    (row,) = [row for row in made["belonging"].to_pylist() if row["state"] == "fails"]
    assert (row["reason_code"], _slips([row])) == ("no-slip", [])


@pytest.mark.parametrize("slip", ROUNDED_SLIPS, ids=lambda slip: slip.name)
def test_numbers_in_steps_above_the_declared_noise_are_a_warning(files: Files, slip: PointSlip, tmp_path: Path) -> None:
    if slip.name == "readings in steps" and files.toml["mechanism"]["type"] == "6-pus":
        pytest.skip("drives that stand in a few places only: their rounding looks like a gain")
    slipped = copy.deepcopy(files)
    slip.make(slipped)
    made, _ = _checked(slipped, tmp_path / "c")
    rows = [row for row in made["belonging"].to_pylist() if row["relation"] == slip.relation]
    assert [(row["state"], row["reason_code"]) for row in rows] == [("attention", "rounded")]
    assert {(one["kind"], round(one["offset"], 6)) for one in _slips(rows)} == {("rounded", 0.13)}
    assert rows[0]["misfit"] == pytest.approx(0.13 / np.sqrt(12.0))
    assert not reason_withheld(made)


def test_steps_below_the_declared_noise_pass(files: Files, tmp_path: Path) -> None:
    motion = copy.deepcopy(files)
    values = motion.configurations[motion.rho].to_numpy()
    motion.configurations[motion.rho] = (values / 0.001).round() * 0.001
    made, _ = _checked(motion, tmp_path / "c")
    assert {row["state"] for row in made["belonging"].to_pylist()} == {"ok"}
