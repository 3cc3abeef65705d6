"""The true sensor: displaced joints, stiffness of each leg, and its response to a load.

Each leg is asked what a wrench at the platform's origin does to it, in the fixed frame; six side by side share one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.blind.generator.closure import platform_pose
from tests.blind.generator.quaternions import Array, rotate, unit
from tests.blind.generator.sensor.elements import Element, flexibilities

LEGS = 6
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Sensor:
    """As designed: joint centres B (fixed frame) and b (platform frame) (6, 3) and the platform's height, mm, as in
    campaign.toml; the elements of each leg.
    """

    lower_mm: Array
    upper_mm: Array
    height_mm: float
    elements: tuple[Element, ...]

    @property
    def elastic(self) -> int:
        """Elastic parameters of one leg."""
        return sum(element.elastic for element in self.elements)


@dataclass(frozen=True)
class Errors:
    """Assembly errors (6,) each, m, and compliance of each part of each leg relative to nominal (6, P)."""

    platform_radius: Array
    base_radius: Array
    lower_clearance: Array
    middle_clearance: Array
    sensor_installation: Array
    softer: Array


def flawless(sensor: Sensor) -> Errors:
    """The sensor as designed."""
    return Errors(*np.zeros((5, LEGS)), np.ones((LEGS, sensor.elastic)))


@dataclass(frozen=True)
class Legs:
    """Six assembled legs: unit vectors ``along`` them (6, 3), and what their parts give a wrench at the platform's
    origin (6, P, 6, 6), fixed frame.
    """

    along: Array
    parts: Array


@dataclass(frozen=True)
class Machine:
    """Compliance (6, 6) of the platform at its origin, fixed frame, and tensions (6, 6) of its legs by the wrench."""

    legs: Legs
    compliance: Array
    tension: Array


def build(sensor: Sensor, errors: Errors) -> Machine:
    """The sensor assembled with errors: loops closed, each leg as soft as it is."""
    lower, upper = sensor.lower_mm / 1e3, sensor.upper_mm / 1e3
    straight = upper + sensor.height_mm / 1e3 * UP - lower
    length = np.linalg.norm(straight, axis=-1)
    length = length + errors.lower_clearance - errors.middle_clearance + errors.sensor_installation
    lower = lower + errors.base_radius[:, None] * _outwards(lower)
    upper = upper + errors.platform_radius[:, None] * _outwards(upper)
    p, q = platform_pose(1e3 * lower[None], 1e3 * upper[None], 1e3 * length[None], sensor.height_mm)
    arm, origin = rotate(q, upper), p[0] / 1e3
    pairs = zip(lower - origin, arm, strict=True)
    parts = np.stack([_leg(sensor.elements, foot, end) for foot, end in pairs])
    return sharing(Legs(unit(origin + arm - lower), parts), errors.softer)


def sharing(legs: Legs, softer: Array) -> Machine:
    """The platform on six legs side by side, their parts ``softer`` (6, P) times as soft as nominal."""
    share = np.linalg.inv(np.einsum("lp,lpij->lij", softer, legs.parts))
    compliance = np.linalg.inv(share.sum(0))
    return Machine(legs, compliance, np.einsum("lc,lcw->lw", legs.along, (share @ compliance)[:, :3]))


def _outwards(points: Array) -> Array:
    """Horizontal unit vectors away from the z axis."""
    return unit(points * [1.0, 1.0, 0.0])


def _leg(elements: tuple[Element, ...], foot: Array, end: Array) -> Array:
    """Compliances (P, 6, 6) that a wrench at the platform's origin feels of one leg's parts; joints from there, m."""
    axes = leg_axes(unit(end - foot))
    length = float(np.linalg.norm(end - foot))

    def carried(at: Array) -> tuple[Array, Array]:
        arm = -(foot + at[:, None] * axes[:, 2])  # from the section to the origin
        force = np.broadcast_to(axes.T @ np.eye(3, 6), (len(at), 3, 6))
        moment = np.zeros((len(at), 3, 6))
        moment[:, :, 3:] = axes.T
        moment[:, :, :3] = np.swapaxes(np.cross(arm[:, None], np.eye(3)) @ axes, 1, 2)
        return force, moment

    given = [element.length_mm for element in elements]
    rest = length - sum(value for value in given if value is not None) / 1e3
    lengths = [rest if value is None else value / 1e3 for value in given]
    start, parts = (0.0 if None in given else rest), []
    for element, own in zip(elements, lengths, strict=True):
        parts.append(flexibilities(element, start, own, carried))
        start = start + own
    return np.concatenate(parts)


def leg_axes(along: Array) -> Array:
    """Columns x, y, z of a leg: z along it, x = s1 horizontal; a vertical leg has the fixed x."""
    across = np.cross(UP, along)
    size = np.linalg.norm(across)
    x = across / size if size > 1e-9 else np.eye(3)[0]
    return np.stack([x, np.cross(along, x), along], axis=1)
