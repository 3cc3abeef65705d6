"""Two joint zeros far beyond their tolerance: errors without them, and their rows among the identified numbers."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from tests.blind.generator.arms import draw, write
from truing.pipeline.command_line import app

ZEROS = {"axis_2_deg": 0.8, "axis_3_deg": -1.2}  # deg


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = draw(13, instrument="points-series", notation="urdf", causes=(), poses=36)
    folder = write(made, tmp_path_factory.mktemp("zeros") / "arm")
    settings = folder / "campaign.toml"
    text = re.sub(r"gravity = .*\n", "", settings.read_text(encoding="utf-8"))
    settings.write_text(re.sub(r"offset_deg = .*", "offset_deg = 0.05", text), encoding="utf-8")
    table = folder / "configurations.csv"
    with table.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        row |= {name: repr(float(row[name]) - zero) for name, zero in ZEROS.items()}
    with table.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    done = CliRunner().invoke(app, ["run", str(folder), "--out", str(folder.with_name("run"))])
    assert done.exit_code == 0, done.output
    return folder.with_name("run")


def _offsets(run: Path) -> pd.DataFrame:
    table = pq.read_table(run / "diagnosis.parquet").to_pandas()
    return table[(table["cause"] == "joint-offset") & table["verdict"].isin(["found", "suspected"])]


def test_errors_without_several_offsets_are_larger_than_without_one(run: Path) -> None:
    found = _offsets(run)
    assert len(found) == 2
    assert (found["rms_without_any"] > found["rms_before"]).all()
    assert (found["rms_before"] > 2.0 * found["rms_after"]).all()


def test_the_error_without_any_cause_is_that_of_all_poses(run: Path) -> None:
    poses = pq.read_table(run / "prediction.parquet").to_pandas()
    before = np.sqrt(np.mean(poses.loc[poses["role"] == "calibration", "rms_before"] ** 2))
    assert _offsets(run)["rms_without_any"].iloc[0] == pytest.approx(before, rel=0.1)  # poses see different numbers


def test_the_identified_zeros_hold_the_offsets_that_were_found(run: Path) -> None:
    numbers = pq.read_table(run / "chain_parameters.parquet").to_pandas()
    zeros = numbers[numbers["parameter"] == "offset"].set_index("joint")
    for column, size in ZEROS.items():
        zero = zeros.loc[column.removesuffix("_deg")]
        assert zero["identifiable"]
        assert abs(zero["identified"] - np.deg2rad(size)) < 4.0 * np.hypot(zero["sigma"], zero["tolerance"])
        assert abs(zero["pull"]) > 3.0
