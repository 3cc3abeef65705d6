"""A machine in front of a fixed instrument: poses or points of its platform alone suffice."""

from __future__ import annotations

import re

import pytest

from tests.cut_telescope import SAMPLE
from tests.stages.line import run_line
from tests.tolerance import assert_close
from truing.belonging.relation import RelationState
from truing.report.calibration import section
from truing.report.section_verdict import SectionVerdict, verdict_rows
from truing.report.verdict import with_verdict
from truing.schemas.faults import CampaignFaults
from truing.schemas.verdict import ReasonCode

FIXED = '[measurement]\nframe = "campaign"\n\n[noise]'
PLACE = [*(f"p{a}_mm" for a in "xyz"), *(f"r{a}_rad" for a in "xyz")]
COVARIANCE = [f"cov_{i}_{j}" for i in range(6) for j in range(i, 6)]


@pytest.fixture(scope="module")
def by_points(sample_run):
    """The platform's poses as the targets of the sample give them, seen from its base."""
    import pandas as pd

    poses = pd.read_parquet(sample_run / "poses.parquet")
    return poses[(poses["body"] == "platform") & poses["default"]].reset_index(drop=True)


def campaign(folder, by_points, toml=FIXED):
    """The sample as a tracker with an active target would have measured it: a pose of the platform per row."""
    own = by_points.rename(columns={f"p{a}_mm": f"{a}_mm" for a in "xyz"})
    own[["pose", "body", *(f"{a}_mm" for a in "xyz"), *PLACE[3:], *COVARIANCE]].to_csv(
        folder / "poses.csv", index=False, float_format="%.17g"
    )
    (folder / "configurations.csv").write_text((SAMPLE / "configurations.csv").read_text())
    (folder / "campaign.toml").write_text((SAMPLE / "campaign.toml").read_text().replace("[noise]", toml))
    return folder


def test_a_machine_is_calibrated_by_measured_poses(tmp_path, by_points):
    tables, said = run_line(campaign(tmp_path, by_points), "ingest", "pose", "deformation", "diagnose", "calibrate")
    found = tables["poses"].to_pandas()
    assert set(found["parent"]) == {"base"}
    assert set(found["body"]) == {"platform"}
    assert_close(found[PLACE], by_points[PLACE], atol=1e-9)
    assert_close(1e12 * found[COVARIANCE], 1e12 * by_points[COVARIANCE], atol=1e-9)
    assert "taken for that of base" in said["pose"].figure
    assert "no points" in said["deformation"].figure
    assert "no points" in said["diagnose"].figure
    calibration = tables["calibration"].to_pandas()
    own = calibration[(calibration["model"] == "6-pus") & (calibration["deformation"] == "none")]
    assert len(own)
    assert set(own["status"]) == {"ok"}


def quality(folder, by_points, changed=lambda poses: None):
    """State and words of the readings against the poses, after a change of the table of poses."""
    import pandas as pd

    campaign(folder, by_points)
    poses = pd.read_csv(folder / "poses.csv")
    changed(poses)
    poses.to_csv(folder / "poses.csv", index=False)
    rows = run_line(folder, "ingest", "qa")[0]["qa"].to_pylist()
    (row,) = [row for row in rows if row["check"] == "readings-against-poses"]
    return row["verdict"], row["message"]


XYZ = ["x_mm", "y_mm", "z_mm"]


def in_metres(poses):
    poses[XYZ] /= 1e3


def shifted(poses):
    poses[XYZ + PLACE[3:]] = poses[XYZ + PLACE[3:]].shift(1, fill_value=0.0)


def one_far_off(poses):
    poses.loc[poses.index[20], "y_mm"] += 100.0


def test_measured_poses_are_compared_with_the_readings(tmp_path, by_points):
    assert quality(tmp_path, by_points)[0] == "pass"


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        (in_metres, "measured poses in another unit: multiply by 1000"),
        (shifted, "readings shifted by -1 rows"),
        (one_far_off, "readings or measured position of pose 20 far from the pose"),
    ],
)
def test_a_slip_in_measured_poses_fails_and_is_named(tmp_path, by_points, changed, named):
    verdict, message = quality(tmp_path, by_points, changed)
    assert verdict == "fail"
    assert named in message


def test_an_instrument_that_moved_has_to_see_the_base(tmp_path, by_points):
    with pytest.raises(CampaignFaults) as caught:
        run_line(campaign(tmp_path, by_points, "[noise]"), "ingest")
    (fault,) = caught.value.faults
    assert fault.column == "body"
    assert 'frame = "campaign"' in fault.expected


def test_points_of_the_platform_alone_are_enough_where_the_instrument_stood_still(tmp_path):
    for name in ("points.csv", "targets.csv", "configurations.csv"):
        text = (SAMPLE / name).read_text()
        kept = [line for line in text.splitlines() if not re.search(r"(^|,)(base|leg\d),", line)]
        (tmp_path / name).write_text("\n".join(kept) + "\n")
    (tmp_path / "campaign.toml").write_text((SAMPLE / "campaign.toml").read_text().replace("[noise]", FIXED))
    tables, _ = run_line(tmp_path, "ingest", "pose", "deformation")
    assert set(tables["poses"].column("parent").to_pylist()) == {"base"}
    assert tables["deformation"].num_rows


def test_a_calibration_without_a_search_for_causes_is_no_green_first_line(tmp_path, by_points, monkeypatch):
    """Poses without targets: a model that fits may have absorbed a cause, and the verdict says so."""
    tables, _ = run_line(campaign(tmp_path, by_points), "ingest", "qa", "pose", "deformation", "diagnose", "calibrate")
    fitting = SectionVerdict("calibration", RelationState.OK, ReasonCode.FITS, "It fits.")
    monkeypatch.setattr(section, "_of_chosen", lambda *_: fitting)
    found = verdict_rows(with_verdict({name: table.to_pandas() for name, table in tables.items()}))
    assert (found["diagnosis"].state, found["calibration"].state) == (RelationState.NOT_TESTED, RelationState.ATTENTION)
    assert "No cause was sought" in found["calibration"].explanation
