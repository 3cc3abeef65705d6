"""`truing design`: sentences, files, and refusals."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
import tomli_w
from click.testing import Result
from typer.testing import CliRunner

from tests.sentences import assert_says
from truing.pipeline.command_line import app

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data" / "telescope"
READINGS = [f"rho{leg}_mm" for leg in range(1, 7)]


def call(*words: object) -> Result:
    return CliRunner().invoke(app, ["design", *map(str, words)])


def campaign(folder: Path, **sections: Any) -> Path:
    """The sample's campaign.toml alone, sections exchanged; None takes one out."""
    document = tomllib.loads((SAMPLE / "campaign.toml").read_text(encoding="utf-8")) | sections
    folder.mkdir(exist_ok=True)
    kept = {name: section for name, section in document.items() if section is not None}
    (folder / "campaign.toml").write_text(tomli_w.dumps(kept), encoding="utf-8")
    return folder


def readings(table: Any, role: str | None = None) -> np.ndarray:
    rows = table if role is None else table.filter(pyarrow.compute.equal(table["role"], role))
    return np.column_stack([rows[name] for name in READINGS])


def share(text: str) -> float:
    return float(re.findall(r"D-efficiency ([\d.]+) %", text)[0])


def test_the_sample_is_designed_near_the_best_and_compared_with_what_it_has(tmp_path: Path) -> None:
    out = tmp_path / "chosen.csv"
    done = call(SAMPLE, "--poses", 40, "--verification", 6, "--within", "actuators", "--out", out)
    assert done.exit_code == 0, done.output
    assert share(done.output) > 99.5
    assert_says(done.output, "a_x a_y b_x b_y u_x u_y l", "7 x 6 legs", "held", "a_z, b_z")
    assert re.search(r"the campaign's own 41 poses: O1 = [\d.]+, 7[01]\.\d+ % of the best", done.output)
    table = pyarrow.csv.read_csv(out)
    assert table.schema.names == ["pose", "role", "time_s", *READINGS]
    assert table["pose"].to_pylist() == list(range(47))
    assert table["role"].to_pylist()[0] == "reference"
    assert np.abs(readings(table, "calibration") - 10.0).max() == pytest.approx(1.3, abs=1e-5)
    assert np.abs(readings(table, "verification") - 10.0).max() <= 1.3 + 1e-6
    assert len(readings(table, "verification")) == 6


def test_campaign_toml_alone_is_enough_and_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    place = campaign(tmp_path / "new")
    first, second, other = (call(place, "--poses", 12, "--within", "actuators", "--seed", seed) for seed in (1, 1, 2))
    assert first.exit_code == 0, first.output
    assert first.output == second.output != other.output
    assert_says(first.output, "noise.point_mm", "every leg")
    assert "campaign's own" not in first.output
    assert len(re.findall(r"^\d+,calibration,", first.output, re.MULTILINE)) == 12


def test_an_existing_set_is_extended_and_counted(tmp_path: Path) -> None:
    out = tmp_path / "more.parquet"
    done = call(SAMPLE, "--poses", 8, "--within", "actuators", "--extend", SAMPLE / "configurations.csv", "--out", out)
    assert done.exit_code == 0, done.output
    assert "8 configurations" in done.output
    assert "41 that are kept" in done.output
    table = pyarrow.parquet.read_table(out)
    assert table["pose"].to_pylist() == list(range(47, 55))
    assert set(table["role"].to_pylist()) == {"calibration"}


def test_forbidden_regions_are_kept_out_of(tmp_path: Path) -> None:
    avoid, out = tmp_path / "avoid.csv", tmp_path / "chosen.csv"
    avoid.write_text("rho1_min_mm,rho2_max_mm\n10.5,9.0\n,9.5\n", encoding="utf-8")
    done = call(SAMPLE, "--within", "actuators", "--avoid", avoid, "--verification", 5, "--out", out)
    assert done.exit_code == 0, done.output
    rho = readings(pyarrow.csv.read_csv(out))
    assert not np.any(rho[:, 1] < 9.5 - 1e-5)
    assert np.any(np.abs(rho[:, 1] - 9.5) < 1e-4)


def test_the_workspace_limits_poses_too(tmp_path: Path) -> None:
    from tests.simulation.mechanisms.telescope import telescope
    from truing.estimation.rotation import log_so3
    from truing.simulation.mechanisms.legs.kinematics import forward

    out = tmp_path / "chosen.csv"
    assert call(SAMPLE, "--out", out).exit_code == 0
    legs = telescope()
    reached = forward(legs, readings(pyarrow.csv.read_csv(out)) * 1e-3)
    home = forward(legs, legs.rho0[None])
    limits = np.array([1e-3, 1e-3, 1e-4, np.pi / 360, np.pi / 360])
    moved = np.column_stack([reached.p - home.p, log_so3(reached.R)[:, :2]]) / limits
    assert np.abs(moved).max() == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("method", ["direct", "ioops", "random"])
def test_other_estimators_are_less_accurate(method: str, tmp_path: Path) -> None:
    done = call(SAMPLE, "--within", "actuators", "--method", method, "--out", tmp_path / "chosen.csv")
    assert done.exit_code == 0, done.output
    low, high = {"direct": (90.0, 99.6), "ioops": (98.0, 99.9), "random": (15.0, 50.0)}[method]
    assert low < share(done.output) < high


def test_parameters_may_be_named(tmp_path: Path) -> None:
    done = call(SAMPLE, "--within", "actuators", "--parameters", "l,a_x, b_x", "--out", tmp_path / "chosen.csv")
    assert_says(done.output, "a_x b_x l", "3 x 6 legs", "held", "a_y, a_z, b_y, b_z, u_x, u_y", "not asked for")


def hexapod(count: int = 8) -> list[dict[str, Any]]:
    about = np.arange(count) * 2 * np.pi / count
    legs = []
    for i, angle in enumerate(about):
        other = angle + (0.5 if i % 2 else -0.5)
        a, b = 300 * np.array([np.cos(angle), np.sin(angle), 0]), 200 * np.array([np.cos(other), np.sin(other), 0])
        legs.append(
            {"a_mm": a.tolist(), "b_mm": b.tolist(), "length_mm": float(np.linalg.norm(b - a + np.array([0, 0, 400])))}
        )
    return legs


def test_any_legs_from_six_on_can_be_designed_for(tmp_path: Path) -> None:
    out = tmp_path / "chosen.csv"
    place = campaign(
        tmp_path / "ups", mechanism={"type": "ups", "legs": hexapod(7)}, workspace={"rho_mm": 15.0, "rz_deg": 3.0}
    )
    done = call(place, "--poses", 20, "--out", out)
    assert done.exit_code == 0, done.output
    assert "x 7 legs" in done.output
    assert share(done.output) > 95.0
    assert "rho7_mm" in pyarrow.csv.read_csv(out).schema.names


def test_poses_that_readings_do_not_determine_are_left_out_and_reported(tmp_path: Path) -> None:
    out = tmp_path / "chosen.csv"
    place = campaign(tmp_path / "wide", workspace={"rho_mm": 60.0})
    done = call(place, "--verification", 4, "--out", out)
    assert done.exit_code == 0, done.output
    assert re.search(r"over \d\d corners of the range, 2,000 points in it, \d more out of reach", done.output)
    assert share(done.output) > 99.0
    assert np.abs(readings(pyarrow.csv.read_csv(out)) - 10.0).max() <= 60.0 * (1 + 2e-6)


def test_a_set_does_not_begin_where_it_may_not_go(tmp_path: Path) -> None:
    avoid, out = tmp_path / "avoid.csv", tmp_path / "chosen.csv"
    avoid.write_text("rho1_min_mm,rho1_max_mm\n9.8,10.2\n", encoding="utf-8")
    done = call(SAMPLE, "--poses", 12, "--avoid", avoid, "--out", out)
    assert done.exit_code == 0, done.output
    assert_says(done.output, "reference configuration", "forbidden", "left out")
    table = pyarrow.csv.read_csv(out)
    assert set(table["role"].to_pylist()) == {"calibration"}
    first = np.array(table["rho1_mm"].to_pylist())
    assert np.all((first <= 9.8 + 1e-3) | (first >= 10.2 - 1e-3))


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("pose,role,rho1_mm,rho2_mm,rho3_mm,rho4_mm,rho5_mm,rho6_mm\n", "expected poses to keep"),
        ("pose,rho6_mm,rho6_mm\n1,10.0,10.0\n", "column rho6_mm: expected one column of that name"),
    ],
)
def test_a_set_that_cannot_be_extended_is_refused_in_a_line(rows: str, words: str, tmp_path: Path) -> None:
    given = tmp_path / "given.csv"
    given.write_text(rows, encoding="utf-8")
    done = call(SAMPLE, "--extend", given, "--out", tmp_path / "chosen.csv")
    assert done.exit_code == 2, done.output
    assert words in done.output


REFUSED: list[tuple[dict[str, Any], list[object], str]] = [
    ({"workspace": None}, [], "key workspace: expected pose and reading limits that bound the platform"),
    ({"workspace": {"x_mm": 1.0}}, [], "rho_mm, or, without --within actuators, all of x_mm y_mm z_mm rx_deg"),
    ({"mechanism": None}, [], "key mechanism.type: found 'none'; expected a mechanism whose configurations"),
    ({"mechanism": {"type": "ups", "legs": hexapod(4)}}, [], "key mechanism.legs: found '4'; expected six legs"),
    ({}, ["--poses", 6], "--poses: found '6'; expected at least 7 configurations"),
    ({}, ["--parameters", "a_w"], "--parameters: found 'a_w'; expected parameters of a leg: a_x, a_y"),
    ({}, ["--extend", "nowhere.csv"], "nowhere.csv: expected a file that exists"),
    ({}, ["--extend", SAMPLE / "points.csv"], "points.csv, column rho1_mm: expected a column of that name"),
    ({}, ["--avoid", SAMPLE / "points.csv"], "points.csv, column pose: expected rows of forbidden regions"),
    ({}, ["--out", "chosen.xls"], "--out: found 'chosen.xls'; expected a file that ends in .csv or .parquet"),
]


@pytest.mark.parametrize(("sections", "options", "words"), REFUSED, ids=[words[:40] for *_, words in REFUSED])
def test_settings_and_options_that_cannot_be_designed_are_a_fault(
    sections: dict[str, Any], options: list[object], words: str, tmp_path: Path
) -> None:
    done = call(campaign(tmp_path / "given", **sections), *options)
    assert done.exit_code == 2, done.output
    assert words in done.output
    assert "Traceback" not in done.output


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "rho1_min_mm,rho1_max_mm\n10.5,9.0\n",
            "row 2: expected a forbidden region with each minimum below its maximum",
        ),
        ("rho1_min_mm\n\n", "expected rows of forbidden regions"),
        ("rho1_min_mm\nabc\n", "column rho1_min_mm: expected numbers"),
        ("rho1_max_mm\n20.0\n", "expected forbidden regions that do not cover the whole workspace"),
    ],
)
def test_forbidden_regions_that_are_none_are_refused(text: str, words: str, tmp_path: Path) -> None:
    avoid = tmp_path / "avoid.csv"
    avoid.write_text(text, encoding="utf-8")
    done = call(campaign(tmp_path / "given"), "--avoid", avoid)
    assert done.exit_code == 2, done.output
    assert words in done.output


LOADS = ["fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm"]


def sensor(folder: Path, **sections: Any) -> Path:
    """The force sensor's campaign.toml alone, sections exchanged; None takes one out."""
    document = tomllib.loads((SAMPLE.parent / "force-sensor" / "campaign.toml").read_text(encoding="utf-8")) | sections
    folder.mkdir(exist_ok=True)
    kept = {name: section for name, section in document.items() if section is not None}
    (folder / "campaign.toml").write_text(tomli_w.dumps(kept), encoding="utf-8")
    return folder


def test_a_sensor_is_given_loads_and_its_own_are_assessed_next_to_them(tmp_path: Path) -> None:
    out = tmp_path / "loads.csv"
    done = call(SAMPLE.parent / "force-sensor", "--poses", 60, "--verification", 6, "--at-once", 2, "--out", out)
    assert done.exit_code == 0, done.output
    assert share(done.output) > 99.5
    assert re.search(r"the campaign's own 756 loads: [56]\.\d+ % of the best", done.output)
    table = pyarrow.csv.read_csv(out).to_pandas()
    loads = table[LOADS].to_numpy()
    assert list(table.columns) == ["run", "step", "time_s", "role", *LOADS]
    assert (table["role"] == "verification").sum() == 6 + 2  # a run begins and ends without load
    assert table["role"].eq("calibration").sum() == 60 + 2 * 6
    assert ((loads != 0.0).sum(axis=1) <= 2).all()
    assert (np.abs(loads) <= [1e4, 1e4, 1e4, 5e3, 5e3, 5e3]).all()
    ends = table.groupby("run")["step"].agg(["min", "max"])
    assert (loads[table["step"] == 0] == 0.0).all()
    assert len(ends) == 7


@pytest.mark.parametrize(
    ("words", "sections", "said"),
    [
        ([], {"loading": {"fx_n": 1e4}}, "key loading.mz_nm: expected the range of this load"),
        (["--poses", 5], {}, "expected at least 7"),
        (["--parameters", "a_x"], {}, "--parameters"),
    ],
)
def test_loads_that_cannot_be_chosen_are_refused(
    words: list[object], sections: dict[str, Any], said: str, tmp_path: Path
) -> None:
    done = call(sensor(tmp_path / "bench", **sections), *words)
    assert done.exit_code == 2, done.output
    assert said in done.output


def test_a_table_with_faults_is_no_obstacle_to_a_new_design(tmp_path: Path) -> None:
    place = campaign(tmp_path / "given")
    shutil.copy(SAMPLE / "targets.csv", place)
    (place / "configurations.csv").write_text("pose,role\n1,calibration\n", encoding="utf-8")
    done = call(place, "--poses", 10, "--within", "actuators")
    assert done.exit_code == 0, done.output
    assert_says(done.output, "noise of points", "surveyed targets")


def test_json_holds_the_chosen_poses_and_the_messages(tmp_path: Path) -> None:
    words = (campaign(tmp_path / "machine"), "--poses", 8, "--within", "actuators")
    reported = json.loads(call(*words, "--json").stdout)
    assert reported["exit_code"] == 0
    assert [row["pose"] for row in reported["chosen"]] == list(range(len(reported["chosen"])))
    assert {"role", *READINGS} <= set(reported["chosen"][0])
    spoken = call(*words).output
    assert reported["sentences"]
    assert all(row["sentence"] in spoken for row in reported["sentences"])
