"""Points of a COLMAP model get standard deviations from their rays, and the run reports it."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from tests.tolerance import assert_close
from truing.formats.source import CampaignFiles
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.in_memory import call_stage, stage_line

SIGMA_PX = 0.2
FOCAL, CENTRE = 2000.0, (1000.0, 800.0)
POINTS, IMAGES = 40, 16
CAMPAIGN = """
[campaign]
name = "model"
kind = "photogrammetry"

[noise]
point_mm = 0.5

[files.points]
path = "points3D.bin"
unit = "2 mm"
constants = { pose = 1, body = "thing" }
"""


def view(place):
    """World-to-camera rotation of a camera at a place that looks at the origin."""
    forward = -place / np.linalg.norm(place)
    right = np.cross(forward, [0.1, 0.2, 1.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def quaternion(R):
    w = 0.5 * np.sqrt(max(1.0 + np.trace(R), 1e-12))
    return np.array([w, *(np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / (4 * w))])


def model(folder, seed, lost=()):
    """A model as COLMAP writes it, with noisy rays and true coordinates."""
    rng = np.random.default_rng(seed)
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (POINTS, 3))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.bin").write_bytes(struct.pack("<QIiQQ3d", 1, 4, 0, 2000, 1600, FOCAL, *CENTRE))
    images = struct.pack("<Q", IMAGES)
    for number in range(IMAGES):
        angle = 2.0 * np.pi * number / IMAGES
        place = 6.0 * np.array([np.cos(angle), np.sin(angle), 0.2 + 0.3 * (number % 4)])
        R = view(place)
        seen = (points - place) @ R.T
        xy = FOCAL * seen[:, :2] / seen[:, 2:] + CENTRE + rng.normal(0.0, SIGMA_PX, (POINTS, 2))
        images += struct.pack("<I7dI", number + 1, *quaternion(R), *(-R @ place), 4) + f"{number}.jpg\0".encode()
        images += struct.pack("<Q", POINTS)
        for i, (x, y) in enumerate(xy):
            images += struct.pack("<2dq", x, y, -1 if i in lost and number else 100 + i)
    (folder / "images.bin").write_bytes(images)
    listed = struct.pack("<Q", POINTS)
    for i, point in enumerate(points):
        listed += struct.pack("<Q3d3BdQ", 100 + i, *point, 0, 0, 0, 0.5, 0)
    (folder / "points3D.bin").write_bytes(listed)
    (folder / "campaign.toml").write_text(CAMPAIGN, encoding="utf-8")
    return points


def ingested(folder):
    line = stage_line(folder).call("ingest")
    return line.tables["observations"].to_pandas().sort_values("target")


def test_the_sigmas_are_what_the_rays_give(tmp_path):
    model(tmp_path, 3)
    found = ingested(tmp_path)
    sigma = found[["sigma_x_mm", "sigma_y_mm", "sigma_z_mm"]].to_numpy()
    # of so many rays from some 6 units of 2 mm away, up to geometry and the camera that is calibrated along
    rough = 2.0 * SIGMA_PX / FOCAL * 6.0 * np.sqrt(2.0 / IMAGES)
    assert np.all((sigma > 0.5 * rough) & (sigma < 3.0 * rough))
    assert np.all(np.abs(found[["corr_xy", "corr_xz", "corr_yz"]].to_numpy()) < 1.0)


def test_twice_the_noise_gives_twice_the_sigma_without_a_declaration(tmp_path, monkeypatch):
    model(tmp_path / "one", 3)
    monkeypatch.setattr("tests.stages.ingestion.test_estimated_covariance.SIGMA_PX", 2.0 * SIGMA_PX)
    model(tmp_path / "two", 3)
    one, two = (ingested(tmp_path / name)["sigma_x_mm"].to_numpy() for name in ("one", "two"))
    assert_close(two / one, np.full(POINTS, 2.0), atol=0.05)  # the geometry follows the noise, to second order


def test_a_point_with_one_ray_keeps_the_declared_sigma(tmp_path):
    model(tmp_path, 3, lost=(5,))
    found = ingested(tmp_path).set_index("target")
    assert found.loc["105", "sigma_x_mm"] == pytest.approx(0.5)
    assert found.loc["104", "sigma_x_mm"] < 0.05


def test_without_its_images_the_model_has_the_declared_sigma(tmp_path):
    model(tmp_path, 3)
    (tmp_path / "images.bin").unlink()
    assert_close(ingested(tmp_path)["sigma_x_mm"].to_numpy(), np.full(POINTS, 0.5), atol=0.0)


def test_the_run_says_where_sigmas_come_from(tmp_path):
    model(tmp_path, 3)
    campaign = open_campaign(tmp_path)
    settings = campaign.validated()
    outcome = call_stage("ingest", {}, settings, CampaignFiles(campaign.folder, settings))
    assert str(outcome.read).count("standard deviations of 40 points estimated from their rays") == 1
