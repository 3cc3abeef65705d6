"""Two slides whose target was measured in their plane alone: z is zero in every row."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.sentences import assert_says
from tests.stages.line import run_line

HOLES, NOISE_MM, GAIN = 150, 0.002, 8e-5
SETTINGS = """
[campaign]
name = "plate"
kind = "photogrammetry"
[mechanism]
type = "chain"
joints = ["x", "y"]
screws = [{ axis = [1, 0, 0], kind = "prismatic" }, { axis = [0, 1, 0], kind = "prismatic" }]
home = { position_mm = [0, 0, 0] }
[measurement]
frame = "campaign"
[noise]
point_mm = 0.002
[files.configurations]
path = "holes.txt"
header = false
number_rows = { pose = 1 }
columns = { x_mm = 3, y_mm = 4 }
[files.points]
path = "holes.txt"
header = false
number_rows = { pose = 1 }
constants = { body = "tip", target = "hole", z_mm = 0 }
columns = { x_mm = 1, y_mm = 2 }
"""


def holes(folder: Path, gain: float) -> Path:
    """A campaign of drilled holes: the slide x travels (1 + gain) times as far as commanded."""
    rng = np.random.default_rng(3)
    q = rng.uniform(-300.0, 300.0, (HOLES, 2))
    c, s = np.cos(1e-3), np.sin(1e-3)
    place = (q * [1.0 + gain, 1.0]) @ np.array([[c, s], [-s, c]]) + [10.0, 20.0]
    rows = np.c_[place + rng.normal(0.0, NOISE_MM, q.shape), q]
    folder.mkdir()
    (folder / "campaign.toml").write_text(SETTINGS)
    (folder / "holes.txt").write_text("\n".join(" ".join(f"{v:9.4f}" for v in row) for row in rows) + "\n")
    return folder


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> dict[str, pd.DataFrame]:
    made, _ = run_line(holes(tmp_path_factory.mktemp("plane") / "c", GAIN), "ingest", "qa", "diagnose")
    return {name: made[name].to_pandas() for name in ("qa", "diagnosis")}


def test_a_cause_is_found_though_one_coordinate_never_errs(tables: dict[str, pd.DataFrame]) -> None:
    found = tables["diagnosis"].query("verdict == 'found'")
    assert found[["cause", "subject"]].to_numpy().tolist() == [["joint-gain", "joint x"]]
    size = json.loads(found["parameters"].iloc[0])["gain"]
    assert abs(size["value"] - GAIN) < 4.0 * size["sigma"] < 0.1 * GAIN


def test_a_coordinate_that_was_not_measured_is_reported(tables: dict[str, pd.DataFrame]) -> None:
    checks = tables["qa"].set_index("check")
    row = checks.loc["coordinates-vary"]
    assert (row["verdict"], row["value"]) == ("warn", 1.0)
    assert_says(row["message"], "z is 0 mm", "150 points", "not measured")
    assert_says(row["message"], "two measured coordinates", "1.22 times")


def test_noise_that_nothing_shows_is_not_said_to_be_as_declared(tables: dict[str, pd.DataFrame]) -> None:
    assert tables["qa"].set_index("check").loc["noise-size"]["verdict"] == "not evaluated"
