"""Nominal machines like the telescope: two rings of six joints in close pairs, legs between them, upright actuators."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from docs.experiments.telescope_report_data import published
from truing.simulation.mechanisms.legs.closures import mechanism
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
from truing.simulation.mechanisms.structures.structure import BeamSection, Machine, poses_at

# About 10 mm: what Table 5a and 6a say together (`telescope_report_kappa.reference_reading`).
REFERENCE_READING = 10e-3
MODEL = KinematicModel("6-pus")
# Which ring a leg's joint shares its close pair on: leg 1 stands next to 2 on one ring and next to 6 on the other.
_WITH_NEXT = np.array([[0, 0, 1, 1, 2, 2], [-1, 1, -1, 1, -1, 1]])
_WITH_LAST = np.array([[-0.5, 0.5, 0.5, 1.5, 1.5, -0.5], [1, -1, 1, -1, 1, -1]])


@dataclass(frozen=True)
class Pattern:
    """Numbering of the legs round the rings, where the report shows it in a figure only.

    platform: legs 1 and 2 are neighbours on the platform (else on the base); turning: +1 where leg numbers rise
    counterclockwise; towards: direction (rad) from the centre to the middle of legs 1 and 2.
    """

    platform: bool = True
    turning: int = 1
    towards: float = -np.pi / 2


@dataclass(frozen=True)
class Shape:
    """The four numbers of the design, any batch shape (...): radii in m, half separations of close pairs in rad."""

    base_radius: NDArray
    platform_radius: NDArray
    base_half: NDArray
    platform_half: NDArray
    turned: NDArray | float = 0.0  # rad, the whole pattern about z
    twist: NDArray | float = 0.0  # rad, the platform alone about z

    @classmethod
    def of(cls, numbers: NDArray) -> Shape:
        """Return shapes from numbers (..., 4), or more of them in the order of the fields."""
        return cls(*np.moveaxis(np.asarray(numbers, float), -1, 0))


def machine(shape: Shape, pattern: Pattern | None = None, leg_length: float | NDArray | None = None) -> Machine:
    """Return the machines of shapes (...), with the whole of the published K; arrays lead with (...)."""
    pattern = pattern or Pattern()
    length = published().stated["leg_length"] if leg_length is None else leg_length
    rings = (_WITH_NEXT, _WITH_LAST) if pattern.platform else (_WITH_LAST, _WITH_NEXT)
    b = _ring(rings[0], pattern, shape.platform_radius, shape.platform_half, np.add(shape.turned, shape.twist))
    a = _ring(rings[1], pattern, shape.base_radius, shape.base_half, shape.turned)
    lengths = np.broadcast_to(np.asarray(length, float)[..., None], a.shape[:-1])
    return Machine(mechanism("6-pus", a, b, None, lengths, np.full(a.shape[:-1], REFERENCE_READING)), published().K)


def _ring(pairs: NDArray, pattern: Pattern, radius: NDArray, half: NDArray, turned: NDArray | float) -> NDArray:
    """Return joints (..., 6, 3) in m: centres of the pairs a third of a turn apart."""
    third, side = pairs
    offset = third * (2 * np.pi / 3) + side * np.asarray(half)[..., None]
    angle = pattern.towards + np.asarray(turned)[..., None] + pattern.turning * offset
    flat = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    return np.asarray(radius)[..., None, None] * flat


def with_deformation(of: Machine, deformation: NDArray) -> Machine:
    """Return the machine with another K."""
    return replace(of, deformation=deformation)


def flexible(of: Machine) -> Machine:
    """Return the machine with flexures and tubes, none of which the report prints.

    Assumed: flexures of titanium, 10 mm long and 2 mm thick; legs of carbon fibre, solid, 12 mm thick.
    """
    length = np.full(of.legs.l.shape, 10e-3)
    return replace(of, flexure_length=length, flexure=_round(2e-3, 114e9, 0.34), tube=_round(12e-3, 150e9, 0.3))


def _round(diameter: float, young: float, poisson: float) -> BeamSection:
    second = np.pi * diameter**4 / 64
    shear = young / (2 * (1 + poisson))
    return BeamSection(young * second, young * np.pi * diameter**2 / 4, shear * 2 * second)


class OpenError(ArithmeticError):
    """Legs that no pose of the platform closes."""


@dataclass(frozen=True)
class Stand:
    """Poses at which a machine was measured, with its readings."""

    p: NDArray  # (N, 3) m
    R: NDArray  # (N, 3, 3)
    rho: NDArray  # (N, 6) m


def stand(truth: Machine, displacement: NDArray | None = None) -> Stand:
    """Return the poses of a machine at displacements (N, 6), m, of its actuators; by default those of Table 3.

    Raises OpenError where the legs do not close.
    """
    moves = published().calibration if displacement is None else displacement
    rho = truth.legs.rho0 + moves
    found = poses_at(MODEL, truth, rho)
    if not np.all(found.converged):
        raise OpenError(f"found {np.sum(~found.converged)} configurations that no pose closes, expected none")
    return Stand(found.p, found.R, rho)
