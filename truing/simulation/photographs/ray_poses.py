"""Information of rays, pose by pose (`RayPoses`), on parameters that all poses should share (`RayParameter`)."""

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
    """A parameter common to all poses: kind of its owner, owner, name and unit.

    ``scale`` is its typical size. ``sigma`` is the prior sigma of its value in the adjustment, apart from the rays (a
    bar's calibration); None: unknown; 0: exact, so that only causes change it. ``mean``: prior value minus the value in
    the adjustment.
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
        """Unique name: ``camera A c``, ``bar 1 strain``."""
        return " ".join(filter(None, (self.kind, self.owner, self.name)))


@dataclass(frozen=True)
class RayPoses:
    """B poses and the T parameters that their rays determine, pose by pose.

    ``root`` (B, K, T) is the derivative of a pose's K whitened channels by the parameters, in units of their scale;
    ``is_observed`` (B, K) the mask of channels with information. Covariates (B,) are the columns known at each pose,
    with ``order``.
    """

    poses: tuple[int | str, ...]
    parameters: tuple[RayParameter, ...]
    channels: tuple[str, ...]
    root: NDArray
    is_observed: NDArray
    covariates: Mapping[str, NDArray]
    span_s: tuple[float, float] | None = None
    reference_temperature_c: float = 20.0
    up: NDArray | None = None  # (B, 3) the vertical in the axes of each pose's measurement, if known

    @property
    def readings(self) -> NDArray:
        """Inputs in the place of actuator readings: none (B, 0)."""
        return np.zeros((len(self.poses), 0))

    @cached_property
    def temperature_rise(self) -> NDArray:
        """Temperature above the reference (B,), K."""
        return np.asarray(self.covariates[TEMPERATURE], float) - self.reference_temperature_c

    @cached_property
    def rank(self) -> NDArray:
        """Rank in time (B,) of each pose among these."""
        order = self.covariates.get(ORDER, np.arange(len(self.poses)))
        return ranks(order)

    def varies(self, column: str) -> bool:
        """True if a column is known at all poses and takes more than one value."""
        values = self.covariates.get(column)
        return values is not None and bool(np.isfinite(values).all() and np.ptp(values) > 0)

    def owners(self, kind: str) -> tuple[str, ...]:
        """Return the owners of a kind on which any pose has information."""
        return tuple(
            dict.fromkeys(p.owner for n, p in enumerate(self.parameters) if p.kind == kind and self.determinable[n])
        )

    @cached_property
    def determinable(self) -> NDArray:
        """Mask (T,) of the parameters on which any pose has information."""
        return np.any(self.root != 0.0, (0, 1))

    def poses_of(self, kind: str, owner: str) -> NDArray:
        """Return the mask (B,) of poses with information on one owner of a kind."""
        numbers = [n for n, p in enumerate(self.parameters) if p.kind == kind and p.owner == owner]
        return np.any(self.root[:, :, numbers] != 0.0, (1, 2))

    def places(self, kind: str, owner: str, names: tuple[str, ...]) -> list[int]:
        """Return the indices of named parameters of an owner; raises KeyError if one is missing."""
        known = {(p.kind, p.owner, p.name): n for n, p in enumerate(self.parameters)}
        return [known[kind, owner, name] for name in names]
