"""The telescope of the reference values with its flexures and tubes, in SI."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.simulation.mechanisms.telescope import REFERENCE as KINEMATIC_REFERENCE
from tests.simulation.mechanisms.telescope import telescope
from truing.estimation.rotation import exp_so3
from truing.simulation.change import Change
from truing.simulation.mechanisms.structures.beams import section
from truing.simulation.mechanisms.structures.structure import BeamSection, Closing, Machine, Structure

REFERENCE: dict[str, Any] = json.loads((Path(__file__).parent / "flexure_vectors.json").read_text(encoding="utf-8"))
_PARTS = REFERENCE["flexure"]
FLEXURE, TUBE = (
    section(_PARTS[part]["d"] * 1e-3, _PARTS[part]["E"] * 1e6, _PARTS[part]["nu"]) for part in ("flexure", "leg_tube")
)
FLEXURE_M, TUBE_M = _PARTS["l_b"] * 1e-3, _PARTS["leg_element_length"] * 1e-3
TABLE_3 = (
    np.array(KINEMATIC_REFERENCE["configurations"]) * REFERENCE["half_range_mm"] * 1e-3
)  # actuators from their reference, m
STEP = 1e-30
SHAPES = {"a": (6, 3), "b": (6, 3), "u": (6, 3), "l": (6,), "rho0": (6,), "flexure_length": (6,), "deformation": (6, 6)}
SHAPES |= {"beta": (6,)}
SECTIONS = {"flexure": (3,), "tube": (3,)}


def vector(name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Inputs and outputs of a reference vector."""
    found = REFERENCE["vectors"][name]
    return found["inputs"], found["outputs"]


def pose(inputs: dict[str, Any]) -> tuple[NDArray, NDArray]:
    """The pose of a reference vector as a batch of one."""
    return np.array(inputs["p_mm"])[None] * 1e-3, np.array(inputs["R"])[None]


def in_mm(stiffness: NDArray) -> NDArray:
    """A stiffness over nodes of three displacements and three rotations, from N, m and rad to N, mm and rad."""
    size = np.tile(np.repeat([10**-1.5, 10**1.5], 3), stiffness.shape[-1] // 6)
    return stiffness * np.outer(size, size)


def flexure_telescope(kind: str = "6-pus") -> Machine:
    """The nominal telescope or hexapod; nothing deforms but flexures and legs."""
    return Machine(telescope(kind), np.zeros((6, 6)), np.full(6, FLEXURE_M), FLEXURE, TUBE)


def crooked(rng: np.random.Generator, kind: str) -> Machine:
    """A machine that no symmetry spares anything: geometry off, platform deforming and loaded, its frame turned."""
    plain = flexure_telescope(kind)
    turn = exp_so3(rng.normal(0.0, 0.3, 3))  # so that R0 is far from the identity
    moved = {name: getattr(plain.legs, name) + rng.normal(0.0, 2e-3, SHAPES[name]) for name in ("a", "b", "l", "rho0")}
    u = plain.legs.u + rng.normal(0.0, 0.05, (6, 3))
    moved |= {"b": moved["b"] @ turn, "u": u / np.linalg.norm(u, axis=-1, keepdims=True)}
    load = rng.normal(size=6) * [50.0, 50.0, 50.0, 5.0, 5.0, 5.0]
    flexures = rng.uniform(0.008, 0.012, 6)
    return replace(
        plain,
        legs=plain.legs.replace(**moved),
        deformation=rng.normal(0.0, 0.01, (6, 6)),
        flexure_length=flexures,
        load=load,
        beta=rng.uniform(0.1, 0.4, 6),
    )


def nudged(machine: Machine, field: str, by: NDArray) -> Machine:
    """The machine with a field moved."""
    held = getattr(machine.legs, field, None)
    if held is not None:
        return replace(machine, legs=machine.legs.replace(**{field: held + by}))
    held = getattr(machine, field)
    if isinstance(held, BeamSection):
        held, by = np.array([held.bending, held.axial, held.torsion]), np.asarray(by)
        return replace(machine, **{field: BeamSection(*(held + by))})
    return replace(machine, **{field: held + by})


def stepped(structure: Structure, machine: Machine, p: NDArray, R: NDArray, rho: NDArray, field: str) -> Closing:
    """A closing whose derivatives are complex steps: by twist, readings and one field of the machine."""

    def slope(machine: Machine, p: NDArray, R: NDArray, rho: NDArray) -> NDArray:
        return structure.close(machine, p, R, rho, Change({}, 0)).value.imag / STEP

    shape = (SHAPES | SECTIONS)[field]
    tiny, count = 1j * STEP, int(np.prod(shape))
    by_twist = [slope(machine, p + tiny * e[:3], exp_so3(tiny * e[3:]) @ R, rho) for e in np.eye(6)]
    by_rho = [slope(machine, p, R, rho + tiny * e) for e in np.eye(6)]
    by_field = [slope(nudged(machine, field, tiny * e.reshape(shape)), p, R, rho) for e in np.eye(count)]
    value = structure.close(machine, p, R, rho, Change({}, 0)).value
    return Closing(value, *(np.stack(found, -1) for found in (by_twist, by_rho, by_field)))


def one_field(field: str) -> Change:
    """The change by all entries of one field of the machine."""
    shape = (SHAPES | SECTIONS)[field]
    count = int(np.prod(shape))
    return Change({field: np.eye(count).reshape(*shape, count)}, count)
