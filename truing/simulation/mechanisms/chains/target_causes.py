"""Causes that act on single observations of a chain: displaced targets and offsets of distances."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.inference.model import ChannelCandidates, Onsets
from truing.simulation.cause import Parameter, ReportedParameter, Step
from truing.simulation.mechanisms.chains.causes import (
    FEWEST,
    MOST_ONSETS,
    ChainCause,
    ChainScene,
    onsets_of_change,
    onsets_of_poses,
)
from truing.simulation.mechanisms.chains.conditions import ChainInputs

_MM = 1e-3  # metres of a millimetre
_OFF_M = 1e-4  # plausible offset of an instrument of distances, m
_ONSETS_OF_TARGETS = 600  # most onsets of single targets, which are scored together
_FEW_ONSETS = 2  # of the onsets, every so many for targets seen by distances


@dataclass(frozen=True)
class DistanceOffset(ChainCause):
    """Distances are read too long by a constant: all of them, or those of one ``end``; from some pose on, or always.

    A zero that is wrong in all poses differs from other places of the stations: distances differ by as much near and
    far.
    """

    end: str = ""
    from_pose: int | str = ""
    from_order: float = -np.inf

    id = "distance-offset"
    step = Step.INSTRUMENT
    is_persistent = False

    @property
    def subject(self) -> str:
        """The end of the distances; empty for all."""
        return f"distance {self.end}" if self.end else ""

    def candidates(self, scene: ChainScene) -> Sequence[DistanceOffset]:
        """Return an onset at every pose, or at every few poses, and none, for all distances and for those of each
        station."""
        onsets = [("", -np.inf), *onsets_of_change(scene.inputs_of_machine)] if scene.distances else []
        counts = Counter(end for pair in scene.distances for end in set(pair))
        ends = [end for end, number in counts.items() if number < len(scene.distances)]
        return [
            replace(self, end=end, from_pose=pose, from_order=order) for end in ("", *ends) for pose, order in onsets
        ]

    def onsets(self, scene: ChainScene) -> Onsets[DistanceOffset] | None:
        """Return every pose with some poses before it and from it on; None of an offset of all poses."""
        if self.from_pose == "":
            return None

        def begun_at(pose: int | str, order: float) -> DistanceOffset:
            return replace(self, from_pose=pose, from_order=order)

        return onsets_of_poses(scene.inputs_of_machine, self.from_order, begun_at)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the shift of the readings."""
        return (Parameter("shift", "mm", _OFF_M, _MM),)

    def excess(self, machine: ChainInputs, distances: Sequence[tuple[str, str]]) -> NDArray:
        """Return one for the distances concerned, from the pose on."""
        is_affected = np.array([not self.end or self.end in pair for pair in distances], float)
        return ((machine.order >= self.from_order)[:, None] * is_affected)[..., None]

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the shift, and the first pose with it, if it is not in all poses."""
        since = () if self.from_pose == "" else (ReportedParameter("from_pose", str(self.from_pose), None, ""),)
        return (*super().reported(values, covariance, legs), *since)


@dataclass(frozen=True)
class ChainTargetMoved(ChainCause):
    """One target is displaced on its link from some pose on."""

    body: str = ""
    target: str = ""
    from_pose: int | str = ""
    from_order: float = -np.inf

    id = "target-moved"
    step = Step.STRUCTURE
    reach = 1e5
    is_persistent = False

    @property
    def subject(self) -> str:
        """The target."""
        return f"target {self.target}"

    def candidates(self, scene: ChainScene) -> Sequence[ChainTargetMoved]:
        """Return, where distances are observed, every target from some poses on; else `channel_candidates` has them."""
        if scene.places is None:
            return ()
        machine = scene.inputs_of_machine
        onsets, named = onsets_of_change(machine)[::_FEW_ONSETS], machine.channels
        on_links = [node == 0 or machine.tree.nodes[node].parent >= 0 for node in named.node]  # none on the ground
        moving = np.flatnonzero(on_links & ~named.is_rotation)
        return [
            replace(self, body=named.links[k], target=named.names[k], from_pose=pose, from_order=order)
            for k in moving
            for pose, order in onsets
        ]

    def channel_candidates(self, scene: ChainScene) -> Sequence[ChannelCandidates[ChainTargetMoved]]:
        """Return every target displaced from each possible pose on, if it is seen often enough before and after."""
        machine = scene.inputs_of_machine
        targets, onsets = np.flatnonzero(~machine.channels.is_rotation), onsets_of_change(machine, _ONSETS_OF_TARGETS)
        if not onsets or not len(targets) or scene.places is not None:
            return ()
        late = np.stack([machine.order >= order for _, order in onsets])
        seen = (
            np.ones((len(machine.order), len(targets)), int)
            if scene.is_observed is None
            else scene.is_observed[:, targets].astype(int)
        )
        after = late.astype(int) @ seen
        usable = (after >= FEWEST) & (seen.sum(0) - after >= FEWEST)

        def member(target: int, onset: int) -> ChainTargetMoved:
            k = int(targets[target])
            names = {"body": machine.channels.links[k], "target": machine.channels.names[k]}
            return replace(self, **names, from_pose=onsets[onset][0], from_order=onsets[onset][1])  # type: ignore[arg-type]

        return [ChannelCandidates(late[..., None].astype(float), targets, usable, 1e-4, member)]

    def onsets(self, scene: ChainScene) -> Onsets[ChainTargetMoved]:
        """Return every pose with some poses before it and from it on."""

        def begun_at(pose: int | str, order: float) -> ChainTargetMoved:
            return replace(self, from_pose=pose, from_order=order)

        most = _ONSETS_OF_TARGETS if scene.places is None else MOST_ONSETS // _FEW_ONSETS
        return onsets_of_poses(scene.inputs_of_machine, self.from_order, begun_at, most)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the shift in the link's frame."""
        return tuple(Parameter(f"d{axis}", "mm", 1e-4, _MM) for axis in "xyz")

    def shifts(self, machine: ChainInputs) -> NDArray:
        """Return the shift of the target, from the pose on; zero if it was not measured."""
        result = np.zeros((len(machine.readings), len(machine.channels.names), 3, 3))
        for k, name in enumerate(zip(machine.channels.links, machine.channels.names, strict=True)):
            if name == (self.body, self.target) and not machine.channels.is_rotation[k]:
                result[machine.order >= self.from_order, k] = np.eye(3)
        return result

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the shift, and the first displaced pose."""
        return (
            *super().reported(values, covariance, legs),
            ReportedParameter("from_pose", str(self.from_pose), None, ""),
        )
