"""The state of a mechanism: what the steps of the simulated chain pass on to each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.targets import Targets

# The fields that an effect may depend on leg by leg.
LEG_FIELDS = frozenset({"indicated", "rho", "a", "b", "u", "l", "delta_bz"})
_OF_STATE = ("indicated", "rho", "delta_bz", "moved", "points")


@dataclass(frozen=True)
class State:
    """What the chain passes on, B poses of L legs and K targets; m and rad.

    ``indicated`` is where the actuators seem to stand (what effects of the drive depend on), ``rho`` where they do,
    ``delta_bz`` the attachments' shift along z of the platform; ``legs`` may differ from pose to pose. ``shape`` is
    where targets sit, along the axes of their body's survey, from the body's origin (a leg's: its lower joint), and
    ``moved`` by how much they sit elsewhere, pose by pose. Once the structure has answered: the pose p, R of the
    platform in the base frame, ``points`` (the targets in the base frame, as recorded so far) and ``turn``, the
    rotations from the axes of the bodies' surveys to the base. ``nominal_direction`` are the legs' directions
    at the nominal reference; at that of the machine as it is, they are ``reference_direction``, and the platform's
    rotation is ``reference_rotation``.
    """

    legs: Legs
    rho: NDArray  # (B, L)
    delta_bz: NDArray  # (B, L)
    p: NDArray = field(default_factory=lambda: np.empty((0, 3)))  # (B, 3)
    R: NDArray = field(default_factory=lambda: np.empty((0, 3, 3)))  # (B, 3, 3)
    converged: NDArray = field(default_factory=lambda: np.empty(0, bool))  # (B,)
    indicated: NDArray = field(default_factory=lambda: np.empty((0, 0)))  # (B, L)
    covariates: Mapping[str, NDArray] = field(default_factory=dict)  # (B,) or (B, L), in the units of their columns
    targets: Targets | None = None
    shape: NDArray = field(default_factory=lambda: np.empty((0, 3)))  # (K, 3)
    moved: NDArray = field(default_factory=lambda: np.empty((0, 0, 3)))  # (B, K, 3), or broadcasts to it
    points: NDArray = field(default_factory=lambda: np.empty((0, 0, 3)))  # (B, K, 3)
    turn: NDArray = field(default_factory=lambda: np.empty((0, 0, 3, 3)))  # (B, K, 3, 3)
    reference_temperature_c: float = 20.0
    nominal_direction: NDArray = field(default_factory=lambda: np.empty((0, 3)))  # (L, 3)
    reference_direction: NDArray = field(default_factory=lambda: np.empty((0, 3)))  # (L, 3)
    reference_rotation: NDArray = field(default_factory=lambda: np.eye(3))  # (3, 3)

    @property
    def heat(self) -> NDArray:
        """Return the temperature (B,) above the reference, K."""
        return self.covariates["temperature_c"] - self.reference_temperature_c

    @property
    def delta_rho(self) -> NDArray:
        """Return the displacement (B, L) from the reference reading, m."""
        return self.rho - self.legs.rho0

    def shifted(self, shifts: Mapping[str, NDArray]) -> State:
        """Return the state with each named field moved by the array given for it."""
        own = {name: getattr(self, name) + shift for name, shift in shifts.items() if name in _OF_STATE}
        joints = {name: getattr(self.legs, name) + shift for name, shift in shifts.items() if name not in own}
        return replace(self, **own, legs=self.legs.replace(**joints) if joints else self.legs)
