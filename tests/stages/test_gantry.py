"""A gantry of three slides with guideway errors: named, measured, and reported with the final model's figures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from tests.stages.line import run_line
from tests.tolerance import assert_close
from truing.report.chain_curves import guideway_errors
from truing.simulation.mechanisms.chains.guideways import GuidewayError

POSES, NOISE_MM, TRAVEL_MM = 140, 0.006, 2000.0
SETTINGS = """
[campaign]
name = "gantry"
kind = "photogrammetry"
[mechanism]
type = "chain"
joints = ["x", "y", "z"]
screws = [
  { axis = [1, 0, 0], point_mm = [0, 0, 0], kind = "prismatic" },
  { axis = [0, 1, 0], point_mm = [0, 0, 0], kind = "prismatic" },
  { axis = [0, 0, 1], point_mm = [0, 0, 0], kind = "prismatic" },
]
home = { position_mm = [0, 0, -300] }
tip = "tool"
[noise]
point_mm = 0.006
"""


def gantry(folder: Path, bow_mm: float = 0.0, yaw_rad: float = 0.0) -> Path:
    """A campaign in which the carriage of x bows along y, or turns about z once to and fro over its travel."""
    rng = np.random.default_rng(5)
    q = rng.uniform([0.0, 0.0, -400.0], [TRAVEL_MM, 1200.0, 0.0], (POSES, 3))
    share = 2.0 * q[:, 0] / TRAVEL_MM - 1.0
    tip = q + np.array([50.0, 20.0, -300.0])
    tip[:, 1] += bow_mm * (1.0 - share**2)
    yaw = yaw_rad * np.sin(np.pi * share)
    arm = tip - np.c_[q[:, 0], 0.0 * q[:, 1:]]
    tip += yaw[:, None] * np.c_[-arm[:, 1], arm[:, 0], 0.0 * arm[:, 2]]
    c, s = np.cos(0.7), np.sin(0.7)
    seen = tip @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T + rng.normal(0.0, NOISE_MM, tip.shape)
    folder.mkdir()
    (folder / "campaign.toml").write_text(SETTINGS)
    _write(folder / "configurations.csv", "pose,role,time_s,x_mm,y_mm,z_mm", "calibration,{time}", q)
    _write(folder / "points.csv", "pose,body,target,x_mm,y_mm,z_mm", "tool,SMR", seen)
    return folder


def _write(file: Path, heading: str, words: str, numbers: NDArray) -> None:
    rows = (f"{k + 1},{words.format(time=20 * k)},{','.join(f'{v:.5f}' for v in row)}" for k, row in enumerate(numbers))
    file.write_text("\n".join([heading, *rows, ""]))


def findings(folder: Path) -> pd.DataFrame:
    tables, _ = run_line(folder, "ingest", "qa", "diagnose")
    table = tables["diagnosis"].to_pandas()
    return table[table["verdict"].isin(["found", "suspected"])].reset_index(drop=True)


@pytest.mark.parametrize("bow_mm", [0.04, 0.5])
def test_a_carriage_that_leaves_its_line_is_named_and_measured(tmp_path: Path, bow_mm: float) -> None:
    found = findings(gantry(tmp_path / "gantry", bow_mm=bow_mm))
    assert found[["cause", "subject", "verdict"]].to_numpy().tolist() == [["guideway-error", "joint x", "found"]]
    size = json.loads(found["parameters"][0])["largest"]
    # from the line through both ends of the measured travel, which is a little shorter
    assert abs(size["value"] - bow_mm) < 3.5 * size["sigma"] + 0.04 * bow_mm


@pytest.mark.parametrize(("bow_mm", "yaw_rad"), [(0.04, 0.0), (0.0, 60e-6)])
def test_the_curve_of_a_guideway_is_the_error_of_the_carriage(tmp_path: Path, bow_mm: float, yaw_rad: float) -> None:
    """At every position within four standard deviations of the nearest cubic, which this turn is found to be."""
    tables, _ = run_line(gantry(tmp_path / "gantry", bow_mm=bow_mm, yaw_rad=yaw_rad), "ingest", "qa", "diagnose")
    rows = tables["guideway_errors"].to_pandas()
    motion = ("shift", "y") if bow_mm else ("turn", "z")
    assert rows[["joint", "guideway_motion", "guideway_axis"]].drop_duplicates().to_numpy().tolist() == [["x", *motion]]
    reading = rows["joint_reading_si"].to_numpy() * 1e3
    share = 2.0 * reading / TRAVEL_MM - 1.0
    true = bow_mm * 1e-3 * (1.0 - share**2) + yaw_rad * np.sin(np.pi * share)
    true = np.polyval(np.polyfit(share, true, 3), share)
    ends = true[0] + (reading - reading[0]) / np.ptp(reading) * (true[-1] - true[0] if bow_mm else 0.0)
    away = np.abs(rows["guideway_error_si"] - (true - ends))
    assert (away < 4.0 * rows["guideway_sigma_si"] + 0.03 * np.abs(true).max()).all()
    low, high = (float(rows[f"measured_{end}_si"].iloc[0]) * 1e3 for end in ("from", "to"))
    assert low <= reading.min() < reading.max() <= high
    assert low < 0.03 * TRAVEL_MM
    assert high > 0.97 * TRAVEL_MM
    figure = guideway_errors(rows)
    drawn = figure.data[2]
    assert_close(
        np.array(drawn.y), rows["guideway_error_si"].to_numpy() * (1e6 if bow_mm else 648e3 / np.pi), atol=1e-9
    )
    assert figure.layout.yaxis.title.text == ("µm" if bow_mm else "arcsec")
    assert sorted(line.x0 for line in figure.layout.shapes) == [low, high]


def test_a_carriage_that_turns_is_named_and_measured(tmp_path: Path) -> None:
    found = findings(gantry(tmp_path / "gantry", yaw_rad=60e-6))
    assert found[["cause", "subject", "verdict"]].to_numpy().tolist() == [["guideway-error", "joint x", "found"]]
    assert '"error": "turn"' in found["settings"][0]
    assert '"axis": "z"' in found["settings"][0]


def test_a_dropped_cause_leaves_its_figures_to_the_one_that_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A prior far too narrow for the bow lets a second effect be accepted, and the first be dropped."""
    monkeypatch.setattr(GuidewayError, "reach", 3.0)
    found = findings(gantry(tmp_path / "gantry", bow_mm=0.5))
    assert len(found) == 1
    assert found["rms_before"][0] == pytest.approx(found["rms_without_any"][0])
    assert found["largest_motion"][0] > 250.0
