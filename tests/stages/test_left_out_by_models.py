"""Points left out by diagnosis and calibration, besides gross errors of the poses, are listed one by one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from tests.stages.benches import bench_with_a_gross_error
from tests.stages.line import run_line
from truing.report.exclusion_section import excluded
from truing.report.numbers import gross_errors


def test_a_reading_that_the_diagnosis_screens_is_in_its_table_and_on_the_page(tmp_path: Path) -> None:
    folder = bench_with_a_gross_error(tmp_path / "bench")
    made, said = run_line(folder, "ingest", "qa", "diagnose")
    table = made["diagnosis_left_out"].to_pandas()
    own = table[(table["run"] == 1) & (table["step"] == 7)]
    assert "channel dz" in set(own["subject"])
    assert (table["value"] > table["limit"]).all()
    listings = excluded({"diagnosis_left_out": table}).listings
    assert [len(listing.rows) for listing in listings] == [len(table)]
    assert gross_errors(len(table), "reading") in said["diagnose"].left_out


def test_the_page_shows_what_either_stage_took_out() -> None:
    facts = {"reason": "why", "value": [9.0], "limit": [5.0], "unit": "sigma"}
    points = pd.DataFrame({"subject": ["platform T3"], "pose": [7], **facts})
    poses = pd.DataFrame({"subject": ["leg2"], "pose": [4], **facts, "value": [np.nan]})
    (listing,) = excluded({"diagnosis_left_out": points, "calibration_left_out": poses}).listings
    assert listing.rows[0] == ("diagnosis", "platform T3", "pose 7", "why", "9 sigma", "5 sigma")
    assert listing.rows[1][:3] == ("calibration", "leg2", "pose 4")
    assert listing.rows[1][4] == "–"
