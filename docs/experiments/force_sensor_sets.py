"""Printed values of the force-sensor paper, and constructed sensors for values that it does not print.

The sets are constructed: A meets Table 2 and cond(G) at once, S has the symmetry that the paper draws, N is nearly so.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.six_upur import elements
from truing.simulation.bench.six_upur.elements import LegElement, leaf_compliance, universal_joint
from truing.simulation.bench.six_upur.geometry import JointCentres, joint_centres
from truing.simulation.bench.six_upur.stiffness import ElasticSensor, elastic_sensor
from truing.simulation.bench.six_upur.tolerances import sigma_of

FILE = Path(__file__).with_name("published_force_sensor.json")
LOADS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
ARCSEC = np.pi / 648000
UNITS = np.repeat([1e6, 1 / ARCSEC], 3)  # of displacements, as the paper prints them: um and arc seconds
LEAF_LENGTH, LEAF_WIDTH = 0.02, 0.03
LENS_M = 0.55  # an optical part at the rim of the platform
STEEL = 206e9, 0.3


@dataclass(frozen=True)
class SensorSet:
    """A sensor: radii and height, m; polar angles of B and b of legs 1, 6 and 5, degrees, the others mirrored about X.

    Each leg: universal joints of two leaves, of a thickness, m, at both ends; the force sensor, N/m; the revolute
    joint, N m/rad.
    """

    radii: tuple[float, float]
    polar: tuple[tuple[float, float, float], tuple[float, float, float]]
    thickness: float
    axial: float
    torsion: float
    height: float = 0.3

    def joints(self) -> JointCentres:
        """Return the unloaded joint centres."""
        lower, upper = (_ring(radius, polar) for radius, polar in zip(self.radii, self.polar, strict=True))
        return joint_centres(lower, upper, self.height)

    def leg(self) -> list[LegElement]:
        """Return the elements of one leg."""
        part = leaf_compliance(LEAF_LENGTH, LEAF_WIDTH, self.thickness, *STEEL, "s1")
        joint = elements.compliance(universal_joint(part, LEAF_LENGTH))
        sensor, revolute = elements.spring(axial=self.axial), elements.spring(torsion=self.torsion)
        return [joint, elements.rigid(), sensor, joint, revolute]

    def sensor(self) -> ElasticSensor:
        """Return the sensor on elastic legs."""
        return elastic_sensor(self.joints(), self.leg())


SETS = {
    "A": SensorSet(
        (0.55, 0.55), ((42.3503, 97.9072, 121.8812), (10.6529, 129.6093, 127.9275)), 5.93552e-3, 11127420.0, 3497.18
    ),
    "S": SensorSet(
        (0.55, 0.55), ((20.0, 100.0, 140.0), (29.00863, 90.99137, 149.00863)), 5.93552e-3, 11127420.0, 3497.18
    ),
    "N": SensorSet(
        (0.42, 0.567), ((46.1287, 67.581, 168.4599), (69.6415, 51.1926, 192.7056)), 2.20311e-3, 10623700.0, 10.0863
    ),
}


def three_fold(half_below: float, half_above: float, **legs: float) -> SensorSet:
    """Return a sensor of the printed radii and height; joints in pairs, half an angle, degrees, from 0 and ±120."""
    polar = tuple((half, 120.0 - half, 120.0 + half) for half in (half_below, half_above))
    kept = {"thickness": SETS["S"].thickness, "axial": SETS["S"].axial, "torsion": SETS["S"].torsion}
    return SensorSet((0.55, 0.55), polar, **{**kept, **legs})  # type: ignore[arg-type]


@cache
def published() -> SimpleNamespace:
    """Return the file, its tables by name and their entries by attribute."""
    return json.loads(FILE.read_text(encoding="utf-8"), object_hook=lambda entry: SimpleNamespace(**entry))


def sigmas() -> NDArray:
    """Return one standard deviation (5,), m, of the error sources."""
    return 1e-6 * sigma_of(published().tolerances.full_width_um)


def _ring(radius: float, polar_deg: tuple[float, float, float]) -> NDArray:
    first, sixth, fifth = np.radians(polar_deg)
    angle = np.array([first, -first, -sixth, -fifth, fifth, sixth])
    return radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(6)], -1)
