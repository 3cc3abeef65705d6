"""Frames of a sensor: axes that follow from its joints and beams, and the figure that shows them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from tests.tolerance import assert_close
from truing.report.scene.frames import frames, frames_figure
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.campaign import read_campaign
from truing.stages.common.frames_of_sensor import sensor_frames

ALONG = ["along_x", "along_y", "along_z"]
PLACE = ["x_mm", "y_mm", "z_mm"]
ANGLES = np.deg2rad([20.0, 40.0, 140.0, 160.0, 260.0, 280.0])
LOWER = 550.0 * np.stack([np.cos(ANGLES), np.sin(ANGLES), 0.0 * ANGLES], -1)
UPPER = 500.0 * np.stack([np.cos(ANGLES + 0.3), np.sin(ANGLES + 0.3), 0.02 + 0.0 * ANGLES], -1)
LIFTED = UPPER + np.array([0.0, 0.0, 300.0])


def table(**beams: dict[str, Any]) -> pd.DataFrame:
    legs = [{"B_mm": B.tolist(), "b_mm": b.tolist()} for B, b in zip(LOWER, UPPER, strict=True)]
    mechanism = {"type": "6-upur", "legs": legs, "height_mm": 300.0}
    document = {"campaign": {"name": "c", "kind": "interferometer"}, "mechanism": mechanism}
    found = sensor_frames(read_campaign({**document, "interferometer": {"beams": beams}}))
    assert found is not None
    assert ARTIFACTS["frames"].faults(found) == []
    return found.to_pandas()


def axes(of: pd.DataFrame, frame: str) -> np.ndarray:
    return of.loc[of["frame"] == frame, ALONG].to_numpy()


def test_every_frame_is_right_handed_and_stands_where_its_body_does():
    found = table()
    for frame in ("base", "platform", *(f"leg {k}" for k in range(1, 7))):
        own = axes(found, frame)
        assert_close(own @ own.T, np.eye(3), atol=1e-12)
        assert_close(np.linalg.det(own), 1.0, atol=1e-12)
    origins = found.groupby("frame")[PLACE].first()
    assert_close(origins.loc["base"].to_numpy(), np.zeros(3), atol=1e-12)
    assert_close(origins.loc["platform"].to_numpy(), [0.0, 0.0, 300.0], atol=1e-9)
    for k in range(6):
        assert_close(origins.loc[f"leg {k + 1}"].to_numpy(), LOWER[k], atol=1e-9)
        leg = LIFTED[k] - LOWER[k]
        assert_close(axes(found, f"leg {k + 1}")[2], leg / np.linalg.norm(leg), atol=1e-12)


def test_the_joint_axes_are_those_of_the_paper():
    """S1 horizontal, S3 along the leg, S2 = S1 x S3; S4, S5, S6 as S1, S2, S3 (after eq. 11)."""
    found = table()
    for k in range(1, 7):
        own = found[found["frame"] == f"joints of leg {k}"].set_index("axis_name")
        S = {name: own.loc[name, ALONG].to_numpy(dtype=float) for name in own.index}
        assert list(S) == [f"S{j}" for j in range(1, 7)]
        assert_close(S["S1"][2], 0.0, atol=1e-12)
        assert_close(S["S3"], axes(found, f"leg {k}")[2], atol=1e-12)
        assert_close(S["S1"], axes(found, f"leg {k}")[0], atol=1e-12)
        assert_close(S["S2"], np.cross(S["S1"], S["S3"]), atol=1e-12)
        assert_close([S["S4"], S["S5"]], [S["S1"], S["S2"]], atol=1e-12)
        assert_close(S["S6"], S["S3"], atol=1e-12)
        lower, upper = LOWER[k - 1], LIFTED[k - 1]
        places = own[PLACE].to_numpy()
        assert_close(places, [lower, lower, 0.5 * (lower + upper), upper, upper, upper], atol=1e-9)


def test_measured_directions_follow_the_declared_beams():
    plain = table()
    own = plain[plain["frame"] == "measurement"].set_index("axis_name")
    assert list(own.index) == ["dx", "dy", "dz", "rx", "ry", "rz"]
    assert_close(own[ALONG].to_numpy(), np.tile(np.eye(3), (2, 1)), atol=1e-12)
    assert_close(own[PLACE].to_numpy(), np.tile([0.0, 0.0, 300.0], (6, 1)), atol=1e-9)
    found = table(dz={"arm_mm": [12.0, -5.0, 3.0]}, rx={"direction": [1.0, 0.0, 0.1]})
    own = found[found["frame"] == "measurement"].set_index("axis_name")
    assert_close(own.loc["dz", PLACE].to_numpy(dtype=float), [12.0, -5.0, 303.0], atol=1e-9)
    assert_close(own.loc["rx", ALONG].to_numpy(dtype=float), np.array([1.0, 0.0, 0.1]) / np.hypot(1.0, 0.1), atol=1e-12)


def test_other_mechanisms_have_no_such_table():
    assert sensor_frames(read_campaign({"campaign": {"name": "c", "kind": "interferometer"}})) is None
    assert frames({}) is None


def test_the_figure_names_every_axis_and_ends_its_arrows_there():
    found = table()
    figure = frames_figure(found)
    tips = [text for trace in figure.data for text in (trace.text or ()) if trace.mode == "text"]
    assert {"x base", "z platform", "x 1", "z 6", "S1", "S6", "dz", "rz", "leg 4"} <= set(tips)
    arrows = {trace.name: trace for trace in figure.data if trace.mode == "lines" and trace.legendgroup}
    assert set(arrows) == set(found["frame"])
    base = np.stack([arrows["base"].x, arrows["base"].y, arrows["base"].z], -1)
    assert_close(base[0], np.zeros(3), atol=1e-9)
    assert_close(base[1] / np.linalg.norm(base[1]), [1.0, 0.0, 0.0], atol=1e-9)
    legs = next(trace for trace in figure.data if trace.name == "legs")
    ends = np.stack([legs.x, legs.y, legs.z], -1).reshape(6, 3, 3)[:, :2]
    assert_close(ends[:, 0], LOWER, atol=1e-3)
    assert_close(ends[:, 1], LIFTED, atol=1e-3)
    section = frames({"frames": found})
    assert len(section.listings[0].rows) == len(found) == 6 + 6 * 9 + 6
