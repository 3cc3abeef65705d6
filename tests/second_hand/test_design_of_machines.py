"""Accuracy and uniqueness of a hexapod by command line, against drawn errors and a search for solutions."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from tests.second_hand.command import call
from tests.second_hand.elastic_hexapod import Hexapod, design, rigid_pose
from tests.second_hand.photogrammetry import vector
from tests.second_hand.rigid_hexapod import poses, spans
from tests.sentences import assert_says, says

ARCSEC = np.pi / 180 / 3600
POSE = ["x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"]
PARTS = ["x", "y", "z", "rx", "ry", "rz"]
UNITS = np.array([1e-6] * 3 + [ARCSEC] * 3)
LIMITS = {"x_mm": 8.0, "y_mm": 6.0, "z_mm": 5.0, "rx_deg": 2.0, "ry_deg": 3.0, "rz_deg": 4.0}
OFF = 1e-6 * np.array([1.0, 2.0, 1.0, 0.5, 1.5, 1.0])  # m, of each actuator


def _folder(place: Path, machine: Hexapod, limits: dict[str, float], more: str = "", of_leg: str = "") -> Path:
    place.mkdir()
    legs = "".join(
        f"  {{ a_mm = {vector(a)}, b_mm = {vector(b)}, length_mm = {1e3 * length:.9f}, rho0_mm = {1e3 * rho:.6f}"
        f"{of_leg} }},\n"
        for a, b, length, rho in zip(machine.a, machine.b, machine.length, machine.reading, strict=True)
    )
    text = f'[campaign]\nname = "own"\nkind = "photogrammetry"\n[mechanism]\ntype = "ups"\n{more}legs = [\n{legs}]\n'
    text += "[mechanism.tolerance]\na_mm = 0.1\nb_mm = 0.1\nlength_mm = 0.1\n[workspace]\n"
    text += "".join(f"{name} = {limit}\n" for name, limit in limits.items()) + "[noise]\npoint_mm = 0.002\n"
    (place / "campaign.toml").write_text(text, encoding="utf-8")
    return place


def _errors(machine: Hexapod, p: np.ndarray, turn: Rotation, off: np.ndarray) -> np.ndarray:
    """Components of the pose's error (N, 6), m and rad, by errors (N, 6) of the actuators at one pose."""
    many = Rotation.from_matrix(np.repeat(turn.as_matrix()[None], len(off), 0))
    start = np.repeat(p[None], len(off), 0)
    length = spans(machine.a, machine.b, start, many) + off
    there, turned, found = poses(machine.a, machine.b, length, start, many)
    assert found.all()
    return np.hstack([there - p, (turned * many.inv()).as_rotvec()])


def _place(row: pd.Series, machine: Hexapod) -> tuple[np.ndarray, Rotation]:
    p, R = rigid_pose(machine, machine.reading)
    shift = row[POSE].to_numpy(float)
    return p + 1e-3 * shift[:3], Rotation.from_rotvec(np.radians(shift[3:])) * Rotation.from_matrix(R)


@pytest.fixture(scope="module")
def accuracy(tmp_path_factory: pytest.TempPathFactory) -> tuple[pd.DataFrame, pd.DataFrame]:
    place = tmp_path_factory.mktemp("accuracy")
    stated = f"actuator_accuracy_mm = {(1e3 * OFF).tolist()}\n"
    call("design", _folder(place / "m", design(), LIMITS, stated), "--accuracy", "--out", place / "f.csv")
    return pd.read_csv(place / "f.csv").set_index("quantity"), pd.read_csv(place / "f-legs.csv")


def _sizes(errors: np.ndarray) -> dict[str, np.ndarray]:
    shift, turn = (np.linalg.norm(part, axis=1) for part in (errors[:, :3] / 1e-6, errors[:, 3:] / ARCSEC))
    return {**dict(zip(PARTS, np.abs(errors / UNITS).T, strict=True)), "position": shift, "orientation": turn}


def test_no_signs_of_the_actuators_errors_are_worse_than_the_worst_and_some_are_as_bad(
    accuracy: tuple[pd.DataFrame, pd.DataFrame],
) -> None:
    machine, signs = design(), np.array(list(product([-1.0, 1.0], repeat=6)))
    for quantity, row in accuracy[0].iterrows():
        found = _sizes(_errors(machine, *_place(row, machine), OFF * signs))[str(quantity)]
        assert found.max() == pytest.approx(row["worst"], rel=1e-4)  # the second order of 2 um in 0.3 m is 1e-5


def test_errors_spread_evenly_scatter_by_the_stated_deviation(accuracy: tuple[pd.DataFrame, pd.DataFrame]) -> None:
    machine, draws = design(), 4000
    off = OFF * np.random.default_rng(1).uniform(-1, 1, (draws, 6))
    for quantity, row in accuracy[0].iterrows():
        found = _sizes(_errors(machine, *_place(row, machine), off))[str(quantity)]
        assert np.sqrt(np.mean(found**2)) == pytest.approx(row["sigma"], rel=4 / np.sqrt(2 * draws))


def test_no_pose_of_the_workspace_is_worse(accuracy: tuple[pd.DataFrame, pd.DataFrame]) -> None:
    machine, rng = design(), np.random.default_rng(2)
    limit, signs = np.array([LIMITS[name] for name in POSE]), np.array(list(product([-1.0, 1.0], repeat=6)))
    largest = dict.fromkeys(accuracy[0].index, 0.0)
    for shift in rng.uniform(-limit, limit, (60, 6)):
        own = _sizes(_errors(machine, *_place(pd.Series(shift, POSE), machine), OFF * signs))
        largest = {name: max(worst, own[name].max()) for name, worst in largest.items()}
    for name, worst in largest.items():
        assert 0.8 * accuracy[0].loc[name, "worst"] < worst < 1.0001 * accuracy[0].loc[name, "worst"]


def test_the_inverse_jacobian_is_the_slope_of_the_legs_lengths(tmp_path: Path) -> None:
    machine, step = design(), 1e-6
    call(
        "design",
        _folder(tmp_path / "m", machine, LIMITS, "actuator_accuracy_mm = 0.001\n"),
        "--accuracy",
        "--out",
        tmp_path / "f.csv",
    )
    reported = pd.read_csv(tmp_path / "f-jacobian.csv").drop(columns="leg").to_numpy()
    p, R = rigid_pose(machine, machine.reading)
    own = []
    for k in range(6):
        moved = step * np.eye(6)[k]
        ends = [
            spans(
                machine.a,
                machine.b,
                (p + way * moved[:3])[None],
                Rotation.from_rotvec(way * moved[None, 3:]) * Rotation.from_matrix(R),
            )[0]
            for way in (1, -1)
        ]
        own.append((ends[0] - ends[1]) / (2 * step))
    unit = np.array([1.0] * 3 + [1e3 * np.pi / 180] * 3)  # m per rad as mm per degree
    np.testing.assert_allclose(reported, np.stack(own, 1) * unit, atol=1e-7)


def test_the_share_of_a_leg_is_what_its_error_alone_does(accuracy: tuple[pd.DataFrame, pd.DataFrame]) -> None:
    machine, (worst, legs) = design(), accuracy
    for name in PARTS:
        own = _sizes(_errors(machine, *_place(worst.loc[name], machine), np.diag(OFF)))[name]
        reported = legs[legs["quantity"] == name].sort_values("leg")["share"].to_numpy()
        np.testing.assert_allclose(reported, own / own.sum(), atol=1e-4)


def _solutions(machine: Hexapod, reading: np.ndarray, box: np.ndarray, starts: int) -> np.ndarray:
    """Different poses (K, 6) of one set of readings within a box (6,) about the reference: m and rotation vectors."""
    p, R = rigid_pose(machine, machine.reading)
    home, rng = Rotation.from_matrix(R), np.random.default_rng(3)
    shift = rng.uniform(-box, box, (starts, 6))
    length = np.repeat((machine.length + reading)[None], starts, 0)
    there, turn, found = poses(
        machine.a, machine.b, length, p + shift[:, :3], Rotation.from_rotvec(shift[:, 3:]) * home
    )
    at = np.hstack([there - p, (turn * home.inv()).as_rotvec()])[found]
    at = at[(np.abs(at) <= box).all(1)]
    return np.unique(at.round(7), axis=0)


def test_a_dense_search_finds_no_second_pose_if_uniqueness_is_proven(tmp_path: Path) -> None:
    machine = design()
    said = call("design", _folder(tmp_path / "m", machine, LIMITS), "--uniqueness", "--out", tmp_path / "f.csv")
    assert_says(said, "Proven", "rigid legs (ups)", "two different poses", "never")
    limits = pd.read_csv(tmp_path / "f-range.csv").set_index("coordinate")["half_range"]
    box = limits[POSE].to_numpy() * np.array([1e-3] * 3 + [np.pi / 180] * 3)
    rng, p, R = np.random.default_rng(4), *rigid_pose(machine, machine.reading)
    home = Rotation.from_matrix(R)
    for shift in rng.uniform(-box, box, (8, 6)):
        turn = Rotation.from_rotvec(shift[None, 3:]) * home
        reading = spans(machine.a, machine.b, (p + shift[:3])[None], turn)[0] - machine.length
        found = _solutions(machine, reading, 1.0001 * box, 300)
        assert len(found) == 1
        np.testing.assert_allclose(found[0], shift, atol=1e-6)


def test_uniqueness_is_not_proven_if_a_search_finds_two_poses(tmp_path: Path) -> None:
    """Joints in two planes: the mirrored platform under the base has the same readings."""
    machine = design()
    wide = {**dict.fromkeys(POSE, 1.0), "z_mm": 2020.0 * machine.height}
    box = np.array([wide[name] for name in POSE]) * np.array([1e-3] * 3 + [np.pi / 180] * 3)
    assert len(_solutions(machine, machine.reading, box, 4000)) == 2
    said = call("design", _folder(tmp_path / "m", machine, wide), "--uniqueness", "--out", tmp_path / "f.csv")
    assert not says(said, "Proven", "rigid legs (ups)", "two different poses")
    assert not says(said, "Proven", "rigid legs (ups)", "no pose", "singular")
    assert_says(said, "rigid legs (ups)", "two different poses", "never")


def test_the_path_of_a_flexures_end_is_that_of_a_parabola(tmp_path: Path) -> None:
    """Eq. 10 and 11 integrated; the circle of eq. 13 about beta of the length; and the pivot in the middle."""
    length, beta = 24.0, 0.3
    of_leg = f", flexure_length_mm = {length}, flexure_beta = {beta}"
    folder = _folder(tmp_path / "m", design(), LIMITS, of_leg=of_leg)
    call("design", folder, "--uniqueness", "--out", tmp_path / "f.csv")
    found = pd.read_csv(tmp_path / "f-flexures.csv") * 1e-3
    for row in found.iloc[[1, 40, 100]].itertuples():
        slope = np.radians(1e3 * row.bend_deg)
        # y = curvature x^2 / 2 over the flexure's length, which the bent beam exceeds by the displacement of its end
        curvature = slope / length
        exceeds = quad(lambda x, c=curvature: np.sqrt(1 + (c * x) ** 2) - 1, 0, length, epsabs=1e-14)[0]
        assert row.beam_across_um == pytest.approx(curvature * length**2 / 2, rel=1e-6)
        assert row.beam_along_um == pytest.approx(exceeds, rel=1e-6)
        for name, centre in (("circle", beta * length), ("pivot", length / 2)):
            across, along = getattr(row, f"{name}_across_um"), getattr(row, f"{name}_along_um")
            assert np.hypot(length - along - centre, across) == pytest.approx(length - centre, rel=1e-12)
