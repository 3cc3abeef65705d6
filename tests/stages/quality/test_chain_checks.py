"""Joint readings that contradict the measured links of a chain are named, and not diagnosed."""

from __future__ import annotations

import io
import json
import re
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from tests.packaging.source_tree import PROJECT
from truing.pipeline.command_line import app

ROBOT = PROJECT / "sample_data" / "robot"


def checked(
    folder: Path,
    changed: Callable[[pd.DataFrame], None] | None = None,
    decide: Callable[[Path], None] = lambda campaign: None,
) -> tuple[int, str, str]:
    """Exit code of the stage qa, and verdict and message of the joints, after a change of the table of readings."""
    campaign = shutil.copytree(ROBOT, folder / "robot")
    decide(campaign)
    if changed is not None:
        table = pd.read_csv(campaign / "configurations.csv")
        changed(table)
        table.to_csv(campaign / "configurations.csv", index=False)
    done = CliRunner().invoke(app, ["run", str(campaign), "--out", str(folder / "run"), "--only", "qa", "--quiet"])
    rows = pq.read_table(folder / "run" / "qa.parquet").to_pylist()
    (row,) = [row for row in rows if row["check"] == "joints-against-links"]
    return done.exit_code, row["verdict"], row["message"]


def reversed_elbow(table: pd.DataFrame) -> None:
    table["elbow_deg"] *= -1.0


def radians(table: pd.DataFrame) -> None:
    table["shoulder_deg"] = np.radians(table["shoulder_deg"])


def all_radians(table: pd.DataFrame) -> None:
    joints = [name for name in table if name.endswith("_deg")]
    table[joints] = np.radians(table[joints])


def a_row_too_far_down(table: pd.DataFrame) -> None:
    joints = [name for name in table if name.endswith("_deg")]
    table[joints] = np.roll(table[joints].to_numpy(), 1, 0)


def other_rows(table: pd.DataFrame) -> None:
    joints = [name for name in table if name.endswith("_deg")]
    table[joints] = table[joints].to_numpy()[np.random.default_rng(4).permutation(len(table))]


def reversed_rows(table: pd.DataFrame) -> None:
    joints = [name for name in table if name.endswith("_deg")]
    table[joints] = table[joints].to_numpy()[::-1]


def all_reversed(table: pd.DataFrame) -> None:
    joints = [name for name in table if name.endswith("_deg")]
    table[joints] *= -1.0


def exchanged(table: pd.DataFrame) -> None:
    table[["shoulder_deg", "elbow_deg"]] = table[["elbow_deg", "shoulder_deg"]].to_numpy()


def test_readings_of_the_robot_belong_to_its_links(tmp_path: Path) -> None:
    assert checked(tmp_path)[:2] == (0, "pass")


def three_wrong_rows(table: pd.DataFrame) -> None:
    table.loc[[4, 20, 41], "turn_deg"] += 90.0


def test_a_few_poses_far_off_fail_and_are_listed(tmp_path: Path) -> None:
    """The diagnosis would keep them: their targets agree with one another."""
    code, verdict, message = checked(tmp_path, three_wrong_rows)
    assert (code, verdict) == (3, "fail")
    assert "pose 5, pose 21, pose 42 far from the pose" in message


def test_a_wrong_target_of_the_base_blames_no_readings(tmp_path: Path) -> None:
    """It turns the frame of its pose, so that the tool seems far from where the joints put it."""

    def with_a_base(campaign: Path) -> None:
        points = pd.read_csv(campaign / "points.csv")
        places = 1e3 * np.random.default_rng(2).uniform(-0.5, 0.5, (4, 3))
        base = pd.DataFrame(places, columns=["x_mm", "y_mm", "z_mm"]).assign(target=["B1", "B2", "B3", "B4"])
        base = base.merge(points[["pose"]].drop_duplicates(), how="cross").assign(body="base_link")
        base.loc[base["pose"].isin([7, 19]) & base["target"].eq("B2"), "x_mm"] += 300.0
        pd.concat([points, base]).to_csv(campaign / "points.csv", index=False)
        text = (campaign / "campaign.toml").read_text(encoding="utf-8").replace('frame = "campaign"', 'frame = "pose"')
        (campaign / "campaign.toml").write_text(text, encoding="utf-8")

    assert checked(tmp_path, None, with_a_base)[:2] == (0, "pass")
    assert checked(tmp_path / "b", three_wrong_rows, with_a_base)[1] == "fail"


def test_targets_that_some_poses_lack_are_used_one_by_one(tmp_path: Path) -> None:
    """A chain needs no frame of its tool in each pose, so a pose with two of its targets is not lost."""

    def hidden(campaign: Path) -> None:
        points = pd.read_csv(campaign / "points.csv")
        targets = sorted(points["target"].unique())
        kept = targets[:3]
        lost = points["target"].eq(kept[2]) & (points["pose"] % 5 < 2)
        points[points["target"].isin(kept) & ~lost].to_csv(campaign / "points.csv", index=False)

    assert checked(tmp_path, None, hidden)[:2] == (0, "pass")


def a_wrong_target_of_the_tool(campaign: Path) -> None:
    table = pd.read_csv(campaign / "points.csv")
    table.loc[table["pose"] == 12, ["x_mm", "y_mm", "z_mm"]] += [60.0, -40.0, 20.0]
    table.to_csv(campaign / "points.csv", index=False)


def test_a_single_pose_far_off_is_reported_while_the_others_belong(tmp_path: Path) -> None:
    """Of many poses a single one hardly raises the misfit of all."""
    code, verdict, message = checked(tmp_path, None, a_wrong_target_of_the_tool)
    assert (code, verdict) == (0, "warn")
    assert "belong together" in message
    assert "except readings of pose 12 far" in message


def test_poses_that_a_person_excludes_are_not_tested(tmp_path: Path) -> None:
    def exclude(campaign: Path) -> None:
        with (campaign / "campaign.toml").open("a", encoding="utf-8") as file:
            file.writelines(f'\n[[exclude]]\npose = {pose}\nby = "me"\nreason = "misread"\n' for pose in (5, 21, 42))

    assert checked(tmp_path, three_wrong_rows, exclude)[1] == "pass"


def exchanged_rows(table: pd.DataFrame) -> None:
    joints = [name for name in table if name.endswith("_deg")]
    table.loc[[8, 17], joints] = table.loc[[17, 8], joints].to_numpy()


def later_sign(table: pd.DataFrame) -> None:
    table.loc[40:, "bend_deg"] *= -1.0


@pytest.mark.parametrize(
    ("changed", "named"),
    [(exchanged_rows, "exchanged rows: pose 9, pose 18?"), (later_sign, "bend_deg, from pose 41 on with the opposite")],
)
def test_a_slip_in_some_rows_fails_and_is_named(
    tmp_path: Path, changed: Callable[[pd.DataFrame], None], named: str
) -> None:
    code, verdict, message = checked(tmp_path, changed)
    assert (code, verdict) == (3, "fail")
    assert named in message


def test_a_moved_instrument_is_named_with_its_first_pose(tmp_path: Path) -> None:
    def moved(campaign: Path) -> None:
        table = pd.read_csv(campaign / "points.csv")
        late, place = table["pose"] > 40, ["x_mm", "y_mm", "z_mm"]
        turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
        table.loc[late, place] = table.loc[late, place].to_numpy() @ (turn * np.linalg.det(turn)) + [300.0, 0.0, 50.0]
        table.to_csv(campaign / "points.csv", index=False)

    code, verdict, message = checked(tmp_path, None, moved)
    assert (code, verdict) == (3, "fail")
    assert "from pose 41 on in another frame" in message


def test_measurements_under_the_name_of_another_link_are_reported(tmp_path: Path) -> None:
    def on_the_forearm(campaign: Path) -> None:
        for name in ("points.csv", "targets.csv"):
            table = pd.read_csv(campaign / name)
            table["body"] = "forearm"
            table[["body", "target"] if name == "targets.csv" else list(table)].to_csv(campaign / name, index=False)

    code, verdict, message = checked(tmp_path, None, on_the_forearm)
    assert (code, verdict) == (3, "fail")
    assert "measurements on link tool_flange, or one fixed to it, recorded: body forearm?" in message


def mirrored(campaign: Path) -> None:
    table = pd.read_csv(campaign / "points.csv")
    table["y_mm"] *= -1.0
    table.to_csv(campaign / "points.csv", index=False)


def survey(campaign: Path, changed: Callable[[np.ndarray], np.ndarray]) -> None:
    table, place = pd.read_csv(campaign / "targets.csv"), ["x_mm", "y_mm", "z_mm"]
    table[place] = changed(table[place].to_numpy(float, copy=True))
    table.to_csv(campaign / "targets.csv", index=False)


def lengths_in_mm(campaign: Path) -> None:
    def times_1000(found: re.Match[str]) -> str:
        return 'xyz="' + " ".join(f"{1000.0 * float(number):g}" for number in found[1].split()) + '" rpy'

    text = (campaign / "robot.urdf").read_text(encoding="utf-8")
    (campaign / "robot.urdf").write_text(re.sub(r'xyz="([^"]*)" rpy', times_1000, text), encoding="utf-8")


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        (mirrored, "measured positions mirrored"),
        (lengths_in_mm, "lengths of the chain's description in another unit: multiply by 0.001"),
        (
            partial(survey, changed=lambda xyz: xyz * [-1.0, 1.0, 1.0]),
            "x of the survey of body tool0 with the opposite",
        ),
        (partial(survey, changed=lambda xyz: np.roll(xyz, 1, 0)), "targets of tool0 under the names of others"),
        (
            partial(survey, changed=lambda xyz: xyz + np.array([40.0, 0.0, 90.0])),
            "survey of body tool0 in another frame",
        ),
    ],
)
def test_a_slip_of_all_positions_or_of_the_description_is_named(
    tmp_path: Path, changed: Callable[[Path], None], named: str
) -> None:
    campaign = shutil.copytree(ROBOT, tmp_path / "robot")
    changed(campaign)
    done = CliRunner().invoke(app, ["run", str(campaign), "--out", str(tmp_path / "run"), "--only", "qa", "--quiet"])
    rows = pq.read_table(tmp_path / "run" / "qa.parquet").to_pylist()
    (message,) = [row["message"] for row in rows if row["check"] == "joints-against-links"]
    assert done.exit_code == 3
    assert named in message


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        (reversed_elbow, "elbow_deg"),
        (radians, "shoulder_deg"),
        (all_radians, "multiply by 57.29578"),
        (a_row_too_far_down, "shifted by +1 row"),
        (reversed_rows, "reversed order"),
        (all_reversed, "turn_deg, shoulder_deg, elbow_deg, roll_deg, bend_deg, twist_deg with the opposite sign"),
    ],
)
def test_a_slip_in_a_column_fails_and_is_named(
    tmp_path: Path, changed: Callable[[pd.DataFrame], None], named: str
) -> None:
    code, verdict, message = checked(tmp_path, changed)
    assert (code, verdict) == (3, "fail")
    assert named in message


def test_readings_of_other_poses_fail_without_a_name(tmp_path: Path) -> None:
    code, verdict, message = checked(tmp_path, other_rows)
    assert (code, verdict) == (3, "fail")
    assert "_deg" not in message


def test_exchanged_columns_warn_because_the_diagnosis_can_correct_them(tmp_path: Path) -> None:
    code, verdict, message = checked(tmp_path, exchanged)
    assert (code, verdict) == (0, "warn")
    assert "shoulder_deg" in message
    assert "elbow_deg" in message


def other_zeros(table: pd.DataFrame) -> None:
    table["shoulder_deg"] += 12.0
    table["elbow_deg"] -= 7.0


def a_forgotten_right_angle(table: pd.DataFrame) -> None:
    table["elbow_deg"] += 90.0


@pytest.mark.parametrize(
    ("changed", "named"),
    [(other_zeros, ("shoulder_deg", "elbow_deg")), (a_forgotten_right_angle, ("elbow_deg",))],
)
def test_zeros_far_off_warn_because_the_diagnosis_can_correct_them(
    tmp_path: Path, changed: Callable[[pd.DataFrame], None], named: tuple[str, ...]
) -> None:
    code, verdict, message = checked(tmp_path, changed)
    assert (code, verdict) == (0, "warn")
    assert all(name in message for name in named)
    assert message.count("another zero") == len(named)


@pytest.fixture(scope="module")
def runs(robot_run: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Runs of the robot up to the diagnosis: as it is, and with a joint whose zero is off by a right angle."""
    off = tmp_path_factory.mktemp("off")
    campaign = shutil.copytree(ROBOT, off / "robot")
    table = pd.read_csv(campaign / "configurations.csv")
    a_forgotten_right_angle(table)
    table.to_csv(campaign / "configurations.csv", index=False)
    words = ["run", str(campaign), "--out", str(off / "run"), "--only", "diagnose", "--quiet"]
    assert CliRunner().invoke(app, words).exit_code == 0
    return {"right": robot_run, "off": off}


def test_a_zero_far_off_is_a_finding_with_its_size(runs: dict[str, Path]) -> None:
    def found_parameters(home: Path) -> dict[tuple[str, str], str]:
        rows = pq.read_table(home / "run" / "diagnosis.parquet").to_pylist()
        return {(row["cause"], row["subject"]): row["parameters"] for row in rows if row["verdict"] == "found"}

    right, off = found_parameters(runs["right"]), found_parameters(runs["off"])
    size = json.loads(off.pop(("joint-offset", "joint elbow")))["offset"]
    assert np.degrees(size["value"]) == pytest.approx(-90.0, abs=0.5)
    assert set(off) == set(right)


@pytest.mark.parametrize("name", ["right", "off"])
def test_a_model_predicts_surveyed_targets_of_its_own_campaign_to_the_noise(runs: dict[str, Path], name: str) -> None:
    run, campaign = runs[name] / "run", runs[name] / "robot"
    done = CliRunner().invoke(app, ["predict", str(run), str(campaign)])
    assert done.exit_code == 0, done.output
    rows = pd.read_csv(io.StringIO(done.stdout)).set_index("prediction_by")
    extended = rows.loc["extended"]
    assert rows.loc["nominal", "rms_error"] > 20.0 * extended["noise_rms"]
    assert 0.8 < extended["rms_error"] / extended["noise_rms"] < 1.25
