"""What rays of a pose may tell of: the numbers that all poses should share, and what is known of the poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truing.simulation.inputs import ORDER, TEMPERATURE, ranks

CAMERA, BAR, AIR, WINDOW = "camera", "bar", "air", "window"


@dataclass(frozen=True)
class RayParameter:
    """A number that all poses should share: of which kind of thing, of which one of these, its name and unit.

    ``scale`` is what brings it to about one. ``sigma`` is how well its value in the adjustment is known beforehand
    apart from the rays (a bar's calibration); None: not at all; 0: exactly, so that only causes move it; ``mean``:
    what was known of it beforehand, less that value.
    """

    kind: str
    owner: str
    name: str
    unit: str
    scale: float
    sigma: float | None
    mean: float = 0.0

    @property
    def called(self) -> str:
        """Return what tells it from all others: ``camera A c``, ``bar 1 strain``."""
        return " ".join(filter(None, (self.kind, self.owner, self.name)))


@dataclass(frozen=True)
class RayPoses:
    """B poses and the T numbers that their rays tell of, pose by pose.

    ``root`` (B, K, T) is how the K whitened channels of a pose follow these, in units of their scale; ``seen`` (B, K)
    which channels of a pose say anything. Covariates (B,) are the columns known of each pose, with ``order``.
    """

    poses: tuple[int | str, ...]
    parameters: tuple[RayParameter, ...]
    channels: tuple[str, ...]
    root: NDArray
    seen: NDArray
    covariates: Mapping[str, NDArray]
    span_s: tuple[float, float] | None = None
    reference_temperature_c: float = 20.0
    up: NDArray | None = None  # (B, 3) the vertical in the axes of each pose's measurement, where it is known

    @property
    def readings(self) -> NDArray:
        """Return what stands for the readings of actuators: none (B, 0)."""
        return np.zeros((len(self.poses), 0))

    @cached_property
    def heat(self) -> NDArray:
        """Return the temperature above the reference (B,), K."""
        return np.asarray(self.covariates[TEMPERATURE], float) - self.reference_temperature_c

    @cached_property
    def rank(self) -> NDArray:
        """Return the rank in time (B,) of each pose among these."""
        order = self.covariates.get(ORDER, np.arange(len(self.poses)))
        return ranks(order)

    def varies(self, column: str) -> bool:
        """Return whether a column is known at all poses and takes more than one value."""
        values = self.covariates.get(column)
        return values is not None and bool(np.isfinite(values).all() and np.ptp(values) > 0)

    def owners(self, kind: str) -> tuple[str, ...]:
        """Return the things of a kind that any pose tells of."""
        return tuple(
            dict.fromkeys(p.owner for n, p in enumerate(self.parameters) if p.kind == kind and self.determinable[n])
        )

    @cached_property
    def determinable(self) -> NDArray:
        """Return which numbers (T,) any pose tells anything of."""
        return np.any(self.root != 0.0, (0, 1))

    def poses_of(self, kind: str, owner: str) -> NDArray:
        """Return which poses (B,) tell of one thing of a kind."""
        own = [n for n, p in enumerate(self.parameters) if p.kind == kind and p.owner == owner]
        return np.any(self.root[:, :, own] != 0.0, (1, 2))

    def places(self, kind: str, owner: str, names: tuple[str, ...]) -> list[int]:
        """Return where the named numbers of a thing stand; raises KeyError where there is none."""
        known = {(p.kind, p.owner, p.name): n for n, p in enumerate(self.parameters)}
        return [known[kind, owner, name] for name in names]
