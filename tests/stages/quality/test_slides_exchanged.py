"""Exchanged slides of a gantry look like mirrored positions: the columns of readings are listed as equally likely."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.stages.line import run_line

TOML = """
[campaign]
name = "gantry"
kind = "photogrammetry"
[measurement]
frame = "campaign"
[mechanism]
type = "chain"
joints = ["x", "y", "z"]
screws = [
  { axis = [1.0, 0.0, 0.0], point_mm = [0.0, 0.0, 0.0], kind = "prismatic" },
  { axis = [0.0, 1.0, 0.0], point_mm = [0.0, 0.0, 0.0], kind = "prismatic" },
  { axis = [0.0, 0.0, 1.0], point_mm = [0.0, 0.0, 0.0], kind = "prismatic" },
]
home = { position_mm = [0.0, 0.0, 0.0] }
[noise]
point_mm = 0.01
"""


@pytest.mark.parametrize("is_exchanged", [False, True])
def test_exchanged_slides_are_among_the_likely_slips(tmp_path: Path, is_exchanged: bool) -> None:
    rng = np.random.default_rng(3)
    at = rng.uniform(0.0, 1.0, (20, 3)) * [1200.0, 800.0, 300.0]
    places = at @ Rotation.from_rotvec([0.1, 0.2, 2.0]).as_matrix().T + rng.normal(0.0, 0.01, at.shape) + 500.0
    read = at[:, [1, 0, 2]] if is_exchanged else at
    rows = [f"{k},calibration,{60 * k},{x:.3f},{y:.3f},{z:.3f}" for k, (x, y, z) in enumerate(read, 1)]
    (tmp_path / "configurations.csv").write_text("\n".join(["pose,role,time_s,x_mm,y_mm,z_mm", *rows]) + "\n")
    rows = [f"{k},tip,T,{x:.4f},{y:.4f},{z:.4f}" for k, (x, y, z) in enumerate(places, 1)]
    (tmp_path / "points.csv").write_text("\n".join(["pose,body,target,x_mm,y_mm,z_mm", *rows]) + "\n")
    (tmp_path / "campaign.toml").write_text(TOML)
    table = run_line(tmp_path, "ingest", "qa")[0]["belonging"].to_pandas().set_index("relation")
    tested = table.loc["joints-against-links"]
    rivals = [(slip["quantity"], slip["subjects"]) for slip in json.loads(tested["rivals"])]
    assert (tested["state"] == "fails") == is_exchanged
    assert (("columns of readings", ["x_mm", "y_mm"]) in rivals) == is_exchanged
    assert (("readings", ["z_mm"]) in rivals) == is_exchanged
