"""`truing design` for an open chain: chosen poses, what they determine, forbidden regions, and bad input."""

from __future__ import annotations

import csv
import re
import shutil
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from click.testing import Result
from typer.testing import CliRunner

from tests.packaging.source_tree import PROJECT
from tests.sentences import assert_says
from truing.pipeline.command_line import app

SAMPLE = PROJECT / "sample_data" / "robot"
JOINTS = ("turn", "shoulder", "elbow", "roll", "bend", "twist")
COLUMNS = [f"{joint}_deg" for joint in JOINTS]
LIMITS = np.array([[-150, 150], [-45, 75], [-120, 60], [-170, 170], [-100, 100], [-175, 175]], float)


def call(*words: object, command: str = "design") -> Result:
    return CliRunner().invoke(app, [command, *map(str, words)])


def planned(folder: Path, *left_out: str, workspace: str = "") -> Path:
    """The sample's description and planned targets, without any measurement."""
    folder.mkdir()
    for name in ("campaign.toml", "robot.urdf", "targets.csv"):
        if name not in left_out:
            shutil.copy(SAMPLE / name, folder / name)
    (folder / "campaign.toml").write_text((folder / "campaign.toml").read_text() + workspace)
    return folder


def readings(place: Path, role: str | None = None) -> np.ndarray:
    table = pyarrow.csv.read_csv(place)
    rows = table if role is None else table.filter(pyarrow.compute.equal(table["role"], role))
    return np.column_stack([rows[name] for name in COLUMNS])


@pytest.fixture(scope="module")
def designed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    out = tmp_path_factory.mktemp("designed") / "plan.csv"
    done = call(SAMPLE, "--poses", 30, "--verification", 4, "--out", out)
    assert done.exit_code == 0, done.output
    return out, " ".join(done.output.split())


def numbers(place: Path, poses: str) -> dict[tuple[str, str, str], dict[str, str]]:
    with place.with_name("plan-numbers.csv").open(newline="") as stream:
        return {(r["kind"], r["subject"], r["parameter"]): r for r in csv.DictReader(stream) if r["poses"] == poses}


def test_poses_lie_within_the_limits_and_near_the_proven_best(designed: tuple[Path, str]) -> None:
    out, output = designed
    efficiency, own = (float(text) for text in re.findall(r"([\d.]+) % of the best", output))
    assert 95.0 < efficiency <= 100.0
    assert 30.0 < own < efficiency  # the sample's poses were not chosen
    found = readings(out)
    assert found.shape == (34, 6)
    assert (found > LIMITS[:, 0] - 1e-3).all()
    assert (found < LIMITS[:, 1] + 1e-3).all()
    assert len(readings(out, "verification")) == 4


def test_expected_sigmas_are_those_of_the_diagnosis(designed: tuple[Path, str], robot_run: Path) -> None:
    """Of the campaign's own poses; the diagnosis also fits the effects that it found, and estimates the noise."""
    rows = pq.read_table(robot_run / "run" / "chain_parameters.parquet").to_pylist()
    sigma = {row["joint"]: row["sigma"] for row in rows if row["parameter"] == "offset"}
    own = numbers(designed[0], "own")
    assert set(sigma) == set(JOINTS)
    for joint in JOINTS:
        expected = float(own["offset", joint, "offset"]["sigma_expected"])
        assert 0.5 * expected < sigma[joint] < 2.0 * expected


def test_a_zero_that_the_free_base_hides_is_named_with_what_would_show_it(designed: tuple[Path, str]) -> None:
    _, output = designed
    assert re.search(
        r"base turn_z : turn offset = −1 : 1 is unobservable: no pose within the ranges shows it; targets of", output
    )
    hidden, shown = (numbers(designed[0], "plan")["offset", joint, "offset"] for joint in ("turn", "bend"))
    assert (hidden["identifiable"], shown["identifiable"]) == ("false", "true")
    assert hidden["sigma_data_alone"] == ""


def test_chosen_poses_know_the_zeros_better_than_fewer_of_the_same_number_at_random(tmp_path: Path) -> None:
    place, sizes = planned(tmp_path / "new"), {}
    for method in ("exchange", "random"):
        out = tmp_path / method / "plan.csv"
        out.parent.mkdir()
        assert call(place, "--poses", 12, "--method", method, "--out", out).exit_code == 0
        found = numbers(out, "plan")
        links = [float(row["sigma_expected"]) / float(row["tolerance"]) for row in found.values() if row["tolerance"]]
        sizes[method] = float(np.mean(np.log(links)))
    assert sizes["exchange"] < sizes["random"]


def test_forbidden_boxes_hold_for_readings_and_for_places_of_links(tmp_path: Path) -> None:
    place = planned(tmp_path / "new", workspace="\n[workspace.joints]\nelbow_deg = [-90.0, 30.0]\n")
    avoid = tmp_path / "avoid.csv"
    avoid.write_text("link,turn_min_deg,turn_max_deg,z_max_mm\nforearm wrist tool_flange tool0,,,300\ntool0,0,90,900\n")
    out = tmp_path / "plan.csv"
    done = call(place, "--poses", 20, "--avoid", avoid, "--out", out)
    assert done.exit_code == 0, done.output
    assert_says(" ".join(done.output.split()), "[workspace] joints", "outside 2 forbidden regions")
    found = readings(out)
    assert found[:, 2].min() >= -90.0
    assert found[:, 2].max() <= 30.0
    from tests.runs.test_robot_description import _textbook
    from truing.formats.urdf import read_urdf

    robot = read_urdf(SAMPLE / "robot.urdf")
    heights = {link: [] for link in ("forearm", "wrist", "tool_flange", "tool0")}
    for row in found:
        pose = dict(zip(JOINTS, np.radians(row), strict=True))
        for link in heights:
            heights[link].append(1e3 * _textbook(robot, pose, link)[2, 3])
    assert min(map(min, heights.values())) >= 300.0
    tip, between = np.array(heights["tool0"]), (found[:, 0] > 0.0) & (found[:, 0] < 90.0)
    assert between.any()
    assert tip[between].min() >= 900.0
    assert tip[~between].min() < 900.0


def test_a_function_of_an_installed_module_forbids_poses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_cell.py").write_text(
        "def behind(readings, places):\n    return (readings['turn_deg'] > 90.0) | (places['tool0'][:, 0] < 0.0)\n"
        "def wrong(readings, places):\n    return [True]\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    out = tmp_path / "plan.csv"
    place = planned(tmp_path / "new")
    done = call(place, "--poses", 8, "--avoid", "my_cell:behind", "--out", out)
    assert done.exit_code == 0, done.output
    assert readings(out)[:, 0].max() <= 90.0
    for name, expected in (("my_cell:wrong", "a mask of"), ("my_cell:absent", "a function of an installed module")):
        done = call(place, "--poses", 8, "--avoid", name)
        assert done.exit_code == 2
        assert_says(" ".join(done.output.split()), expected)


def test_poses_that_are_kept_count_and_a_cause_joins_the_unknowns(tmp_path: Path) -> None:
    place, out = planned(tmp_path / "new"), tmp_path / "plan.csv"
    done = call(
        place, "--poses", 6, "--extend", SAMPLE / "configurations.csv", "--causes", "joint-compliance", "--out", out
    )
    assert done.exit_code == 0, done.output
    assert_says(
        " ".join(done.output.split()),
        "next to 60 that are kept",
        "with the effects of joint-compliance",
        "the kept and chosen 66 poses",
    )
    table = pyarrow.csv.read_csv(out)
    assert min(table["pose"].to_pylist()) > 60


@pytest.mark.parametrize(
    ("left_out", "workspace", "words", "expected"),
    [
        ("targets.csv", "", (), "needs targets.csv with planned places of targets on links"),
        ("", "\n[workspace.joints]\nelbo_deg = [0.0, 1.0]\n", (), "key workspace.joints.elbo_deg"),
        (
            "",
            "\n[workspace.joints]\nelbow_deg = [1.0, 0.0]\n",
            (),
            "the lowest reading before the highest, not elbow_deg",
        ),
        ("", "", ("--method", "direct"), "exchange, ioops or random"),
        ("", "", ("--parameters", "a_x"), "--parameters"),
        ("", "", ("--causes", "leg-drift"), "causes that poses of this chain can show"),
    ],
)
def test_bad_input_is_named(
    tmp_path: Path, left_out: str, workspace: str, words: tuple[str, ...], expected: str
) -> None:
    done = call(planned(tmp_path / "new", left_out, workspace=workspace), "--poses", 8, *words)
    assert done.exit_code == 2
    assert_says(" ".join(done.output.split()), expected)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("rho1_min_mm\n1\n", "column rho1_min_mm"),
        ("link,z_max_mm\nhand,1\n", "row 2, column link"),
        ("z_min_mm,z_max_mm\n2,1\n", "row 2"),
        ("z_max_mm\n9000\n", "regions that leave a pose"),
        ("z_max_mm\n9000\n", "row 2"),
    ],
)
def test_faults_of_forbidden_regions_name_their_place(tmp_path: Path, text: str, expected: str) -> None:
    avoid = tmp_path / "avoid.csv"
    avoid.write_text(text)
    done = call(planned(tmp_path / "new"), "--poses", 8, "--avoid", avoid)
    assert done.exit_code == 2
    assert_says(" ".join(done.output.split()), expected)


def test_poses_in_several_frames_are_not_rated_against_those_in_one(tmp_path: Path) -> None:
    from tests.blind.generator.arms import draw, write

    place = write(draw(21, instrument="points-series", causes=("joint-gain",), poses=40), tmp_path / "arm")
    done = call(place, "--poses", 12)
    assert done.exit_code == 0, done.output
    assert "of the best possible" in done.output
    assert "of the best of as many" not in done.output
