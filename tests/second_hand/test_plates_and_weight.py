"""Elastic plates and own weight by command line, against finite elements of their sectors and an energy method."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.blind.generator.sensor.designs import nominal_a
from tests.blind.generator.sensor.machine import Legs, Machine, build, flawless, sharing
from tests.second_hand.command import run

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data" / "force-sensor"
LOADS, RESPONSES = ["fx", "fy", "fz", "mx", "my", "mz"], ["dx", "dy", "dz", "rx", "ry", "rz"]
SLICES = 150
GRAVITY, ARCSEC = 9.80665, np.pi / 180 / 3600


@dataclass(frozen=True)
class Plate:
    """Thickness and radius of the rigid middle, m; moduli, Pa."""

    thickness: float
    rigid: float
    youngs: float
    poisson: float


PLATFORM, BASE = Plate(0.050, 0.22, 70e9, 0.30), Plate(0.040, 0.40, 210e9, 0.25)
OUTER, DENSITY, CENTRE = 0.60, 2700.0, np.array([0.010, -0.020, 0.030])


def _sections() -> str:
    def lines(name: str, plate: Plate) -> str:
        return (
            f"\n[mechanism.{name}]\nthickness_mm = {1e3 * plate.thickness}\nrigid_radius_mm = {1e3 * plate.rigid}\n"
            f"youngs_gpa = {1e-9 * plate.youngs}\npoisson = {plate.poisson}\n"
        )

    weight = f"outer_radius_mm = {1e3 * OUTER}\ndensity_kg_m3 = {DENSITY}\ncom_mm = {(1e3 * CENTRE).tolist()}\n"
    return lines("platform", PLATFORM) + weight + lines("base", BASE)


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> dict[str, pd.DataFrame]:
    place = tmp_path_factory.mktemp("plates")
    shutil.copytree(SAMPLE, place / "c")
    text = (place / "c" / "campaign.toml").read_text(encoding="utf-8")
    (place / "c" / "campaign.toml").write_text(text + _sections(), encoding="utf-8")
    return run(place / "c", "deformation", place / "run")


def _sensor() -> Machine:
    return build(nominal_a(), flawless(nominal_a()))


def _joints() -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper joints (6, 3) from the platform's origin, m."""
    sensor = nominal_a()
    return sensor.lower_mm / 1e3 - [0.0, 0.0, sensor.height_mm / 1e3], sensor.upper_mm / 1e3


def _angles(joints: np.ndarray) -> np.ndarray:
    """Each joint's share of the circle: to the middle of both gaps to its neighbours."""
    at = np.degrees(np.arctan2(joints[:, 1], joints[:, 0])) % 360
    gap = (at[None] - at[:, None]) % 360
    gap[gap == 0] = 360.0
    ahead, behind = gap.min(1), (360.0 - np.where(gap == 360.0, 0.0, gap)).min(1)
    return np.radians((ahead + behind) / 2)


def _sector(plate: Plate, radius: float, angle: float) -> np.ndarray:
    """Compliance (6, 6) of the tip of a clamped sector, axes radial, tangential, normal: beam elements in a row.

    Each element has the width at its middle; stiffness matrices are assembled and the clamped end is taken out.
    """
    edge = np.linspace(plate.rigid, radius, SLICES + 1)
    whole = np.zeros((6 * (SLICES + 1),) * 2)
    for n, (start, end) in enumerate(pairwise(edge)):
        h, width, t = end - start, angle * (start + end) / 2, plate.thickness
        thin, wide = min(width, t), max(width, t)
        twist = wide * thin**3 / 3 * (1 - 0.63 * thin / wide * (1 - thin**4 / (12 * wide**4)))
        G = plate.youngs / (2 + 2 * plate.poisson)
        own = np.zeros((12, 12))
        for (i, j), k in (((0, 6), plate.youngs * width * t / h), ((3, 9), G * twist / h)):
            own[np.ix_([i, j], [i, j])] += k * np.array([[1, -1], [-1, 1]])
        # v tangential with turns about the normal; w normal with turns about the tangent, of the other sign
        for dofs, inertia, way in (((1, 5, 7, 11), t * width**3 / 12, 1), ((2, 4, 8, 10), width * t**3 / 12, -1)):
            a, b = 12 / h**3, way * 6 / h**2
            bend = np.array([[a, b, -a, b], [b, 4 / h, -b, 2 / h], [-a, -b, a, -b], [b, 2 / h, -b, 4 / h]])
            own[np.ix_(dofs, dofs)] += plate.youngs * inertia * bend
        whole[6 * n : 6 * n + 12, 6 * n : 6 * n + 12] += own
    return np.linalg.inv(whole[6:, 6:])[-6:, -6:]


def _felt(plate: Plate, joints: np.ndarray) -> np.ndarray:
    """Matrices (6, 1, 6, 6) from a wrench at the platform's origin to the wrench on the sector at each joint (6, 3)."""
    found = []
    for joint, angle in zip(joints, _angles(joints), strict=True):
        radius = np.hypot(*joint[:2])
        out = np.array([joint[0], joint[1], 0.0]) / radius
        axes = np.stack([out, np.cross([0, 0, 1.0], out), [0, 0, 1.0]])
        carried = np.zeros((6, 6))
        carried[:3, :3] = carried[3:, 3:] = axes
        carried[3:, :3] = axes @ np.array(
            [[0, joint[2], -joint[1]], [-joint[2], 0, joint[0]], [joint[1], -joint[0], 0]]
        )
        found.append([carried.T @ _sector(plate, radius, angle) @ carried])
    return np.array(found)


def _change(added: np.ndarray) -> np.ndarray:
    machine = _sensor()
    parts = np.concatenate([machine.legs.parts, added], 1)
    softer = sharing(Legs(machine.legs.along, parts), np.ones(parts.shape[:2]))
    return softer.compliance - machine.compliance


def _reported_change(tables: dict[str, pd.DataFrame], effect: str) -> np.ndarray:
    rows = tables["neglected"].query("effect == @effect")
    return rows.pivot(index="response", columns="load", values="effect_change").loc[RESPONSES, LOADS].to_numpy()


@pytest.mark.parametrize(("effect", "plate", "which"), [("elastic platform", PLATFORM, 1), ("elastic base", BASE, 0)])
def test_a_plate_changes_the_compliance_as_finite_elements_say(
    tables: dict[str, pd.DataFrame], effect: str, plate: Plate, which: int
) -> None:
    own = _change(_felt(plate, _joints()[which]))
    size = np.sqrt(np.outer(np.diag(own), np.diag(own)))  # of entries in their own units
    # 150 elements of even width: off by the square of a slice over the radius, some 1e-5
    assert np.all(np.abs(_reported_change(tables, effect) - own) < 1e-3 * size)


def test_the_weight_and_what_it_does(tables: dict[str, pd.DataFrame]) -> None:
    found = tables["own_weight"].set_index(["figure", "subject"])["value"]
    machine, mass = _sensor(), DENSITY * np.pi * OUTER**2 * PLATFORM.thickness
    assert found["mass", "platform"] == pytest.approx(mass, rel=1e-9)
    force = np.array([0.0, 0.0, -GRAVITY * mass])
    wrench = np.concatenate([force, np.cross(CENTRE, force)])
    unit = np.array([1e6] * 3 + [1 / ARCSEC] * 3)
    moved = machine.compliance @ wrench * unit
    reported = found["displacement"].loc[RESPONSES].to_numpy()
    np.testing.assert_allclose(reported, moved, atol=1e-5 * np.abs(moved[:3]).max())
    tension = found["leg tension"].to_numpy()
    np.testing.assert_allclose(tension, machine.tension @ wrench, atol=1e-5 * np.abs(tension).max())
