"""Cause: the zeros of actuators' readings shift from some pose on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.inference.model import Onsets
from truing.simulation.cause import Parameter, ReportedParameter, Step
from truing.simulation.change import Change
from truing.simulation.inputs import ORDER
from truing.simulation.mechanisms.causes.per_leg import PerLeg
from truing.simulation.mechanisms.causes.targets import onset_poses, onsets_of_poses
from truing.simulation.mechanisms.point_causes import PointCause, PointScene
from truing.simulation.mechanisms.state import State

_PLAUSIBLE_M = 1e-4  # the size of other knocks, such as a displaced target's


@dataclass(frozen=True)
class ActuatorZeroShift(PerLeg):
    """The zeros of readings shift from a pose on: one by lost counts or a slipped coupling, or all by a reference run.

    ``from_order`` is the rank in time of the pose ``from_pose``.
    """

    from_pose: int | str = ""
    from_order: float = -np.inf

    id = "actuator-zero-shift"
    step = Step.DRIVE
    reach = 1e4  # a reference run at another mark shifts it by a metre
    is_persistent = False
    reads = frozenset()

    def excludes(self, other: PointCause) -> bool:
        """True for the same onset of the same actuator, which may shift several times."""
        is_at_once = isinstance(other, ActuatorZeroShift) and other.from_order == self.from_order
        return is_at_once and super().excludes(other)

    def candidates(self, scene: PointScene) -> Sequence[ActuatorZeroShift]:
        """Return an onset at every pose, or at every few poses of a long campaign, for every actuator and for all."""
        onsets = [(scene.poses[pose], float(scene.covariates[ORDER][pose])) for pose in onset_poses(scene)]
        chosen = ((), *((leg,) for leg in range(1, scene.legs + 1)))
        return [ActuatorZeroShift(legs, *onset) for legs in chosen for onset in onsets]

    def prior(self, scene: PointScene) -> float:
        """Return the share of this choice: all actuators are as probable as single ones together."""
        return 1.0 / scene.legs if self.legs else 1.0

    def onsets(self, scene: PointScene) -> Onsets[ActuatorZeroShift]:
        """Return every pose with some poses before it and from it on."""
        return onsets_of_poses(
            scene, self.from_order, lambda pose, order: replace(self, from_pose=pose, from_order=order)
        )

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the shift of each actuator concerned: true position minus reading."""
        return tuple(Parameter(name, "mm", _PLAUSIBLE_M, 1e-3) for name in self.numbered("shift", legs))

    def change(self, state: State, values: NDArray) -> Change:
        """Return d rho_i / d shift_i: 1 from the pose on, 0 before it."""
        is_later = (np.asarray(state.covariates[ORDER]) >= self.from_order).astype(float)
        rows = self.spread(np.broadcast_to(is_later[:, None], state.rho.shape))
        return Change({"rho": rows}, rows.shape[-1])

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the shifts, and the first pose with them."""
        return (*super().reported(values, covariance, legs), ReportedParameter("from_pose", self.from_pose, None, ""))
