"""`truing plan`: stations for a campaign's targets, tables and a page, and messages if there are none."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from tests.report.explained import unexplained
from tests.sentences import assert_says
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.command_line import app
from truing.pipeline.plan_command import known_cameras

SAMPLE = Path(__file__).parents[2] / "sample_data" / "telescope-images"

CAMPAIGN = """
[campaign]
name = "frame"
kind = "photogrammetry"

[noise]
image_px = 0.05

[[cameras]]
name = "camera"
width_px = 4000
height_px = 3000
pixel_um = 5.0
c_mm = 20.0
free = ["c", "x0", "y0", "A1"]
"""
TARGETS = "body,target,x_mm,y_mm,z_mm\n" + "".join(
    f"{body},{i},{x},{y},{z}\n"
    for body, z in (("table", 0.0), ("carriage", 60.0))
    for i, (x, y) in enumerate([(-200, -150), (200, -150), (200, 150), (-200, 150), (30, 0)])
)
BARS = "bar,first,second,length_mm,sigma_mm\nA,table/0,table/1,400.0,0.004\nB,elsewhere/0,elsewhere/1,500.0,0.004\n"
FEW = ("--directions", "10")


@pytest.fixture
def place(tmp_path):
    for name, text in (("campaign.toml", CAMPAIGN), ("targets.csv", TARGETS), ("scale_bars.csv", BARS)):
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


def plan(place, *options):
    return CliRunner().invoke(app, ["plan", str(place), *options])


def test_stations_for_what_is_wanted(place):
    found = plan(place, "--wanted", "0.02", *FEW, "--out", str(place / "plan.csv"))
    assert found.exit_code == 0, found.output
    assert "wanted 0.02 mm" in found.output
    assert "surveyed targets: B" in found.output
    stations, targets = pd.read_csv(place / "plan.csv"), pd.read_csv(place / "plan-targets.csv")
    curve, bodies = pd.read_csv(place / "plan-curve.csv"), pd.read_csv(place / "plan-bodies.csv")
    assert 3 <= len(stations) < 12
    assert targets["sigma_mm"].max() <= 0.02
    assert (targets["rays"] <= len(stations)).all()
    enough = curve.loc[curve["worst_mm"] <= 0.02, "stations"].min()
    assert len(stations) == enough
    assert curve["mean_mm"].is_monotonic_decreasing
    assert list(bodies["body"]) == ["table", "carriage"]
    assert (bodies[["position_mm", "rotation_urad"]] > 0).all(axis=None)
    page = (place / "plan.html").read_text(encoding="utf-8")
    assert "Where the cameras stand" in page
    assert not unexplained(page)


def test_an_error_below_that_of_the_scale_bars_is_out_of_reach(place):
    (place / "scale_bars.csv").write_text(BARS.replace("0.004", "0.2"), encoding="utf-8")
    found = plan(place, "--wanted", "0.01", "--stations", "6", *FEW, "--out", str(place / "plan.csv"))
    assert_says(found.output, "scale bars alone")
    assert set(pd.read_csv(place / "plan-targets.csv")["limited_by"]) == {"scale"}


def test_targets_that_face_away_are_reported(place):
    rows = "".join(
        f"{body},{i},0,0,{-1 if (body, i) == ('table', 4) else 1}\n" for body in ("table", "carriage") for i in range(5)
    )
    (place / "normals.csv").write_text(f"body,target,normal_x,normal_y,normal_z\n{rows}", encoding="utf-8")
    found = plan(
        place, *FEW, "--stations", "5", "--normals", str(place / "normals.csv"), "--out", str(place / "plan.csv")
    )
    assert found.exit_code == 0, found.output
    assert_says(found.output, "fewer than two", "table/4")
    targets = pd.read_csv(place / "plan-targets.csv").set_index(["body", "target"])
    assert targets.loc[("table", 4), "limited_by"] == "not seen twice"


@pytest.mark.parametrize(
    ("old", "new", "options", "expected"),
    [
        ("image_px = 0.05", "point_mm = 0.1", (), "key noise.image_px: expected the standard deviation"),
        ("c_mm = 20.0\n", "", (), "c_mm (with pixel_um) or focal_px"),
        ('name = "camera"', 'name = "one"', ("--camera", "two"), "the name of one: one"),
        ("", "", ("--distance", "500,100"), "the shorter one first"),
        ("", "", ("--elevation", "50,10"), "the lower one first"),
        ("", "", ("--distance", "10000,10001", "--least", "900"), "targets that can be photographed"),
        ("", "", ("--out", "plan.txt"), "a file that ends in .csv or .parquet"),
    ],
)
def test_settings_and_options_that_cannot_be_planned_are_a_fault(place, old, new, options, expected):
    (place / "campaign.toml").write_text(CAMPAIGN.replace(old, new, 1) if old else CAMPAIGN, encoding="utf-8")
    (place / "image_targets.csv").write_text(
        "family,code,body,target,diameter_mm\nring12,1,table,0,5\nring12,2,table,1,5\nring12,3,table,2,5\n"
        "ring12,4,table,3,5\nring12,5,table,4,5\nring12,6,carriage,0,5\nring12,7,carriage,1,5\n",
        encoding="utf-8",
    )
    found = plan(place, *FEW, *options)
    assert found.exit_code == 2, found.output
    assert expected in found.output


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("body,target,normal_x\ntable,0,1\n", "this column"),
        ("body,target,normal_x,normal_y,normal_z\ntable,99,0,0,1\n", "a surveyed target"),
        ("body,target,normal_x,normal_y,normal_z\ntable,0,0,0,0\n", "three numbers that make a direction"),
    ],
)
def test_normals_that_are_none_are_faults(place, text, expected):
    (place / "normals.csv").write_text(text, encoding="utf-8")
    found = plan(place, *FEW, "--normals", str(place / "normals.csv"))
    assert (found.exit_code, expected in found.output) == (2, True)


UNNAMED = CAMPAIGN.partition("[[cameras]]")[0].replace("image_px = 0.05", "point_mm = 0.01")


def left_by_a_run(folder, c_px):
    """The camera as a run adjusted it, and rays with their sigmas, one of them rejected."""
    from truing.estimation.bundle.camera import PARAMETERS
    from truing.schemas.artifacts import ARTIFACTS

    folder.mkdir(parents=True)
    form = {"width_px": 4000, "height_px": 3000, "balancing_radius_px": 1600.0, "sigma": 0.1, "pixel_um": None}
    camera = [
        {
            "camera": "cam",
            "parameter": name,
            "unit": "px",
            "value": c_px if name == "c" else 0.0,
            "free": name == "c",
            **form,
        }
        for name in PARAMETERS
    ]
    ray = {"pose": 1, "image": "a", "camera": "cam", "point": "1", "kind": "circle", "rejected": False}
    zeros = ("x_px", "y_px", "vx_px", "vy_px", "redundancy_x", "redundancy_y", "test_value")
    ray |= dict.fromkeys((*zeros, "eccentricity_x_px", "eccentricity_y_px"), 0.0)
    rays = [
        ray | {"sigma_x_px": 0.04, "sigma_y_px": 0.04},
        ray | {"rejected": True, "sigma_x_px": 9.0, "sigma_y_px": 9.0},
    ]
    for name, rows in (("cameras", camera), ("image_residuals", rays)):
        artifact = ARTIFACTS[name]
        pq.write_table(pa.Table.from_pylist(rows, schema=artifact.arrow_schema()), folder / artifact.file)


def test_a_camera_that_a_run_adjusted_is_taken_with_its_noise(place, monkeypatch):
    (place / "campaign.toml").write_text(UNNAMED, encoding="utf-8")
    monkeypatch.chdir(place)
    options = (*FEW, "--stations", "5", "--out", "plan.csv")
    found = plan(place, *options)
    assert (found.exit_code, "(--run)" in found.output) == (2, True)
    left_by_a_run(place / "runs" / "frame", 4000.0)
    found = plan(place, *options)
    assert found.exit_code == 0, found.output
    assert "camera cam" in found.output
    assert "runs/frame" in found.output
    assert "distance is 4000.0 px" in found.output
    assert "coordinate 0.04 px" in found.output
    (place / "campaign.toml").write_text(CAMPAIGN, encoding="utf-8")
    assert "as adjusted" not in plan(place, *options).output
    left_by_a_run(place / "other", 5000.0)
    found = plan(place, "--run", str(place / "other"), *options)
    assert "distance is 5000.0 px" in found.output
    assert "coordinate 0.05 px" in found.output
    found = plan(place, "--run", str(place / "none"), *options)
    assert found.exit_code == 2
    assert_says(found.output, "run", "adjusted photographs")


def test_assumed_visibility_of_a_plan_is_reported(place):
    options = (*FEW, "--stations", "4", "--out", str(place / "plan.csv"))
    assert_says(plan(place, *options).output, "no target", "normal")
    rows = "".join(f"table,{i},0,0,1\n" for i in range(5))
    (place / "normals.csv").write_text(f"body,target,normal_x,normal_y,normal_z\n{rows}", encoding="utf-8")
    output = plan(place, *options, "--normals", str(place / "normals.csv")).output
    assert_says(output, "nor", "object itself")
    assert_says(output, "5 of 10", "normal")


def test_without_a_run_the_photographs_give_their_camera(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = known_cameras(open_campaign(SAMPLE), None, None)
    assert_says(found.description, "photographs' metadata")
    (c,) = [row for row in found.table.to_pylist() if row["parameter"] == "c"]
    assert (c["camera"], c["width_px"], c["free"]) == ("camera", 1600, True)
    assert c["value"] == pytest.approx(2250.0, rel=1e-4)


def test_json_holds_stations_targets_and_files(place):
    reported = json.loads(plan(place, *FEW, "--stations", "4", "--out", str(place / "plan.csv"), "--json").stdout)
    assert reported["exit_code"] == 0
    assert len(reported["stations"]) == len(pd.read_csv(place / "plan.csv"))
    assert {row["target"] for row in reported["targets"]} == {"0", "1", "2", "3", "4"}
    assert str(place / "plan.html") in [row["file"] for row in reported["files"]]
