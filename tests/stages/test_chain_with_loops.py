"""A delta robot with a laboratory's closure, from its folder to its findings and a predicted pose."""

from __future__ import annotations

import json
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner, Result

from tests.loops.delta_generator import Delta, Hidden, write
from truing.pipeline.command_line import app
from truing.schemas import installed

TOLERANCE = "\n[mechanism.tolerance]\noffset_deg = 0.02\nlength_mm = 0.1\nangle_deg = 0.02\n"


@pytest.fixture(autouse=True)
def _installed(monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint(name="delta", value="tests.loops.delta_closure:Delta", group="truing.loops")
    monkeypatch.setattr(installed, "entry_points", lambda group: [point] if group == point.group else [])


def run(folder: Path) -> Result:
    return CliRunner().invoke(app, ["run", str(folder), "--out", f"{folder}.run", "--only", "diagnose", "--quiet"])


def rows(folder: Path) -> list[dict[str, Any]]:
    done = run(folder)
    assert done.exit_code == 0, done.output
    return [row for row in pq.read_table(f"{folder}.run/diagnosis.parquet").to_pylist() if row["verdict"] == "found"]


def parameter(row: dict[str, Any], name: str) -> tuple[float, float]:
    entry = json.loads(row["parameters"])[name]
    return entry["value"], entry["sigma"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cause", "subject", "name", "size", "hidden"),
    [
        ("joint-offset", "joint arm_2", "offset", 2e-3, Hidden(Delta(zeros=np.array([0.0, 2e-3, 0.0])))),
        ("joint-backlash", "joint arm_1", "backlash", 3e-4, Hidden(Delta(), np.array([3e-4, 0.0, 0.0]))),
        ("link-growth", "link forearm_3", "growth", 6e-5, Hidden(Delta(growth=np.array([0.0, 0.0, 6e-5])))),
    ],
)
def test_an_error_of_a_delta_is_named_with_its_size(
    cause: str, subject: str, name: str, size: float, hidden: Hidden, tmp_path: Path
) -> None:
    found = rows(write(tmp_path / "delta", hidden, np.random.default_rng(11)))
    assert [(row["cause"], row["subject"]) for row in found] == [(cause, subject)]
    value, sigma = parameter(found[0], name)
    assert abs(value - size) < 4.0 * sigma < size


@pytest.mark.slow
def test_a_forearm_of_other_length_is_identified_and_predicted(tmp_path: Path) -> None:
    robot = Delta(longer=np.array([0.0, 0.0, 4e-4]))
    folder = write(tmp_path / "delta", Hidden(robot), np.random.default_rng(12), tolerance=TOLERANCE)
    assert rows(folder) == []
    known = pq.read_table(f"{folder}.run/chain_parameters.parquet").to_pylist()
    row = next(row for row in known if row["joint"] == "length_3" and row["parameter"] == "dz")
    assert abs(row["identified"] + 0.4) < 4.0 * row["sigma"]
    assert abs(row["identified"]) > 3.0 * row["sigma"], "the length is distinguished from zero"
    _assert_predicted(folder, robot)


def _assert_predicted(folder: Path, robot: Delta) -> None:
    from truing.simulation.mechanisms.chains.extended_model import read_chain

    extended = read_chain(Path(f"{folder}.run/model.toml").read_text(encoding="utf-8"))
    q = np.random.default_rng(13).uniform(-0.4, 0.8, (20, 3))
    tree = extended.identified
    places = tree.frames(q).t[:, tree.links["platform"]]
    wanted, nominal = (own.centres(q, np.zeros(20)) for own in (robot, Delta()))
    away, before = (places - wanted) - (places - wanted).mean(0), (nominal - wanted) - (nominal - wanted).mean(0)
    # A turn of the whole robot goes with the unknown base.
    assert np.sqrt(np.mean(_beside_a_turn(away, wanted) ** 2)) < 0.1 * np.sqrt(np.mean(before**2))


def _beside_a_turn(away: np.ndarray, places: np.ndarray) -> np.ndarray:
    centred = places - places.mean(0)
    turns = np.stack([np.cross(axis, centred) for axis in np.eye(3)], -1).reshape(-1, 3)
    flat = away.ravel()
    return flat - turns @ np.linalg.lstsq(turns, flat, rcond=None)[0]


def test_a_closure_that_is_not_installed_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installed, "entry_points", lambda group: [])
    done = run(write(tmp_path / "delta", Hidden(Delta()), np.random.default_rng(1), poses=12))
    assert done.exit_code == 2
    assert "mechanism.closure" in done.output
    assert "delta" in done.output


def test_poses_at_which_no_loop_closes_are_reported(tmp_path: Path) -> None:
    folder = write(tmp_path / "delta", Hidden(Delta()), np.random.default_rng(1), poses=12)
    text = (folder / "delta.urdf").read_text(encoding="utf-8")
    assert text.count("-0.55") == 3
    (folder / "delta.urdf").write_text(text.replace("-0.55", "-0.20"), encoding="utf-8")
    done = run(folder)
    assert done.exit_code == 2
    assert "the loops of the chain close" in done.output


def test_loops_need_the_joints_that_are_read(tmp_path: Path) -> None:
    folder = write(tmp_path / "delta", Hidden(Delta()), np.random.default_rng(1), poses=12)
    file = folder / "campaign.toml"
    text = file.read_text(encoding="utf-8").replace('joints = ["arm_1", "arm_2", "arm_3"]\n', "")
    file.write_text(text, encoding="utf-8")
    done = run(folder)
    assert done.exit_code == 2
    assert "the joints that are read next to closure" in " ".join(done.output.split())
