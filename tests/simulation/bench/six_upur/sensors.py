"""Sensors of the reference values, and sensors without any symmetry."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from truing.simulation.bench.six_upur import elements
from truing.simulation.bench.six_upur.elements import LegElement, leaf_compliance, universal_joint
from truing.simulation.bench.six_upur.geometry import JointCentres, joint_centres
from truing.simulation.bench.six_upur.stiffness import ElasticSensor, elastic_sensor

REFERENCE: dict[str, Any] = json.loads((Path(__file__).parent / "sensor_vectors.json").read_text(encoding="utf-8"))
SETS = ("A", "S", "N")
SEEDS = st.integers(0, 2**32 - 1)
STEP = 1e-30
TOLERANCES_UM = (155.0, 130.0, 36.0, 36.0, 87.0)


def vector(name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Inputs and outputs of a reference vector."""
    found = REFERENCE["vectors"][name]
    return found["inputs"], found["outputs"]


def joints_of(name: str) -> JointCentres:
    """The unloaded sensor of a reference set."""
    numbers = REFERENCE["sets"][f"fs_{name}"]
    platform = np.array(numbers["b"]) - np.array(numbers["reference_point"])
    return joint_centres(np.array(numbers["B"]), platform, numbers["h"])


def leg_of(name: str) -> list[LegElement]:
    """The leg of a reference set: universal joints of two leaves, an axial and a torsional spring."""
    numbers = REFERENCE["sets"][f"fs_{name}"]
    flexure = numbers["flexure"]
    part = leaf_compliance(flexure["lf"], flexure["w"], flexure["t"], numbers["E"], numbers["nu"], "s1")
    joint = elements.compliance(universal_joint(part, flexure["lf"]))
    sensor, revolute = elements.spring(axial=flexure["ks"]), elements.spring(torsion=flexure["kt"])
    return [joint, elements.rigid(), sensor, joint, revolute]


def sensor_of(name: str) -> ElasticSensor:
    """The elastic sensor of a reference set."""
    return elastic_sensor(joints_of(name), leg_of(name))


def crooked_joints(rng: np.random.Generator) -> JointCentres:
    """Joint centres on no ring and in no plane, legs of all lengths."""
    plain = joints_of("S")
    lower, arm = (points + rng.normal(0.0, 0.04, (6, 3)) for points in (plain.lower, plain.arm))
    return joint_centres(lower, arm, 0.3)


def crooked_leg(rng: np.random.Generator) -> list[LegElement]:
    """Elements of every kind, with a filler between them."""
    size = rng.uniform(0.5, 1.5, 8)
    loose = rng.normal(size=(6, 6)) * np.repeat([1e-5, 1e-3], 3)[:, None]
    return [
        elements.cylinder(0.02, 0.02 * size[0], 206e9, 0.3),
        elements.leaf(0.01, 0.02, 0.004 * size[1], 206e9, 0.3, "s1"),
        elements.notch(0.02, 0.003 * size[2], 0.006 * size[3], 70e9, 0.33, "s2"),
        elements.rigid(),
        elements.spring(axial=1e7 * size[4], torsion=3e3 * size[5], length=0.03),
        elements.compliance(loose @ loose.T, length=0.005),
        elements.leaf(0.01, 0.02, 0.004 * size[6], 206e9, 0.3, "s2"),
    ]


def levered(matrix: NDArray, length: float = 0.5) -> NDArray:
    """A stiffness (..., 6, 6) with moments over a lever and rotations times it, so that its entries share a unit."""
    size = np.repeat([1.0, 1.0 / length], 3)
    return matrix * np.outer(size, size)
