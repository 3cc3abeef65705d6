"""Diagnosis of rays before points: found effects are corrected, and effects common to all poses are no finding."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.blind.generator.schedule import random_moves
from tests.photographs.hidden import UnstableCamera
from tests.photographs.ray_folder import write_rays
from tests.photographs.rays import BARS, Shooting, draw_rays
from tests.photographs.stations import Round
from tests.stages.line import run_line, settings_of
from truing.stages import diagnose

# The bars' certificates allow 170 ppm, and they are stated wrong accordingly.
MOVES = random_moves(9, 0, np.random.default_rng(5))
JUMP = UnstableCamera("c", jump_px=1.5, from_pose=6, camera="camera")


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Any]:
    """The tables of a campaign as far as its poses, and its settings."""
    folder = tmp_path_factory.mktemp("rays") / "campaign"
    shooting = Shooting(
        stations=Round(count=6),
        bars=tuple(replace(bar, sigma_mm=0.1) for bar in BARS),
        missing_share=0.0,
        gross_share=0.0,
    )
    write_rays(draw_rays(shooting, MOVES, [], [JUMP], np.random.default_rng(11)), folder, seed=1)
    tables, _ = run_line(folder, "images", "bundle", "ingest", "pose")
    return tables, settings_of(folder)


def test_a_camera_is_named_and_a_certificate_of_a_bar_is_no_finding(line: tuple[dict[str, Any], Any]) -> None:
    tables, settings = line
    rows = diagnose.run(tables, settings, lambda *_: None).artifacts["diagnosis"].to_pylist()
    found = [row for row in rows if row["verdict"] not in ("rejected", "not testable")]
    assert [(row["cause"], row["subject"]) for row in found] == [("camera-instability", "camera camera")]
    reported = json.loads(found[0]["parameters"])
    assert reported["from_pose"]["value"] == JUMP.from_pose
    assert abs(reported["c"]["value"] - JUMP.jump_px) < 4 * reported["c"]["sigma"]
    assert "that is taken off before" in found[0]["explanation"]
    assert [row["rank"] for row in rows] == list(range(1, len(rows) + 1))


def test_the_bars_are_as_wrong_as_points_would_show(line: tuple[dict[str, Any], Any]) -> None:
    tables, _ = line
    survey, points = (tables[name].to_pandas() for name in ("survey", "observations"))
    radius = _radius(survey[survey.body == "base"])
    base = points[points.body == "base"]
    scale = np.array([_radius(own) / radius - 1 for _, own in base.groupby("pose")])
    assert abs(scale.mean()) > 6 * scale.std(ddof=1) / np.sqrt(len(scale))


def _radius(points: Any) -> float:
    """Rms distance of points from their mean, mm."""
    places = points[["x_mm", "y_mm", "z_mm"]].to_numpy()
    return float(np.sqrt(np.mean((places - places.mean(0)) ** 2)))
