"""Slips in single numbers of a chain's description are named, on an arm with hand-written kinematics."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from truing.pipeline.in_memory import stage_line

COUNT = 26
# a (mm), alpha (deg), d (mm), theta (deg) of standard rows
ROWS = ((180.0, -90.0, 410.0, 0.0), (530.0, 0.0, 0.0, -90.0), (0.0, 90.0, 95.0, 30.0), (60.0, 0.0, 310.0, 0.0))
Rows = list[list[float]]


def turn(angle: float, axis: int) -> np.ndarray:
    """Rotation (4, 4) about a coordinate axis."""
    found, j, k = np.eye(4), (axis + 1) % 3, (axis + 2) % 3
    found[j, j] = found[k, k] = np.cos(angle)
    found[k, j], found[j, k] = np.sin(angle), -np.sin(angle)
    return found


def shifted(x: float, y: float, z: float) -> np.ndarray:
    found = np.eye(4)
    found[:3, 3] = x, y, z
    return found


def tip(angles: np.ndarray) -> np.ndarray:
    """Pose (4, 4) of the last link, mm, at readings (4,), rad."""
    pose = np.eye(4)
    for (a, alpha, d, theta), angle in zip(ROWS, angles, strict=True):
        pose = pose @ turn(np.radians(theta) + angle, 2) @ shifted(0.0, 0.0, d) @ shifted(a, 0.0, 0.0)
        pose = pose @ turn(np.radians(alpha), 0)
    return pose


def campaign(folder: Path, spoil: Callable[[Rows], None], seed: int = 8, copies: int = 1, extra: str = "") -> Path:
    """An arm with a reflector, seen by a tracker that stood still; ``copies``: the same poses several times."""
    rng = np.random.default_rng(seed)
    readings = rng.uniform(-1.3, 1.3, (COUNT, 4))
    base = turn(0.4, 2) @ turn(1.1, 0) @ shifted(900.0, -300.0, 150.0)
    places = np.array([(base @ tip(row) @ [35.0, -20.0, 48.0, 1.0])[:3] for row in readings])
    places = np.round(places + 0.02 * rng.normal(size=places.shape), 4)
    rows = [list(row) for row in ROWS]
    spoil(rows)
    names = ("a_mm", "alpha_deg", "d_mm", "theta_deg")
    table = ", ".join(
        "{ " + ", ".join(f"{name} = {value!r}" for name, value in zip(names, map(float, row), strict=True)) + " }"
        for row in rows
    )
    folder.mkdir()
    (folder / "campaign.toml").write_text(
        f'[campaign]\nname = "arm"\nkind = "photogrammetry"\n[mechanism]\ntype = "chain"\ndh = [{table}]\n{extra}\n'
        '[measurement]\nframe = "campaign"\n[noise]\npoint_mm = 0.02\njoint_deg = 0.001\n',
        encoding="utf-8",
    )
    poses = pd.DataFrame({"pose": np.arange(1, 1 + copies * COUNT)})
    for k in range(4):
        poses[f"joint{k + 1}_deg"] = np.tile(np.round(np.degrees(readings[:, k]), 5), copies)
    poses.assign(role="calibration", time_s=60.0 * poses["pose"]).to_csv(folder / "configurations.csv", index=False)
    points = pd.DataFrame(np.tile(places, (copies, 1)), columns=["x_mm", "y_mm", "z_mm"])
    points.assign(pose=poses["pose"], body="tip", target="S").to_csv(folder / "points.csv", index=False)
    return folder


def relations(folder: Path) -> dict[str, tuple[str, list[dict[str, object]]]]:
    """State and slips, rivals behind them, of each relation."""
    table = stage_line(str(folder)).call("ingest", "qa").tables["belonging"].to_pylist()
    return {row["relation"]: (row["state"], [*json.loads(row["slips"]), *json.loads(row["rivals"])]) for row in table}


def sign_of_a(rows: Rows) -> None:
    rows[1][0] *= -1.0


def sign_of_d(rows: Rows) -> None:
    rows[2][2] *= -1.0


def a_and_d(rows: Rows) -> None:
    for row in rows:
        row[0], row[2] = row[2], row[0]


def one_length_in_inches(rows: Rows) -> None:
    rows[1][0] /= 25.4


def exchanged_rows(rows: Rows) -> None:
    rows[1], rows[2] = rows[2], rows[1]


@pytest.mark.parametrize(
    ("spoil", "kind", "quantity", "subjects"),
    [
        (sign_of_a, "sign", "a_mm of rows", ["2"]),
        (sign_of_d, "sign", "d_mm of rows", ["3"]),
        (a_and_d, "columns-exchanged", "columns of rows", ["a_mm", "d_mm"]),
        (one_length_in_inches, "unit", "a_mm of rows", ["2"]),
        (exchanged_rows, "rows-exchanged", "rows", ["2", "3"]),
    ],
)
def test_a_slip_in_a_row_of_the_description_is_named(
    tmp_path: Path, spoil: Callable[[Rows], None], kind: str, quantity: str, subjects: list[str]
) -> None:
    state, slips = relations(campaign(tmp_path / "arm", spoil))["joints-against-links"]
    assert state == "fails"
    named = [(slip["kind"], slip["quantity"], slip["subjects"]) for slip in slips]
    assert (kind, f"{quantity} of [mechanism] dh", subjects) in named


def test_a_length_that_no_slip_explains_blames_no_single_poses(tmp_path: Path) -> None:
    def other_length(rows: Rows) -> None:
        rows[1][0] *= 0.91

    assert relations(campaign(tmp_path / "arm", other_length))["joints-against-links"] == ("fails", [])


@pytest.mark.parametrize("seed", range(5))
def test_an_arm_as_described_passes(tmp_path: Path, seed: int) -> None:
    extra = "payload_kg = 4.0\npayload_com_mm = [10.0, 0.0, 50.0]"
    found = relations(campaign(tmp_path / "arm", lambda rows: None, seed, extra=extra))
    assert {name: state for name, (state, _) in found.items()} == {
        "joints-against-links": "ok",
        "copied-poses": "ok",
        "masses-against-lengths": "ok",
        "points-among-poses": found["points-among-poses"][0],
    }
    assert found["points-among-poses"][0] != "fails"


def test_a_file_given_twice_holds_copied_poses_though_readings_agree(tmp_path: Path) -> None:
    found = relations(campaign(tmp_path / "arm", lambda rows: None, copies=2))
    assert found["joints-against-links"][0] == "ok"
    state, slips = found["copied-poses"]
    assert state == "fails"
    assert [slip["subjects"] for slip in slips] == [[str(pose), str(pose + COUNT)] for pose in range(1, 1 + COUNT)]


@pytest.mark.parametrize(
    ("extra", "quantity", "factor"),
    [
        ("payload_kg = 900.0", None, 1.0),
        ("payload_kg = 4000.0", "payload_kg", 1e-3),
        ("payload_kg = 4.0\npayload_com_mm = [0.0, 0.02, 0.05]", "payload_com_mm", 1e3),
        ("payload_kg = 4.0\npayload_com_mm = [0.0, 20000.0, 50000.0]", "payload_com_mm", 1e-3),
    ],
)
def test_masses_in_grams_and_centres_in_metres_are_reported(
    tmp_path: Path, extra: str, quantity: str | None, factor: float
) -> None:
    state, slips = relations(campaign(tmp_path / "arm", lambda rows: None, extra=extra))["masses-against-lengths"]
    named = [(slip["quantity"], slip.get("factor", 1.0)) for slip in slips]
    assert (state, named) == (("ok", []) if quantity is None else ("fails", [(quantity, pytest.approx(factor))]))


MASSES = "payload_kg = {payload}\npayload_com_mm = [10.0, 0.0, 50.0]"


@pytest.mark.parametrize(("payload", "state"), [(4.0, "ok"), (60.0, "attention")])
def test_a_payload_heavier_than_all_links_is_asked_for(tmp_path: Path, payload: float, state: str) -> None:
    def masses(rows: Rows) -> None:
        return None

    folder = campaign(tmp_path / "arm", masses, extra=MASSES.format(payload=payload))
    toml = (folder / "campaign.toml").read_text()
    (folder / "campaign.toml").write_text(toml.replace("theta_deg = ", "mass_kg = 5.0, theta_deg = "))
    found, slips = relations(folder)["masses-against-lengths"]
    assert found == state
    assert [slip["quantity"] for slip in slips] == (["payload_kg"] if state == "attention" else [])


def test_pounds_and_newtons_are_listed_as_not_detectable(tmp_path: Path) -> None:
    folder = campaign(tmp_path / "arm", lambda rows: None, extra=MASSES.format(payload=4.0))
    table = stage_line(str(folder)).call("ingest", "qa").tables["belonging"].to_pylist()
    (row,) = (row for row in table if row["relation"] == "masses-against-lengths")
    assert [slip["quantity"] for slip in json.loads(row["hidden_slips"])] == ["payload_kg"]
