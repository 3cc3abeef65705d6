"""The 3-D view places legs, targets and loaded joints according to the rigid motions."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from truing.report.scene.by_leg import by_leg
from truing.report.scene.scenes import load_scene, pose_scene
from truing.report.scene.view import drawn, gains

QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # about z
SHIFT = ["dx_mm", "dy_mm", "dz_mm"]


def of_a_platform() -> dict[str, pd.DataFrame]:
    """A platform turned by a quarter, 500 mm above the base, with one leg that has a target of its own."""
    names = [f"r{i}{j}" for i in range(3) for j in range(3)]
    motions = pd.DataFrame(
        [(1, "platform", 0.0, 0.0, 500.0, *QUARTER.ravel()), (1, "leg1", 10.0, 0.0, 0.0, *np.eye(3).ravel())],
        columns=["pose", "body", "px_mm", "py_mm", "pz_mm", *names],
    )
    places = [("platform", "A", 5.0, 0.0, 0.0, 1.0), ("platform", "P", 50.0, 60.0, 0.0, np.nan)]
    shape = pd.DataFrame(
        [*places, ("leg1", "L", 0.0, 0.0, 100.0, np.nan)], columns=["body", "target", "x_mm", "y_mm", "z_mm", "leg"]
    )
    residuals = shape[["body", "target"]].assign(pose=1, dx_mm=1e-3, dy_mm=0.0, dz_mm=0.0, rejected=False)
    numbers = {"a_x": 10.0, "a_y": 20.0, "a_z": 0.0, "b_x": 5.0, "b_y": 0.0, "b_z": 0.0}
    rows = [("6-pus", "none", 1.0, name, "mm", value - 0.1, value, 0.0123) for name, value in numbers.items()]
    columns = ["model", "deformation", "leg", "parameter", "unit", "nominal", "identified", "sigma"]
    fitted = pd.DataFrame(rows, columns=columns)
    return {"shape": shape, "residuals": residuals, "motions": motions, "calibration": fitted}


def test_legs_are_in_the_frame_of_the_platform():
    tables = of_a_platform()
    own = tables["residuals"][tables["residuals"]["body"] == "platform"]
    scene = pose_scene(tables, own, "platform")
    assert scene.names == ("A", "P", "L")
    assert scene.leg.tolist() == [1, 0, 1]
    assert scene.own.tolist() == [False, False, True]
    assert np.allclose(scene.place[0], [[5.0, 0.0, 0.0], [50.0, 60.0, 0.0], [0.0, -10.0, -400.0]])
    assert np.allclose(scene.shift[0, 2], [0.0, -1e-3, 0.0])
    assert np.allclose(scene.lower[0], [[20.0, -10.0, -500.0]])
    assert np.allclose(scene.upper[0], [[5.0, 0.0, 0.0]])
    for chosen, number in (((), 2), ((1,), 2), ((2,), 0)):  # the leg and its joints, unless others are chosen
        rods = [trace for trace in drawn(scene, 0, 1.0, chosen) if np.any(np.isclose(trace["z"], -500.0))]
        assert len(rods) == number


def test_numbers_of_a_leg_have_units_and_uncertainties():
    listing = by_leg(of_a_platform())
    assert listing.by_leg
    assert listing.rows[0] == ("leg 1", "a_x", "10.000 ± 0.012 mm", "0.100 ± 0.012 mm", "–")


def test_a_load_moves_joints_with_the_platform():
    joints = pd.DataFrame(
        [(1, 100.0, 0.0, -300.0, 100.0, 0.0, 0.0), (2, 0.0, 100.0, -300.0, 0.0, 100.0, 0.0)],
        columns=["leg", *(f"{joint}{axis}_mm" for joint in "ab" for axis in "xyz")],
    )
    loads = dict.fromkeys(("fx_n", "fy_n", "mx_nm", "my_nm", "mz_nm"), 0.0)
    moved = {"dx_mm": 0.0, "dy_mm": 0.0, "dz_mm": 0.1, "rx_rad": 0.0, "ry_rad": 0.0, "rz_rad": 1e-3}
    covariance = {f"cov_{i}_{j}": 0.0 for i in range(6) for j in range(i, 6)} | {"cov_2_2": 1e-12, "cov_4_4": 1e-10}
    case = pd.DataFrame([{"case": 1, "branch": "loading", **loads, "fz_n": -9000.0, **moved, **covariance}])
    scene = load_scene({"displacement": case, "legs": joints})
    assert scene is not None
    assert scene.labels == ("fz -9,000 N, loading",)
    assert np.allclose(scene.shift[0], [[0.0, 0.1, 0.1], [-0.1, 0.0, 0.1]])
    # 1 um of dz, and 1e-5 rad about y at 100 mm, which moves the second joint not at all.
    assert scene.captions[0] == tuple(
        f"Leg {leg}: change of the distance between its joints {text} µm."
        for leg, text in ((1, "100.0 ± 1.4"), (2, "100.0 ± 1.0"))
    )
    assert scene.arrow is not None
    assert scene.arrow[0, 1, 2] < 0.0
    assert load_scene({"displacement": case}) is None  # nothing says where joints are


def test_amplifications_are_round_and_lie_about_the_one_that_suits():
    assert gains(200.0) == [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0]
    assert math.prod(gains(1.0)) > 1.0
