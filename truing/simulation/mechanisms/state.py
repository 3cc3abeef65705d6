"""Class `State`: quantities of a mechanism that the steps of the simulated chain pass on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.targets import Targets

# Fields of each leg that an effect may depend on.
LEG_FIELDS = frozenset({"indicated", "rho", "a", "b", "u", "l", "delta_bz"})
_OF_STATE = ("indicated", "rho", "delta_bz", "moved", "points")


@dataclass(frozen=True)
class State:
    """State of B poses of L legs and K targets; m and rad.

    ``indicated`` is the indicated position of the actuators, on which effects of the drive depend, ``rho`` the true
    one. ``delta_bz`` is the attachments' shift along z of the platform; ``legs`` may differ from pose to pose.
    ``shape`` is the position of targets relative to the body's origin (of a leg: its lower joint), along the axes of
    the body's survey, and ``moved`` their displacement at each pose.

    The structure adds the pose p, R of the platform in the base frame. ``points`` are the targets in the base frame, as
    recorded so far; ``turn`` are the rotations from the axes of the bodies' surveys to the base.

    ``nominal_direction`` holds the legs' directions in the nominal reference pose. ``reference_direction`` and
    ``reference_rotation`` are the legs' directions and the platform's rotation in the reference pose of these legs.
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
    def temperature_rise(self) -> NDArray:
        """Temperature (B,) above the reference, K."""
        return self.covariates["temperature_c"] - self.reference_temperature_c

    @property
    def heat(self) -> NDArray:
        """The same under its former name, for causes of labs."""
        return self.temperature_rise

    @property
    def delta_rho(self) -> NDArray:
        """Displacement (B, L) from the reference reading, m."""
        return self.rho - self.legs.rho0

    def shifted(self, shifts: Mapping[str, NDArray]) -> State:
        """Return the state with the given shifts added to the named fields."""
        shifted_arrays = {name: getattr(self, name) + shift for name, shift in shifts.items() if name in _OF_STATE}
        joints = {
            name: getattr(self.legs, name) + shift for name, shift in shifts.items() if name not in shifted_arrays
        }
        return replace(self, **shifted_arrays, legs=self.legs.replace(**joints) if joints else self.legs)
