"""Cause: all targets of a platform or a base are displaced together against its joints from some pose on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.inference.model import Onsets
from truing.simulation.bodies.causes.deformation import BodyCause, bodies_of
from truing.simulation.cause import Parameter, ReportedParameter
from truing.simulation.change import Change
from truing.simulation.inputs import ORDER
from truing.simulation.mechanisms.causes.targets import onset_poses, onsets_of_poses
from truing.simulation.mechanisms.point_causes import PointScene
from truing.simulation.mechanisms.state import State
from truing.simulation.targets import LEG


@dataclass(frozen=True)
class BodyJump(BodyCause):
    """The part of a platform or base that carries its targets is displaced against the joints from a pose on.

    ``from_order`` is the rank in time of the pose ``from_pose``. Bodies without a mechanism have `BodyDrift` instead.
    """

    whole: bool = True
    from_pose: int | str = ""
    from_order: float = -np.inf

    id = "body-jump"
    reach = 1e4  # a plate that is mounted again elsewhere moves by centimetres
    is_persistent = False

    @property
    def key(self) -> str:
        """Unique name of the candidate."""
        return f"{self.id} {self.body} at {self.from_order:.6g}"

    def candidates(self, scene: PointScene) -> Sequence[BodyJump]:
        """Return an onset at every pose, or at every few poses of a long campaign, for platform and base."""
        onsets = onset_poses(scene)
        if not scene.legs or not onsets:
            return ()
        on_legs = {name for name, kind in zip(scene.targets.bodies, scene.targets.body, strict=True) if kind == LEG}
        return [
            BodyJump(*body, from_pose=scene.poses[pose], from_order=float(scene.covariates[ORDER][pose]))
            for body in bodies_of(scene)
            if body[0] not in on_legs
            for pose in onsets
        ]

    def onsets(self, scene: PointScene) -> Onsets[BodyJump]:
        """Return every pose with some poses before it and from it on."""
        return onsets_of_poses(
            scene, self.from_order, lambda pose, order: replace(self, from_pose=pose, from_order=order)
        )

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the shift of the targets' centroid, and their rotation about it, in the frame of the body's survey."""
        return self._pattern_parameters()

    def change(self, state: State, values: NDArray) -> Change:
        """Return d moved / d motion, from the pose on."""
        is_later = np.asarray(state.covariates[ORDER]) >= self.from_order
        return Change({"moved": self._derivative_of_moved(state, is_later[:, None].astype(float))}, 6)

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the motion, and the first pose with it."""
        return (*super().reported(values, covariance, legs), ReportedParameter("from_pose", self.from_pose, None, ""))
