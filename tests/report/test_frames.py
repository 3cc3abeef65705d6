"""Frames of a sensor: axes that follow from its joints and beams, and the figure that shows them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from tests.tolerance import assert_close
from truing.report.scene.frames import frames, frames_figure
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.campaign import read_campaign
from truing.stages.common.frames_of_machine import machine_frames

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
    found = machine_frames(read_campaign({**document, "interferometer": {"beams": beams}}))
    assert found is not None
    assert ARTIFACTS["frames"].faults(found) == []
    return found.to_pandas()


def axes(of: pd.DataFrame, frame: str) -> np.ndarray:
    return of.loc[of["frame"] == frame, ALONG].to_numpy()


def test_every_frame_is_right_handed_and_at_its_body():
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


def test_radii_point_outwards_at_both_joints():
    """Directions of the imaginary prismatic joints (figure 6 of the paper)."""
    found = table()
    for k in range(6):
        own = found[found["frame"] == f"radii of leg {k + 1}"].set_index("axis_name")
        for name, joint, at in (("base", LOWER[k], LOWER[k]), ("platform", UPPER[k], LIFTED[k])):
            flat = joint * [1.0, 1.0, 0.0]
            assert_close(own.loc[name, ALONG].to_numpy(dtype=float), flat / np.linalg.norm(flat), atol=1e-12)
            assert_close(own.loc[name, PLACE].to_numpy(dtype=float), at, atol=1e-9)


A = 200.0 * np.stack([np.cos(ANGLES), np.sin(ANGLES), 0.0 * ANGLES], -1)
TURNED = ANGLES + np.tile([-0.4, 0.4], 3)
B = 120.0 * np.stack([np.cos(TURNED), np.sin(TURNED), 0.1 + 0.0 * ANGLES], -1)
U = np.stack([0.05 * np.cos(ANGLES), 0.02 * np.sin(ANGLES), 1.0 + 0.0 * ANGLES], -1)
U /= np.linalg.norm(U, axis=1)[:, None]
LIFT = np.array([0.0, 0.0, 400.0])


def legged(kind: str, **flexures: float) -> pd.DataFrame:
    length = np.linalg.norm(B + LIFT - A, axis=1)
    legs = [
        {"a_mm": a.tolist(), "b_mm": b.tolist(), "length_mm": float(size), "rho0_mm": 7.0, **flexures}
        | ({"u": u.tolist()} if kind == "6-pus" else {})
        for a, b, u, size in zip(A, B, U, length, strict=True)
    ]
    document = {"campaign": {"name": "c", "kind": "photogrammetry"}, "mechanism": {"type": kind, "legs": legs}}
    found = machine_frames(read_campaign(document))
    assert found is not None
    assert ARTIFACTS["frames"].faults(found) == []
    return found.to_pandas()


def test_the_reading_follows_from_the_frames_of_a_leg():
    """rho = (p + R b - a - l z) . u, eq. 6 of the telescope report."""
    found = legged("6-pus")
    p = found.loc[found["frame"] == "platform", PLACE].to_numpy(dtype=float)[0]
    R = axes(found, "platform").T
    for k in range(6):
        z, u = axes(found, f"leg {k + 1}")[2], U[k]
        length = np.linalg.norm(B[k] + LIFT - A[k])
        assert_close((p + R @ B[k] - A[k] - length * z) @ u, 7.0, atol=1e-9)
        own = found[found["frame"] == f"joints of leg {k + 1}"].set_index("axis_name")
        assert list(own.index) == ["u", "b"]
        assert_close(own.loc["u", ALONG].to_numpy(dtype=float), u, atol=1e-12)
        assert_close(own.loc["u", PLACE].to_numpy(dtype=float), A[k] + 7.0 * u, atol=1e-9)
        assert_close(own.loc["b", PLACE].to_numpy(dtype=float), p + R @ B[k], atol=1e-9)


def test_the_frame_of_a_leg_has_the_bases_z_in_its_plane_x_z():
    found = legged("ups")
    for k in range(6):
        own = axes(found, f"leg {k + 1}")
        assert_close(own @ own.T, np.eye(3), atol=1e-12)
        assert_close(np.linalg.det(own), 1.0, atol=1e-12)
        assert_close(own[1][2], 0.0, atol=1e-12)
        assert own[0][2] > 0.0


def test_flexures_are_centred_on_the_joints_and_lie_along_the_leg():
    """Nodes of the chain of a leg: eq. 22 and figure 12 of the telescope report."""
    found = legged("6-pus", flexure_length_mm=12.0)
    for k in range(1, 7):
        own, z = found[found["frame"] == f"joints of leg {k}"].set_index("axis_name"), axes(found, f"leg {k}")[2]
        place = {name: own.loc[name, PLACE].to_numpy(dtype=float) for name in own.index}
        assert list(place) == ["u", "a'", "c'", "d'", "b'", "b"]
        for start, end, joint in (("a'", "c'", "u"), ("d'", "b'", "b")):
            assert_close(place[end] - place[start], 12.0 * z, atol=1e-9)
            assert_close(0.5 * (place[end] + place[start]), place[joint], atol=1e-9)
    section = frames({"frames": found})
    assert "at the reference readings" in section.lead


def test_legs_that_do_not_close_and_fewer_than_six_have_no_frames():
    text = {"campaign": {"name": "c", "kind": "photogrammetry"}}
    legs = [
        {"a_mm": a.tolist(), "b_mm": b.tolist(), "length_mm": 5.0, "rho0_mm": 0.0} for a, b in zip(A, B, strict=True)
    ]
    for given in (legs, legs[:3]):
        assert machine_frames(read_campaign({**text, "mechanism": {"type": "ups", "legs": given}})) is None


def test_other_mechanisms_have_no_such_table():
    assert machine_frames(read_campaign({"campaign": {"name": "c", "kind": "interferometer"}})) is None
    assert frames({}) is None


def test_the_figure_names_every_axis_and_ends_its_arrows_there():
    found = table()
    figure = frames_figure(found)
    tips = [text for trace in figure.data for text in (trace.text or ()) if trace.mode == "text"]
    assert {"x base", "z platform", "x 1", "z 6", "S1", "S6", "dz", "rz", "4"} <= set(tips)
    numbers = next(trace for trace in figure.data if trace.text and trace.text[0] == "1")
    assert numbers.text == tuple("123456")
    ring = LOWER - LOWER.mean(axis=0)
    beyond = np.stack([numbers.x, numbers.y, numbers.z], -1) - LOWER
    assert np.all(np.sum(ring * beyond, axis=1) > 0.1 * np.sum(ring * ring, axis=1)), "not outside the ring"
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
    assert len(section.listings[0].rows) == len(found) == 6 + 6 * 11 + 6
