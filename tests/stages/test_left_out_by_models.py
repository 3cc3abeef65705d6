"""What diagnosis and calibration take out beyond the poses' own gross errors is told point by point."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pandas as pd

from tests.stages.line import run_line
from truing.report.exclusion_section import excluded
from truing.report.numbers import gross_errors

SAMPLE = Path(__file__).parents[2] / "sample_data" / "force-sensor"


def test_a_reading_that_the_diagnosis_screens_is_in_its_table_and_on_the_page(tmp_path: Path) -> None:
    folder = Path(shutil.copytree(SAMPLE, tmp_path / "c"))
    readings = pd.read_csv(folder / "interferometer.csv")
    row = readings.index[len(readings) // 2]
    readings.loc[row, "reading"] += 40.0
    readings.to_csv(folder / "interferometer.csv", index=False)
    made, said = run_line(folder, "ingest", "qa", "diagnose")
    table = made["diagnosis_left_out"].to_pandas()
    assert gross_errors(len(table), "reading") in said["diagnose"].left_out
    own = table[(table["run"] == readings.loc[row, "run"]) & (table["step"] == readings.loc[row, "step"])]
    assert f"channel {readings.loc[row, 'channel']}" in set(own["subject"])
    assert (table["value"] > table["limit"]).all()
    listings = excluded({"diagnosis_left_out": table}).listings
    assert [len(listing.rows) for listing in listings] == [len(table)]


def test_the_page_tells_what_either_stage_took_out() -> None:
    facts = {"reason": "why", "value": [9.0], "limit": [5.0], "unit": "sigma"}
    points = pd.DataFrame({"subject": ["platform T3"], "pose": [7], **facts})
    poses = pd.DataFrame({"subject": ["leg2"], "pose": [4], **facts, "value": [np.nan]})
    (listing,) = excluded({"diagnosis_left_out": points, "calibration_left_out": poses}).listings
    assert listing.rows[0] == ("diagnosis", "platform T3", "pose 7", "why", "9 sigma", "5 sigma")
    assert listing.rows[1][:3] == ("calibration", "leg2", "pose 4")
    assert listing.rows[1][4] == "–"
