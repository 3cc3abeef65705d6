"""Photographs to rays: file, pose, camera and target of each ray, and faults before measuring."""

from __future__ import annotations

import pickle
from functools import cache

import numpy as np
import pytest
from PIL import Image

from tests.estimation.image_targets.pictures import ring_target_picture
from tests.estimation.image_targets.planes import exposed, homography, marker_pattern, plane_picture
from tests.tolerance import assert_close
from truing.pipeline.campaign_check import check_campaign
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.campaign_run import detached_run
from truing.pipeline.in_memory import call_stage, stage_line
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.campaign import read_campaign
from truing.schemas.faults import CampaignFaults
from truing.schemas.photographs import MARKERS, RINGS, USUAL
from truing.stages.image_tables import photographs as tables
from truing.stages.image_tables.photographs import target_plan

CAMPAIGN = '[campaign]\nname = "c"\nkind = "photogrammetry"\n'
# The smallest word of twelve bits with an even number of ones and two of them opposite each other: number 1.
WORD = 0b000001000001
CORNERS = np.array([[30.2, 31.7], [82.4, 27.9], [86.1, 79.3], [27.8, 84.2]])
CENTRE = np.array([160.3, 60.6])


@cache
def scene():
    """The light of a marker with code 7, and a ring target with code 1 next to it."""
    light = np.ones((120, 230))
    light[:, :115] = plane_picture(marker_pattern("aruco4x4_50", 7), homography(CORNERS), 120, 0.7, fine=6)[:, :115]
    ring = ring_target_picture(115, CENTRE - [115, 0], (9.0, 8.0), 0.4, 12, WORD, 0.3, 0.7)
    light[:115, 115:] = 1.0 - ring[:115, :115]
    return light


@pytest.fixture
def folder(tmp_path):
    for pose, number in ((1, 1), (1, 2), (2, 1)):
        path = tmp_path / "images" / str(pose) / f"p{number}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(exposed(scene(), np.random.default_rng(10 * pose + number))).save(path)
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    return tmp_path


def measured(folder):
    return stage_line(folder).call("images")


def test_rays_of_every_photograph_by_pose_camera_and_name(folder):
    (folder / "image_targets.csv").write_text(
        "family,code,body,target,size_mm,diameter_mm\naruco4x4_50,7,base,M,20,\nring12,1,platform,T1,,5\n"
    )
    line = measured(folder)
    for name in ("image_points", "photographs", "image_rejections", "image_targets"):
        assert ARTIFACTS[name].faults(line.tables[name]) == []
    rays = line.tables["image_points"].to_pandas()
    assert sorted(rays["point"][rays["pose"] == 2]) == ["base/M.0", "base/M.1", "base/M.2", "base/M.3", "platform/T1"]
    assert set(zip(rays["pose"], rays["image"], strict=True)) == {(1, "1/p1"), (1, "1/p2"), (2, "2/p1")}
    assert set(rays["kind"]) == {"aruco", "ring12"}
    own = rays[rays["image"] == "1/p2"].set_index("target")
    assert_close(own.loc[["M.0", "M.1", "M.2", "M.3"], ["x_px", "y_px"]], CORNERS, atol=0.1)
    assert_close(own.loc["T1", ["x_px", "y_px"]].to_numpy(float), CENTRE, atol=0.1)
    assert_close(own.loc["T1", ["semi_major_px", "semi_minor_px"]].to_numpy(float), [9.0, 8.0], atol=0.1)
    assert own.loc["M.0", ["semi_major_px", "semi_minor_px", "axis_angle_rad"]].isna().all()
    photographs = line.tables["photographs"].to_pandas()
    assert photographs["file"].tolist() == ["images/1/p1.png", "images/1/p2.png", "images/2/p1.png"]
    assert photographs["targets_measured"].tolist() == [5, 5, 5]
    assert "15 rays of 3 images" in line.outcomes["images"].read


def test_a_code_without_a_table_names_itself(folder):
    rays = measured(folder).tables["image_points"].to_pandas()
    assert {"ring12-1", "aruco4x4_50-7.0", "aruco4x4_50-7.3"} <= set(rays["point"])


def test_a_copy_of_a_photograph_adds_no_rays(folder):
    original = folder / "images" / "1" / "p1.png"
    (original.parent / "p3.png").write_bytes(original.read_bytes())
    line = measured(folder)
    assert set(line.tables["image_points"].column("image").to_pylist()) == {"1/p1", "1/p2", "2/p1"}
    assert len(line.tables["photographs"]) == 3


def test_only_the_declared_code_families_are_searched(folder):
    (folder / "campaign.toml").write_text(f'{CAMPAIGN}[photographs]\ntargets = ["ring12"]\nuncoded = false\n')
    assert set(measured(folder).tables["image_points"].column("point").to_pylist()) == {"ring12-1"}


def test_removing_several_rays_at_a_time_leaves_the_same_rays(folder, monkeypatch):
    (folder / "campaign.toml").write_text(f'{CAMPAIGN}[photographs]\ntargets = ["ring12"]\nuncoded = false\n')
    alone = measured(folder)
    monkeypatch.setattr(tables, "_WORTH_PROCESSES", 0)
    handed_out = []
    run = detached_run(open_campaign(folder))

    def each(work, pieces, progress):
        handed_out.extend(map(str, pieces))
        assert pickle.loads(pickle.dumps(pieces)) == list(pieces)
        return run._ordered_results(work, pieces, progress)

    found = call_stage("images", {}, alone.settings, alone.source, each)
    assert handed_out == ["images/1/p1.png", "images/1/p2.png", "images/2/p1.png"]
    for name in ("image_points", "photographs", "image_rejections"):
        assert found.artifacts[name].equals(alone.tables[name])


def fault_of(folder):
    with pytest.raises(CampaignFaults) as caught:
        measured(folder)
    with pytest.raises(CampaignFaults) as checked:
        check_campaign(open_campaign(folder))
    assert {str(fault) for fault in caught.value.faults} <= {str(fault) for fault in checked.value.faults}
    return str(caught.value)


def test_all_that_is_wrong_with_photographs_and_codes_is_reported_at_once(folder):
    content = (folder / "images/1/p1.png").read_bytes()
    (folder / "images/1/p1.png").write_bytes(content[: len(content) // 2])
    (folder / "images/1/p2.png").write_bytes(b"")
    (folder / "images/alone.png").write_bytes(content)
    (folder / "image_targets.csv").write_text(
        "family,code,body,target\nring12,1,b,T1\nring12,1,b,T2\nring13,4,b,T3\nring8,999,b,T4\naruco4x4_50,50,b,T5\n"
    )
    words = fault_of(folder)
    for expected in (
        "images/1/p1.png: found ",
        "images/1/p2.png: expected a photograph; this file is empty",
        "images/alone.png: expected a pose in its name",
        "image_targets.csv, row 3, column code: found '1'; expected every family, code once",
        "image_targets.csv, row 4, column family: found 'ring13'; expected one of ring8",
        "image_targets.csv, row 5, column code: found '999'; expected one of the 13 codes of ring8",
        "image_targets.csv, row 6, column code: found '50'; expected one of the 50 codes of aruco4x4_50",
    ):
        assert expected in words


@pytest.mark.parametrize(
    ("section", "expected"),
    [
        ('targets = ["aruco4x4-50"]', "did you mean aruco4x4_50?"),
        ('[[photographs.boards]]\nkind = "chessboard"\ncolumns = 7\nrows = 5', "one even and one odd number"),
        ('[[photographs.boards]]\nkind = "charuco"\ncolumns = 7\nrows = 5\nfamily = "ring12"', "square markers"),
        ("smallest_px = 9.0\nlargest_px = 8.0", "largest_px above smallest_px"),
        ('[[photographs.boards]]\nkind = "chessboard"\ncolumns = 6\nrows = 5\n' * 2, "different names for all boards"),
    ],
)
def test_invalid_settings_are_faults(folder, section, expected):
    (folder / "campaign.toml").write_text(f"{CAMPAIGN}[photographs]\n{section}\n")
    with pytest.raises(CampaignFaults, match=expected.replace("?", r"\?")):
        stage_line(folder)


@pytest.mark.parametrize(
    ("reported", "codes", "circles"),
    [
        ({}, USUAL, True),
        ({"boards": [{"kind": "chessboard", "columns": 5, "rows": 4}]}, (), False),
        ({"boards": [{"kind": "chessboard", "columns": 5, "rows": 4}], "uncoded": True}, (), True),
        ({"boards": [{"kind": "chessboard", "columns": 5, "rows": 4}], "targets": ["ring12"]}, ("ring12",), True),
        ({"uncoded": False}, USUAL, False),
    ],
)
def test_markers_of_boards_are_no_codes_if_only_boards_are_declared(reported, codes, circles) -> None:
    head = {"campaign": {"name": "x", "kind": "photogrammetry"}}
    settings = read_campaign({**head, "photographs": reported})
    plan = target_plan(settings.photographs, None)
    assert plan.rings == tuple(code for code in codes if code in RINGS)
    assert plan.markers == tuple(code for code in codes if code in MARKERS)
    assert plan.uncoded is circles
