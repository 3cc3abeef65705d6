"""Standard deviations below any instrument's resolution, or above any measurement, are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.stages.ingestion.test_loading_tables import faults as load_faults
from tests.stages.ingestion.test_pose_table import COUNT, HEAD, PLACES, WAYS, XYZ, faults, table
from truing.formats.faultlog import FaultLog
from truing.formats.source import CampaignFiles
from truing.schemas.campaign import read_campaign
from truing.stages.image_tables.prior_knowledge import read_known_points, read_scale_bars

ABSURD = (5e-324, 1e-200, 1e29, 1e308)


@pytest.mark.parametrize("sigma", ABSURD)
@pytest.mark.parametrize("name", ["sigma_x_mm", "sigma_ry_rad", "sigma_euler_b_deg", "cov_1_1", "cov_4_4"])
def test_a_sigma_of_a_pose_is_one_that_can_be(tmp_path: Path, name: str, sigma: float) -> None:
    columns, values, toml = WAYS["euler XYZ" if "euler" in name else "rotation vector"]
    names = [name]
    if name.startswith("cov"):
        names = [f"cov_{i}_{i}" for i in range(6)]
    given = np.full((COUNT, len(names)), 1e-8)
    given[2, names.index(name)] = sigma
    table(tmp_path, [*XYZ, *columns, *names], np.hstack([PLACES, values, given]), HEAD + toml)
    found = [(fault.file, fault.row, fault.column) for fault in faults(tmp_path)]
    assert ("poses.csv", 4, name) in found
    assert {place[:2] for place in found} == {("poses.csv", 4)}


@pytest.mark.parametrize("sigma", ["0", "5e-324", "1e29"])
def test_a_sigma_of_a_reading_is_one_that_can_be(tmp_path: Path, sigma: str) -> None:
    rows = ["run,step,time_s,load_axis,load,channel,reading,sigma"]
    rows += [f"a,{step},{60 * step},fx,{step},dx,{step}.5,{sigma if step == 3 else 0.5}" for step in range(6)]
    (said,) = load_faults(tmp_path, {"interferometer.csv": rows})
    assert (said.file, said.row, said.column) == ("interferometer.csv", 5, "sigma")
    assert "standard deviation above 0" in str(said)


@pytest.mark.parametrize("sigma", ["0", "5e-324", "1e29"])
@pytest.mark.parametrize("what", ["scale_bars", "known_points"])
def test_a_sigma_of_what_is_known_is_one_that_can_be(tmp_path: Path, what: str, sigma: str) -> None:
    lines = {
        "scale_bars": ["bar,first,second,length_mm,sigma_mm", "one,a,b,900,0.01", f"two,c,d,900,{sigma}"],
        "known_points": ["point,x_mm,y_mm,z_mm,sigma_x_mm,sigma_y_mm,sigma_z_mm", f"a,1,2,3,0.01,{sigma},0.01"],
    }[what]
    (tmp_path / f"{what}.csv").write_text("\n".join(lines) + "\n")
    campaign = read_campaign({"campaign": {"name": "c", "kind": "photogrammetry"}})
    log = FaultLog()
    read = read_scale_bars if what == "scale_bars" else read_known_points
    read(CampaignFiles(tmp_path, campaign), None, log)
    (fault,) = log.faults()
    assert (fault.file, fault.row) == (f"{what}.csv", len(lines))
    assert fault.column in ("sigma_mm", "sigma_y_mm")
