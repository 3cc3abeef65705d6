"""Scene before a camera: solids, and planar objects on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.blind.generator.quaternions import Array, unit
from tests.photographs.patterns import Pattern
from tests.photographs.solids import Solid


@dataclass(frozen=True)
class Decal:
    """A pattern on a plane: centre (3,) in mm, unit vectors (3,) to its right and down as seen from the front, how far
    it reaches (mm), and how it throws light back: like paper, or like a reflector towards the flash.
    """

    name: str
    pattern: Pattern
    centre: Array
    right: Array
    down: Array
    reach_mm: float
    reflector: bool = False

    @property
    def normal(self) -> Array:
        """Towards whoever looks at it."""
        return -np.cross(self.right, self.down)


@dataclass(frozen=True)
class Scene:
    """Solids, decals, and how they are lit: flash at the camera (1 at ``nominal_mm``), and an even ambient light."""

    solids: tuple[Solid, ...]
    decals: tuple[Decal, ...]
    nominal_mm: float = 1500.0
    ambient: float = 0.05


def on_plane(normal: Array, turn_rad: float) -> tuple[Array, Array]:
    """Unit vectors to the right and down (3,) of a decal that faces along ``normal``, turned clockwise."""
    level = np.cross([0.31, 0.27, 0.91], normal)
    right = unit(level if np.linalg.norm(level) > 1e-6 else np.cross([1.0, 0.0, 0.0], normal))
    down = np.cross(right, unit(normal))
    return np.cos(turn_rad) * right + np.sin(turn_rad) * down, np.cos(turn_rad) * down - np.sin(turn_rad) * right


def decal(
    name: str, pattern: Pattern, centre: Array, normal: Array, turn_rad: float = 0.0, *, reflector: bool = False
) -> Decal:
    """A decal that faces along ``normal``."""
    right, down = on_plane(normal, turn_rad)
    return Decal(name, pattern, np.asarray(centre, float), right, down, pattern.reach_mm, reflector)
