"""Causes that displace a part of a chain from some pose on: the base, a tool, or the zero of a joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.inference.model import Onsets
from truing.simulation.cause import Parameter, ReportedParameter, Step
from truing.simulation.mechanisms.chains.base_drift import MOTION
from truing.simulation.mechanisms.chains.causes import (
    ChainCause,
    ChainScene,
    JointCause,
    onsets_of_change,
    onsets_of_poses,
)
from truing.simulation.mechanisms.chains.conditions import ChainInputs

# Plausible sizes of a tool's displacement, in that of a knock (0.1 mm): another tool is 10 mm longer, or more.
_SCALES = (1.0, 100.0)


@dataclass(frozen=True)
class ShiftFromPose(ChainCause):
    """Base class of displacements from some pose on."""

    from_pose: int | str = ""
    from_order: float = -np.inf

    is_persistent = False

    def is_later(self, machine: ChainInputs) -> NDArray:
        """Return 1 for the pose and later ones, 0 before it, (B,)."""
        return np.asarray(machine.order >= self.from_order, float)

    def onsets(self, scene: ChainScene) -> Onsets[Self]:
        """Return every pose with some poses before it and from it on."""
        return onsets_of_poses(scene.inputs_of_machine, self.from_order, self._begun_at)

    def _begun_at(self, pose: int | str, order: float) -> Self:
        return replace(self, from_pose=pose, from_order=order)

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the displacement, and the first pose with it."""
        return (
            *super().reported(values, covariance, legs),
            ReportedParameter("from_pose", str(self.from_pose), None, ""),
        )


@dataclass(frozen=True)
class BaseJump(ShiftFromPose):
    """The base is displaced from some pose on."""

    id = "base-jump"
    step = Step.INSTRUMENT

    def candidates(self, scene: ChainScene) -> Sequence[BaseJump]:
        """Return an onset at every pose, or at every few poses of a long campaign."""
        machine = scene.inputs_of_machine
        return [replace(self, from_pose=pose, from_order=order) for pose, order in onsets_of_change(machine)]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the motion, in the frame of the base."""
        return MOTION

    def twists(self, machine: ChainInputs) -> NDArray:
        """Return the motion, from the pose on."""
        return machine.at_node(0, self.is_later(machine)[:, None, None] * np.eye(6))


@dataclass(frozen=True)
class ToolJump(ShiftFromPose):
    """A measured link that carries no other one is displaced from some pose on, with all that is measured on it.

    ``scale``: plausible size, in that of a knock.
    """

    link: str = ""
    scale: float = 1.0

    id = "tool-jump"
    step = Step.STRUCTURE

    @property
    def subject(self) -> str:
        """The link."""
        return f"link {self.link}"

    def candidates(self, scene: ChainScene) -> Sequence[ToolJump]:
        """Return onsets for every outer link with several targets or an orientation; one target alone may have
        moved."""
        machine = scene.inputs_of_machine
        nodes, above = machine.channels.node, machine.tree.above
        onsets, found = onsets_of_change(machine), list[ToolJump]()
        for node in np.unique(nodes[nodes > 0]).tolist():
            is_outer = above[nodes, node].sum() == (nodes == node).sum() and machine.tree.nodes[node].parent >= 0
            if is_outer and (nodes == node).sum() > 1:
                jump = replace(self, link=machine.tree.nodes[node].link)
                sized = [replace(jump, scale=scale) for scale in _SCALES]
                found += [replace(one, from_pose=pose, from_order=order) for one in sized for pose, order in onsets]
        return found

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the motion, in the frame of the link."""
        return tuple(replace(parameter, scale=self.scale * parameter.scale) for parameter in MOTION)

    def twists(self, machine: ChainInputs) -> NDArray:
        """Return the motion, from the pose on."""
        twist = self.is_later(machine)[:, None, None] * np.eye(6)
        return machine.at_node(machine.tree.links[self.link], twist)


@dataclass(frozen=True)
class JointJump(ShiftFromPose, JointCause):
    """The zero of a joint's reading shifts from some pose on: a coupling slips, an encoder loses counts."""

    id = "joint-jump"
    step = Step.DRIVE

    def candidates(self, scene: ChainScene) -> Sequence[JointJump]:
        """Return an onset at every pose, or at every few poses of a long campaign, for every joint that moved."""
        onsets = onsets_of_change(scene.inputs_of_machine)
        return [
            replace(cause, from_pose=pose, from_order=order)
            for cause in JointCause.candidates(self, scene)
            for pose, order in onsets
        ]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the shift."""
        return (self.size_named("shift"),)

    def motion(self, machine: ChainInputs, reading: int) -> NDArray:
        """Return one, from the pose on."""
        return self.is_later(machine)[:, None]
