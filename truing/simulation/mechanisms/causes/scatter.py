"""Causes without a mean effect: scatter of actuators or of still bodies at each approach, and bursts of noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.inference.model import ScatterCandidate
from truing.simulation.cause import Parameter, Step
from truing.simulation.change import Change
from truing.simulation.inputs import APPROACH, ORDER, Missing, ranks
from truing.simulation.mechanisms.point_causes import PointCause, PointScene
from truing.simulation.mechanisms.state import State

# Lengths of groups, as shares of the campaign: shortest, longest, and ratio of successive lengths; groups of one length
# are shifted by an eighth of it.
_SHORTEST, _LONGEST, _GROWTH = 1 / 12, 1 / 2, 13 / 12
_FEWEST_IN_GROUP, _FEWEST_POSES = 3, 12
_PLAUSIBLE_M = 1e-5
_POSE = 6


@dataclass(frozen=True)
class PoseGroup:
    """A group of consecutive poses in time: mask (B,), and the names of the first and the last pose."""

    own: NDArray[np.bool_]
    from_pose: int | str
    to_pose: int | str


def groups_in_time(scene: PointScene) -> Iterator[PoseGroup]:
    """Yield groups of consecutive poses of several lengths; none with few poses or without an order."""
    count = len(scene.poses)
    if count < _FEWEST_POSES or ORDER not in scene.covariates:
        return
    rank = ranks(np.asarray(scene.covariates[ORDER]))
    in_time = np.argsort(rank)
    length, lengths = max(round(_SHORTEST * count), _FEWEST_IN_GROUP), []
    while length <= _LONGEST * count:
        lengths.append(length)
        length = max(length + 1, round(length * _GROWTH))
    for length in lengths:
        for first in sorted({*range(0, count - length, max(length // 8, 1)), count - length}):
            in_group = (rank >= first) & (rank < first + length)
            yield PoseGroup(in_group, scene.poses[in_time[first]], scene.poses[in_time[first + length - 1]])


@dataclass(frozen=True)
class ApproachScatter(PointCause):
    """Actuators stop at random positions about their readings; a ``body`` that should stand still takes random poses.

    It concerns ``legs``, or all; approaches from below (``direction`` 1), from above (-1), or both (0); and poses from
    ``from_pose`` to ``to_pose`` in time, or all.
    """

    legs: tuple[int, ...] = ()
    body: str = ""
    direction: int = 0
    from_pose: int | str = ""
    to_pose: int | str = ""

    id = "approach-scatter"
    step = Step.DRIVE
    is_persistent = False
    reads = frozenset()

    @property
    def subject(self) -> str:
        """Legs of the actuators, or the body."""
        return self.body or " ".join(f"leg{leg}" for leg in self.legs)

    @property
    def concerns_several(self) -> bool:
        """True for several single actuators."""
        return not self.body and len(self.legs) > 1

    def missing_input(self, scene: PointScene) -> Missing | None:
        """Return the missing input: poses or, without a mechanism, a body that stands still."""
        return Missing.POSES if scene.legs or scene.still else Missing.STILL

    def candidates(self, scene: PointScene) -> Sequence[ApproachScatter]:
        """Return none: scatter has no mean effect."""
        return ()

    def scatters(self, scene: PointScene) -> Sequence[ScatterCandidate[ApproachScatter]]:
        """Return groups of poses, single actuators, and each direction of approach, of one actuator or all."""
        return list(_leg_candidates(scene) if scene.legs else _body_candidates(scene))

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the scatter, one sigma along each actuator, in addition to the noise of the readings."""
        return (Parameter("scatter", "mm", _PLAUSIBLE_M, 1e-3),)

    def change(self, state: State, values: NDArray) -> Change:
        """Return no derivative: there is no mean effect."""
        return Change({}, 1)


def _leg_candidates(scene: PointScene) -> Iterator[ScatterCandidate[ApproachScatter]]:
    poses, legs = scene.readings.shape
    every = np.ones((poses, legs), bool)
    for group in groups_in_time(scene):
        cause = ApproachScatter(from_pose=group.from_pose, to_pose=group.to_pose)
        yield ScatterCandidate(cause, group.own[:, None] & every, True)
    alone = [every & (np.arange(legs) == leg) for leg in range(legs)] if legs > 1 else []
    for leg, rows_of_leg in enumerate(alone, 1):
        yield ScatterCandidate(ApproachScatter((leg,)), rows_of_leg, True)
    came = scene.covariates.get(APPROACH)
    for direction in (1, -1) if came is not None and np.ptp(came) > 0 else ():
        from_there = np.asarray(came) == direction
        yield ScatterCandidate(ApproachScatter(direction=direction), from_there & every, True)
        for leg, rows_of_leg in enumerate(alone, 1):
            if 0 < from_there[:, leg - 1].sum() < poses:
                yield ScatterCandidate(ApproachScatter((leg,), direction=direction), from_there & rows_of_leg, True)


def _body_candidates(scene: PointScene) -> Iterator[ScatterCandidate[ApproachScatter]]:
    """Yield groups of poses for each still body; its pose has six inputs, three of which are its shift."""
    every = np.repeat(np.eye(len(scene.still), dtype=bool), _POSE, 1)
    shifts = np.arange(every.shape[1]) % _POSE < _POSE // 2
    for body, inputs in zip(scene.still, every, strict=True):
        for group in groups_in_time(scene):
            cause = ApproachScatter(body=body, from_pose=group.from_pose, to_pose=group.to_pose)
            yield ScatterCandidate(cause, group.own[:, None] & inputs, True)
            yield ScatterCandidate(cause, group.own[:, None] & inputs & shifts, True)


@dataclass(frozen=True)
class NoiseBurst(PointCause):
    """All points scatter more from ``from_pose`` to ``to_pose`` in time, for example by vibration."""

    from_pose: int | str = ""
    to_pose: int | str = ""

    id = "noise-burst"
    lacking = Missing.POSES
    step = Step.INSTRUMENT
    is_persistent = False
    reads = frozenset()

    def candidates(self, scene: PointScene) -> Sequence[NoiseBurst]:
        """Return none: noise has no mean effect."""
        return ()

    def scatters(self, scene: PointScene) -> Sequence[ScatterCandidate[NoiseBurst]]:
        """Return groups of consecutive poses."""
        every = np.ones((1, len(scene.shape)), bool)
        return [
            ScatterCandidate(NoiseBurst(group.from_pose, group.to_pose), group.own[:, None] & every, False)
            for group in groups_in_time(scene)
        ]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the ratio of the noise to that of the other poses."""
        return (Parameter("noise_ratio", "1", 1.0),)

    def change(self, state: State, values: NDArray) -> Change:
        """Return no derivative: there is no mean effect."""
        return Change({}, 1)
