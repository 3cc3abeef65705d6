"""A campaign of an open chain from its folder to the page, predictions and the robot's description; and bad input."""

from __future__ import annotations

import csv
import hashlib
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from tests.blind.generator.arms import draw, write
from tests.changed_files import replace_text
from tests.packaging.source_tree import PROJECT
from tests.report.explained import unexplained
from tests.runs.test_robot_description import _textbook
from tests.stages.line import run_line
from truing.estimation.rotation import exp_so3
from truing.formats.urdf import read_urdf
from truing.pipeline.command_line import app
from truing.runs.comparison.side_by_side import mechanism_of
from truing.runs.recorded_run import load
from truing.schemas.faults import CampaignFaults
from truing.simulation.mechanisms.chains.extended_model import ExtendedChain

READINGS = ("axis_1_deg", "axis_2_deg", "axis_3_mm", "axis_4_deg")


def _truing(*arguments: str) -> tuple[int, str]:
    """Exit code and all output, on one line."""
    done = CliRunner().invoke(app, list(arguments))
    return done.exit_code, " ".join(done.output.split())


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three joints that turn and one that slides, without a direction of gravity; a joint moves too far."""
    made = draw(13, layout="scara", instrument="points-series", notation="urdf", causes=("joint-gain",), poses=36)
    folder = write(made, tmp_path_factory.mktemp("chain") / "arm")
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    (folder / "campaign.toml").write_text(re.sub(r"gravity = .*\n", "", text), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def run(campaign: Path) -> Path:
    folder = campaign.with_name("run")
    code, output = _truing("run", str(campaign), "--out", str(folder))
    assert code == 0, output
    return folder


def test_the_hidden_gain_is_found_with_its_size(campaign: Path, run: Path) -> None:
    (hidden,) = json.loads(campaign.with_name("arm.truth.json").read_text(encoding="utf-8"))["effects"]
    (found,) = [row for row in pq.read_table(run / "diagnosis.parquet").to_pylist() if row["verdict"] == "found"]
    assert (found["cause"], found["subject"]) == (hidden["cause"], hidden["subject"])
    gain = json.loads(found["parameters"])["gain"]
    (size,) = hidden["parameters"].values()
    size = size["value"] if isinstance(size, dict) else size
    assert abs(gain["value"] - size) < 4.0 * gain["sigma"] < 0.8 * abs(size)


def test_without_gravity_the_causes_by_weight_are_not_testable_and_the_need_is_named(run: Path) -> None:
    rows = {row["cause"]: row for row in pq.read_table(run / "diagnosis.parquet").to_pylist()}
    for cause in ("joint-compliance", "link-bending"):
        assert (rows[cause]["verdict"], rows[cause]["reason_code"]) == ("not testable", "no-weight")
        assert "[mechanism] gravity" in rows[cause]["explanation"]


def test_each_determined_number_of_the_chain_has_an_expanded_uncertainty_and_a_budget(run: Path) -> None:
    numbers = pq.read_table(run / "chain_parameters.parquet").to_pandas().set_index(["joint", "parameter"])
    of_chain = pq.read_table(run / "uncertainty.parquet").to_pandas().query("result == 'chain'")
    stated = of_chain[of_chain["stated"]].set_index(["subject", "quantity"])
    assert set(stated.index) == set(numbers.index[numbers["identifiable"]])
    assert set(of_chain.set_index(["subject", "quantity"]).index) == set(numbers.index)
    own = numbers.loc[stated.index]
    np.testing.assert_allclose(stated["standard_uncertainty"], own["sigma"], rtol=1e-6)
    np.testing.assert_allclose(stated["estimate"], own["identified"], rtol=1e-12)
    assert (stated["expanded_uncertainty"] > 1.9 * stated["standard_uncertainty"]).all()
    parts = pq.read_table(run / "chain_uncertainty.parquet").to_pandas().groupby(["joint", "parameter"])
    variance = parts["contribution"].apply(lambda sizes: float(np.sum(sizes**2)))
    np.testing.assert_allclose(np.sqrt(variance.loc[numbers.index]), numbers["sigma"], rtol=1e-6)
    reported = load(run).parameters().query("source == 'chain'").set_index(["subject", "parameter"])
    assert list(reported.index) == list(numbers.index)
    assert (reported["expanded_uncertainty"].notna() == numbers["identifiable"]).all()


def test_the_nominal_geometry_misses_the_poses_by_more_than_the_identified_one(run: Path) -> None:
    poses = pq.read_table(run / "prediction.parquet").to_pandas()
    squares = (
        poses.groupby("role")[["rms_nominal", "rms_before", "rms_after"]].agg(lambda own: (own**2).mean())
    ) ** 0.5
    assert set(squares.index) == {"calibration", "verification"}
    # The errors of links and zeros that the generator drew from their tolerances.
    assert (squares["rms_nominal"] > 3.0 * squares["rms_before"]).all()
    assert (squares["rms_before"] > squares["rms_after"]).all()


def test_errors_by_series_are_those_of_the_poses(campaign: Path, run: Path) -> None:
    of_series = pq.read_table(run / "series_errors.parquet").to_pandas()
    of_poses = pq.read_table(run / "prediction.parquet").to_pandas()
    table = pyarrow.csv.read_csv(campaign / "configurations.csv").to_pandas()
    of_poses["series"] = of_poses["pose"].map(dict(zip(table["pose"], table["series"], strict=True)))
    assert of_series["poses"].sum() == len(of_poses)
    for row in of_series.itertuples():
        own = of_poses[(of_poses["series"] == row.series) & (of_poses["role"] == row.role)]
        assert len(own) == row.poses
        assert own["rms_after"].min() <= row.rms_after <= own["rms_after"].max()
    # Poses differ in their number of seen targets by a few, which weigh them.
    fitted = of_series[of_series["role"] == "calibration"]
    own = of_poses[of_poses["role"] == "calibration"]
    before, after = (np.sqrt(np.average(fitted[c] ** 2, weights=fitted["poses"])) for c in ("rms_before", "rms_after"))
    assert after == pytest.approx(np.sqrt(np.mean(own["rms_after"] ** 2)), rel=0.05)
    assert after < before


def test_the_page_shows_the_chain_its_numbers_series_and_raw_files(campaign: Path, run: Path) -> None:
    sections = {section.id: section for section in load(run).sections}
    chain = sections["chain"]
    numbers, _, series = chain.listings
    table = pq.read_table(run / "chain_parameters.parquet").to_pandas()
    assert len(numbers.rows) == len(table)
    determined = [row[-1] for row in numbers.rows]
    assert determined == sorted(determined, reverse=True)  # yes before no
    assert determined.count("yes") == table["identifiable"].sum()
    assert len(series.rows) == pq.read_table(run / "series_errors.parquet").num_rows
    arm, errors = (figure for figure, _ in chain.figures)
    named = {trace.name for trace in arm.data}
    assert {"joints that turn", "joints that slide", "base: base_link", "targets"} <= named
    assert sum(len(trace.x) for trace in errors.data) == 2 * pq.read_table(run / "prediction.parquet").num_rows
    page = (run / "report.html").read_text(encoding="utf-8")
    assert not unexplained(page)
    for file in ("points.csv", "robot.urdf"):
        assert hashlib.sha256((campaign / file).read_bytes()).hexdigest() in page
    assert 'id="chain"' in page
    assert "without a mechanism" not in page


def test_the_exported_robot_and_the_prediction_agree_up_to_the_gain(campaign: Path, run: Path, tmp_path: Path) -> None:
    code, output = _truing("export", str(run), "--to", "urdf,controller", "--out", str(tmp_path))
    assert code == 0, output
    model = load(run).model
    assert isinstance(model, ExtendedChain)
    robot = read_urdf(tmp_path / "robot.urdf")
    table = (campaign / "configurations.csv").read_text(encoding="utf-8").splitlines()
    (tmp_path / "few.csv").write_text("\n".join(table[:4]) + "\n", encoding="utf-8")
    out = tmp_path / "tip.parquet"
    assert _truing("predict", str(run / "model.toml"), str(tmp_path / "few.csv"), "--out", str(out))[0] == 0
    with (tmp_path / "joint_corrections.csv").open(encoding="utf-8", newline="") as stream:
        corrections = list(csv.DictReader(stream))
    gains = {row["joint"]: float(row["value"]) for row in corrections if row["correction"] == "gain"}
    assert len(gains) == 1
    rows, gaps = pyarrow.csv.read_csv(tmp_path / "few.csv").to_pylist(), []
    for row, predicted in zip(rows, pq.read_table(out).to_pylist(), strict=True):
        read = {}
        for column in READINGS:
            joint, _, unit = column.rpartition("_")
            read[joint] = row[column] * (1e-3 if unit == "mm" else np.pi / 180.0)
        frames = model.identified.frames(np.array([list(read.values())]))
        plain = _textbook(robot, read, "tool0")
        assert np.abs(plain[:3, 3] - frames.t[0, model.tip]).max() < 1e-9
        assert np.abs(plain[:3, :3] - frames.R[0, model.tip]).max() < 1e-9
        corrected = _textbook(robot, {joint: (1.0 + gains.get(joint, 0.0)) * q for joint, q in read.items()}, "tool0")
        place = 1e-3 * np.array([predicted[f"p{axis}_mm"] for axis in "xyz"])
        turn = exp_so3(np.array([predicted[f"r{axis}_rad"] for axis in "xyz"]))
        # The model adds the gain to the frame before the joint moves: the same to the product of small rotations.
        gaps.append((np.abs(corrected[:3, 3] - place).max(), np.abs(plain[:3, 3] - place).max()))
        assert np.abs(corrected[:3, :3] - turn).max() < 2e-6
    with_gain, without = np.max(gaps, axis=0)
    assert with_gain < 2e-6 < without / 10.0


def test_the_exported_map_holds_each_error_of_the_tip_at_its_place(run: Path, tmp_path: Path) -> None:
    code, output = _truing("export", str(run), "--to", "urdf", "--out", str(tmp_path))
    assert code == 0, output
    found = pyarrow.csv.read_csv(tmp_path / "tip_errors.csv").to_pandas().set_index("pose")
    errors = pq.read_table(run / "component_errors.parquet").to_pandas()
    wide = errors.pivot_table(index="pose", columns="component", values="missed")
    assert set(found.index) == set(wide.index)
    for axis in "xyz":
        np.testing.assert_allclose(found[f"d{axis}_mm"].loc[wide.index], wide[axis], rtol=1e-12)
    robot = read_urdf(tmp_path / "robot.urdf")
    table = pq.read_table(run / "configurations.parquet").to_pandas().set_index("pose")
    for pose in found.index[:5]:
        read = {column.rpartition("_")[0]: table.loc[pose, column] for column in READINGS}
        read = {joint: v * (1e-3 if joint == "axis_3" else np.pi / 180.0) for joint, v in read.items()}
        place = 1e3 * _textbook(robot, read, "tool0")[:3, 3]
        np.testing.assert_allclose(found.loc[pose, ["x_mm", "y_mm", "z_mm"]].to_numpy(float), place, atol=1e-6)


def test_chains_of_other_joints_are_other_machines(run: Path) -> None:
    assert mechanism_of(load(run)) == "chain of joints axis_1, axis_2, axis_3, axis_4"


@pytest.mark.parametrize(
    ("of", "old", "new", "expected"),
    [
        (
            "configurations.csv",
            "axis_2_deg",
            "axis_two_deg",
            "column axis_2: expected a column axis_2_deg or axis_2_rad",
        ),
        ("configurations.csv", "axis_2_deg", "axis_2_mm", "column axis_2_mm: expected a column axis_2_deg"),
        ("configurations.csv", "axis_3_mm", "axis_3_deg", "axis_3_mm or axis_3_m; joint axis_3 slides"),
        ("points.csv", ",tool0,", ",tool9,", "tool9"),
        ("campaign.toml", 'tip = "tool0"', 'tip = "tool1"', "a link of this file as [mechanism] tip"),
        (
            "campaign.toml",
            "[mechanism.tol",
            "gear_orders = { axis_3 = [50.0] }\n[mechanism.tol",
            "a joint that turns and is",
        ),
        ("campaign.toml", '"axis_4"]', '"axis_5"]', "a joint that moves and mimics no other"),
        ("campaign.toml", "[noise]", "[workspace.joints]\naxis_9_deg = [0, 1]\n[noise]", "the column of a joint; did"),
        (
            "campaign.toml",
            "[noise]",
            "[workspace.joints]\naxis_1_deg = [0.0, 1.0]\naxis_1_rad = [0.0, 1.0]\n[noise]",
            "key workspace.joints.axis_1_rad: found '[0, 1]'; expected one column for joint axis_1",
        ),
    ],
)
def test_bad_input_is_named_with_its_place(
    campaign: Path, tmp_path: Path, of: str, old: str, new: str, expected: str
) -> None:
    folder = shutil.copytree(campaign, tmp_path / "c")
    replace_text(folder / of, old, new)
    code, output = _truing("check", str(folder))
    assert code == 2
    assert expected in output


def test_a_robot_description_with_macros_names_the_command_that_expands_them(campaign: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(campaign, tmp_path / "c")
    replace_text(folder / "robot.urdf", "</robot>", "<xacro:arm prefix='a'/></robot>")
    replace_text(folder / "robot.urdf", "<robot ", '<robot xmlns:xacro="http://ros.org/wiki/xacro" ', 1)
    code, output = _truing("check", str(folder))
    assert code == 2
    assert "robot.urdf" in output
    assert "xacro robot.urdf.xacro > robot.urdf" in output


def test_faults_of_the_description_and_of_a_table_are_reported_together(tmp_path: Path) -> None:
    campaign = shutil.copytree(PROJECT / "sample_data" / "robot", tmp_path / "robot")
    settings, table = campaign / "campaign.toml", campaign / "configurations.csv"
    settings.write_text(settings.read_text().replace('tip = "tool0"', 'tip = "tool9"'))
    lines = table.read_text().splitlines()
    cells = lines[4].split(",")
    lines[4] = ",".join([*cells[:3], "abc", *cells[4:]])
    table.write_text("\n".join(lines) + "\n")
    with pytest.raises(CampaignFaults) as raised:
        run_line(campaign, "ingest")
    assert {fault.file for fault in raised.value.faults} == {"robot.urdf", "configurations.csv"}
    assert {fault.value for fault in raised.value.faults} == {"tool9", "abc"}
