"""Loops of a delta robot in closed form: three spheres meet at the platform, three rods carry its weight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from tests.blind.generator.arms.arm import Arm
from tests.blind.generator.arms.transforms import Array, lower_meeting

_ARMS = range(1, 4)


@dataclass(frozen=True)
class DeltaLoops:
    """Links of the elbows, rod ends and seats; the slides of the platform, and the joints that hold lengths."""

    elbows: Array
    ends: Array
    seats: tuple[int, ...]
    passive: tuple[int, ...]
    lengths: tuple[int, ...]
    closure: str = "delta"

    @classmethod
    def of(cls, arm: Arm) -> Self:
        """Loops of a tree with the names of the layout."""
        joints = {joint.name: n for n, joint in enumerate(arm.joints)}
        elbows, ends = (np.array([arm.link(f"{part}_{k}") for k in _ARMS]) for part in ("forearm", "forearm_end"))
        lengths = tuple(joints[f"{part}_{k}"] for part in ("elbow", "length", "seat") for k in _ARMS)
        slides = tuple(joints[f"platform_{axis}"] for axis in "xyz")
        return cls(elbows, ends, lengths[6:], slides, lengths)

    def values(self, arm: Arm, turned: Array, moved: Array, growth: Array) -> Array:
        """Slides (N, 3), m, of a platform that stays level."""
        radii = np.linalg.norm(moved[:, self.ends] - moved[:, self.elbows], axis=-1)
        away = self._seats(arm) * (1.0 + growth[:, arm.joints[self.seats[0]].parent, None, None])
        start = arm.joints[self.passive[0]].origin[:3, 3] * (1.0 + growth[:, :1])
        return np.asarray(lower_meeting(moved[:, self.elbows] - away, radii) - start)

    def pulls(self, arm: Arm, moved: Array, weight: float) -> tuple[Array, Array]:
        """Elbows, and the pulls (N, 3, 3), N, of rods that hold the weight by forces along themselves."""
        carried = moved[:, arm.joints[self.seats[0]].parent, None] + self._seats(arm)
        rods = carried - moved[:, self.elbows]
        rods = rods / np.linalg.norm(rods, axis=-1, keepdims=True)
        sizes = np.linalg.solve(np.swapaxes(rods, -1, -2), np.tile(weight * arm.gravity, (len(rods), 1))[..., None])
        return self.elbows, rods * sizes

    def _seats(self, arm: Arm) -> Array:
        return np.stack([arm.joints[n].origin[:3, 3] for n in self.seats])
