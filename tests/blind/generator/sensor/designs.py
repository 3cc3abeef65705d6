"""Designs of sensors to draw from: the nominal set A of the force-sensor paper, and two of other shape and size."""

from __future__ import annotations

import numpy as np

from tests.blind.generator.quaternions import Array
from tests.blind.generator.sensor.elements import Element, universal_joint
from tests.blind.generator.sensor.machine import LEGS, Sensor

# Polar angles in degrees, radii and height in mm: published radii and height, angles constructed to meet Table 2.
A_LOWER = (42.3503, -42.3503, -97.9072, -121.8812, 121.8812, 97.9072)
A_UPPER = (10.6529, -10.6529, -129.6093, -127.9275, 127.9275, 129.6093)
A_LEAF = Element("leaf", 20.0, {"width_mm": 30.0, "thickness_mm": 5.93552, "youngs_gpa": 206.0, "poisson": 0.3})
STEEL = {"youngs_gpa": 206.0, "poisson": 0.3}


def nominal_a() -> Sensor:
    """Universal joints of two crossed leaves at both ends, a soft force sensor, a revolute joint that resists twist."""
    joint = Element("compliance", matrix=universal_joint(A_LEAF, 20.0))
    elements = (
        joint,
        Element("rigid", None),
        Element("spring", numbers={"axial_n_per_m": 11127420.0}),
        joint,
        Element("spring", numbers={"torsion_n_m_per_rad": 3497.18}),
    )
    return Sensor(_circle(550.0, np.array(A_LOWER)), _circle(550.0, np.array(A_UPPER)), 300.0, elements)


def notched(rng: np.random.Generator) -> Sensor:
    """A small one: notches milled from the leg, a load cell between, close pairs on two circles."""
    lower = _pairs(rng.uniform(110, 140), rng.uniform(8, 20), rng.uniform(-4.0, 4.0, LEGS))
    upper = _pairs(rng.uniform(70, 95), rng.uniform(40, 52), rng.uniform(-4.0, 4.0, LEGS))
    web, radius = round(float(rng.uniform(1.2, 2.0)), 2), round(float(rng.uniform(3.0, 5.0)), 1)
    notch = {"width_mm": 12.0, "web_mm": web, "radius_mm": radius, "youngs_gpa": 114.0, "poisson": 0.34}
    elements = (
        *(Element("notch", 2 * radius, notch, soft) for soft in ("s1", "s2")),
        Element("cylinder", 25.0, {"diameter_mm": 10.0, "youngs_gpa": 71.0, "poisson": 0.33}),
        Element("spring", 12.0, {"axial_n_per_m": round(float(rng.uniform(0.6, 1.2)) * 1e6)}),
        Element("rigid", None),
        *(Element("notch", 2 * radius, notch, soft) for soft in ("s2", "s1")),
    )
    return Sensor(lower, upper, 150.0, elements)


def leaved(rng: np.random.Generator) -> Sensor:
    """One of medium size: leaves at both ends of a rod, nothing rigid."""
    lower, upper = _pairs(rng.uniform(200, 260), rng.uniform(8, 20)), _pairs(rng.uniform(150, 190), rng.uniform(38, 50))
    height = round(float(rng.uniform(190, 260)), 1)
    leaf = {"width_mm": 24.0, "thickness_mm": round(float(rng.uniform(2.0, 3.0)), 2), **STEEL}
    length = float(np.linalg.norm(upper[0] + [0.0, 0.0, height] - lower[0]))
    elements = (
        *(Element("leaf", 14.0, leaf, soft) for soft in ("s1", "s2")),
        Element("cylinder", round(length - 56.0, 3), {"diameter_mm": 9.0, **STEEL}),
        *(Element("leaf", 14.0, leaf, soft) for soft in ("s1", "s2")),
    )
    return Sensor(lower, upper, height, elements)


def _pairs(radius: float, half_deg: float, crooked_deg: Array | float = 0.0) -> Array:
    middles = np.repeat([30.0, 150.0, 270.0], 2)
    return _circle(radius, middles + np.tile([-half_deg, half_deg], 3) + crooked_deg)


def _circle(radius: float, degrees: Array) -> Array:
    angle = np.deg2rad(degrees)
    return np.round(np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1), 6)
