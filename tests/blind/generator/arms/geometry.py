"""Geometry of an arm as numbers that manufacture and assembly vary, in the notation in which the arm is written.

urdf: each moving joint's place, three lengths and three turns in its own frame. standard, modified: the four numbers
of each row. screws: of each axis two tilts, two shifts across it and the zero. Fixed joints, apart from three shifts of
those within loops, and the home pose of screws are exact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tests.blind.generator.arms.arm import Arm, Joint, Row, serial
from tests.blind.generator.arms.transforms import Array, inverse, motion, rotation

NOTATIONS = ("urdf", "standard", "modified", "screws")


@dataclass(frozen=True)
class Tolerance:
    """One standard deviation of manufacturing and assembly, m and rad."""

    offset: float
    length: float
    angle: float


@dataclass(frozen=True)
class Design:
    """The nominal arm, the notation of its file, its rows if it has rows, and whether the file holds masses."""

    arm: Arm
    notation: str
    rows: tuple[Row, ...] = ()
    tells_masses: bool = True

    def sigmas(self, tolerance: Tolerance) -> Array:
        """Standard deviations (P,) of all numbers of the geometry."""
        own = [sigma for joint in self._moving() for sigma in self._own(joint.kind, tolerance)]
        return np.array(own + [tolerance.length] * 3 * len(self._lengths))

    def changed(self, change: Array) -> Arm:
        """The arm with its geometry changed by (P,), m and rad."""
        builders: dict[str, Callable[[Array], Arm]] = {"urdf": self._placed, "screws": self._screwed}
        return builders.get(self.notation, self._rowed)(change)

    def _moving(self) -> list[Joint]:
        return [j for n, j in enumerate(self.arm.joints) if j.kind != "fixed" and n not in self.arm.passive]

    @property
    def _lengths(self) -> tuple[int, ...]:
        return () if self.arm.loops is None else self.arm.loops.lengths

    def _own(self, kind: str, tolerance: Tolerance) -> tuple[float, ...]:
        length, angle = tolerance.length, tolerance.angle
        zero = tolerance.offset if kind == "revolute" else length
        if self.notation == "screws":
            return (angle, angle, length, length, zero)
        turn = tolerance.offset if kind == "revolute" else angle
        if self.notation == "urdf":
            return (length, length, length, angle, angle, turn)
        return (length, angle, length, turn)

    def _placed(self, change: Array) -> Arm:
        split = len(change) - 3 * len(self._lengths)
        numbers, shifts, joints = iter(change[:split].reshape(-1, 6)), iter(change[split:].reshape(-1, 3)), []
        for number, joint in enumerate(self.arm.joints):
            if joint.kind == "fixed" or number in self.arm.passive:
                shift = next(shifts) if number in self._lengths else np.zeros(3)
                joints.append(replace(joint, origin=joint.origin @ motion(np.eye(3), shift)))
                continue
            own = next(numbers)
            across = frame_of(joint.axis)
            joints.append(replace(joint, origin=joint.origin @ motion(rotation(across @ own[3:]), across @ own[:3])))
        return replace(self.arm, joints=tuple(joints))

    def _rowed(self, change: Array) -> Arm:
        rows = tuple(
            replace(row, a=row.a + a, alpha=row.alpha + alpha, d=row.d + d, theta=row.theta + theta)
            for row, (a, alpha, d, theta) in zip(self.rows, change.reshape(-1, 4), strict=True)
        )
        return replace(self.arm, joints=serial(rows, self.notation).joints)

    def _screwed(self, change: Array) -> Arm:
        home, numbers, joints = frames_at_zero(self.arm), iter(change.reshape(-1, 5)), []
        true = [np.eye(4)] * len(home)
        for joint in self.arm.joints:
            true[joint.child] = home[joint.child]
            if joint.kind != "fixed":
                across = frame_of(joint.axis)
                tilt_x, tilt_y, x, y, zero = next(numbers)
                own = motion(rotation(across @ np.array([tilt_x, tilt_y, 0.0])), across @ np.array([x, y, 0.0]))
                turn = joint.axis * zero
                free = (turn, np.zeros(3)) if joint.kind == "revolute" else (np.zeros(3), turn)
                true[joint.child] = home[joint.child] @ own
                origin = inverse(true[joint.parent]) @ true[joint.child] @ motion(rotation(free[0]), free[1])
                joints.append(replace(joint, origin=origin))
            else:
                joints.append(replace(joint, origin=inverse(true[joint.parent]) @ home[joint.child]))
        return replace(self.arm, joints=tuple(joints))


def frame_of(axis: Array) -> Array:
    """Rotation (3, 3) whose third column is a unit axis."""
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first), axis], axis=1)


def frames_at_zero(arm: Arm) -> list[Array]:
    """Places (4, 4) of all links in the base frame with every joint at zero."""
    found = [np.eye(4)] * len(arm.links)
    for joint in arm.joints:
        found[joint.child] = found[joint.parent] @ joint.origin
    return found
