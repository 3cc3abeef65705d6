"""A hexapod on elastic legs by the least strain energy of its legs under loads; m, rad, N, N m.

A leg is a flexure, a tube and a flexure, clamped to both bodies. Its energy is that of a beam seen from its own chord:
elongation against its length, and rotation of both ends against the chord. The chord turns with the leg, so that a
rigid leg that turns stores nothing; no stiffness matrix of a leg's ends is formed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from tests.second_hand.rigid_hexapod import poses

Array = np.ndarray
STEP = 1e-5  # m and rad of a central difference: truncated at 1e-9 of a leg's energy
GRAVITY = 9.80665


@dataclass(frozen=True)
class Section:
    """A round bar: diameter, m, Young's modulus, Pa, and Poisson's ratio."""

    diameter: float
    youngs: float
    poisson: float

    @property
    def bending(self) -> float:
        return self.youngs * np.pi * self.diameter**4 / 64

    @property
    def axial(self) -> float:
        return self.youngs * np.pi * self.diameter**2 / 4

    @property
    def torsion(self) -> float:
        return self.youngs / (2 + 2 * self.poisson) * np.pi * self.diameter**4 / 32


@dataclass(frozen=True)
class Hexapod:
    """Joints a (6, 3) on the base and b (6, 3) on the platform, distance of a leg's joints at reading 0 (6,), and the
    readings (6,) at which the legs are straight; a flexure is centred on each joint."""

    a: Array
    b: Array
    length: Array
    reading: Array
    height: float
    flexure_length: float = 0.010
    flexure: Section = Section(2e-3, 114e9, 0.34)
    tube: Section = Section(12e-3, 150e9, 0.30)


def design() -> Hexapod:
    """The drawing: joints in close pairs on two circles."""
    middle, side = np.radians([30, 30, 150, 150, 270, 270]), np.array([-1, 1] * 3)
    base = 0.20 * _circle(middle + 0.20 * side)
    platform = 0.13 * _circle(middle + np.radians(60) * side - 0.15 * side)
    height = 0.35
    span = np.linalg.norm(platform + np.array([0, 0, height]) - base, axis=1)
    return Hexapod(base, platform, span - 0.05, np.full(6, 0.05), height)


def _circle(angle: Array) -> Array:
    return np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)


def rigid_pose(machine: Hexapod, reading: Array) -> tuple[Array, Array]:
    """Position (3,) and rotation matrix of the platform on rigid legs of ideal joints."""
    start = np.array([[0, 0, machine.height]])
    p, turn, found = poses(machine.a, machine.b, (machine.length + reading)[None], start, Rotation.identity(1))
    assert found.all()
    return p[0], turn.as_matrix()[0]


class Elastic:
    """The springs of the hexapod's legs, unstrained at its ``reading``."""

    def __init__(self, machine: Hexapod) -> None:
        self.machine = machine
        self.p, self.R = rigid_pose(machine, machine.reading)
        leg = self.p + machine.b @ self.R.T - machine.a
        self.z = leg / np.linalg.norm(leg, axis=1)[:, None]
        self.axes = np.stack([_axes(z) for z in self.z])
        half = 0.5 * machine.flexure_length * self.z
        self.root, self.end = machine.a - half, machine.b + half @ self.R
        self.straight = machine.length + machine.reading + machine.flexure_length
        self.springs = [_springs(machine, length) for length in self.straight]

    def strains(self, twist: Array, p: Array, R: Array, reading: Array) -> Array:
        """Roots of twice the energies (36,) of the legs at a pose moved by ``twist`` (6,)."""
        more = Rotation.from_rotvec(twist[3:]).as_matrix() @ R
        chord = p + twist[:3] + self.end @ more.T - self.root
        size = np.linalg.norm(chord, axis=1)
        seen = _arcs(self.axes[:, :, 2], chord / size[:, None]) @ self.axes
        back = np.swapaxes(seen, 1, 2)
        lower = Rotation.from_matrix(back @ self.axes).as_rotvec()
        upper = Rotation.from_matrix(back @ (more @ self.R.T) @ self.axes).as_rotvec()
        axial, bend, twisted = (np.array(part) for part in zip(*self.springs, strict=True))
        longer = size - self.straight - (reading - self.machine.reading)
        bent = [np.einsum("lij,jl->li", bend, [lower[:, k], upper[:, k]]) for k in (0, 1)]
        wound = upper[:, 2] - lower[:, 2]
        found = [(np.sqrt(axial) * longer)[:, None], *bent, (np.sqrt(twisted) * wound)[:, None]]
        return np.concatenate(found, 1).ravel()

    def pose(self, reading: Array, load: Array, weight: float, centre: Array) -> tuple[Array, Array]:
        """Position and rotation matrix in equilibrium under a wrench (6,) at the platform's origin, and a weight, N, at
        ``centre`` of the platform."""
        p, R = rigid_pose(self.machine, reading)
        for _ in range(40):
            ends = [[self.strains(way * step, p, R, reading) for step in STEP * np.eye(6)] for way in (1, -1)]
            slope = (np.array(ends[0]) - np.array(ends[1])).T / (2 * STEP)
            pull = np.array([0, 0, -weight])
            acting = load + np.concatenate([pull, np.cross(R @ centre, pull)])
            step = np.linalg.solve(slope.T @ slope, acting - slope.T @ self.strains(np.zeros(6), p, R, reading))
            p, R = p + step[:3], Rotation.from_rotvec(step[3:]).as_matrix() @ R
            if np.abs(step).max() < 1e-12:
                return p, R
        raise ArithmeticError(f"no equilibrium: last step {np.abs(step).max():.1e}")


def _axes(z: Array) -> Array:
    x = np.cross([0.3, 0.9, 0.1], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], 1)


def _arcs(one: Array, other: Array) -> Array:
    """The smallest rotations (n, 3, 3) from unit vectors (n, 3) to others."""
    x, y, z = np.cross(one, other).T
    none = np.zeros_like(x)
    K = np.moveaxis(np.array([[none, -z, y], [z, none, -x], [-y, x, none]]), 2, 0)
    return np.eye(3) + K + K @ K / (1 + np.sum(one * other, 1))[:, None, None]


def _springs(machine: Hexapod, length: float) -> tuple[float, Array, float]:
    """Stiffness of a leg on its chord: axial, root (2, 2) of that of end rotations in a plane, and torsional.

    By the energy of its sections (Castigliano).
    """
    parts = [(0.0, machine.flexure_length, machine.flexure)]
    parts += [(machine.flexure_length, length - machine.flexure_length, machine.tube)]
    parts += [(length - machine.flexure_length, length, machine.flexure)]
    give, bend, twist = 0.0, np.zeros((2, 2)), 0.0
    node, weight = np.polynomial.legendre.leggauss(3)
    for start, stop, section in parts:
        at, own = (start + stop) / 2 + (stop - start) / 2 * node, (stop - start) / 2 * weight
        moment = np.stack([1 - at / length, -at / length])
        bend += (moment * own) @ moment.T / section.bending
        give += (stop - start) / section.axial
        twist += (stop - start) / section.torsion
    return 1 / give, np.linalg.cholesky(np.linalg.inv(bend)).T, 1 / twist
