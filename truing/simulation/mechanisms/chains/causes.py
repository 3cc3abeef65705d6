"""Causes that act on the joints of a chain; base class `ChainCause` and scene `ChainScene` of all its causes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Index
from truing.inference.model import CauseT, Onsets, ScatterCandidate, onsets_in_time
from truing.simulation.cause import Cause, Parameter, ReportedParameter, Scene, Step
from truing.simulation.inputs import LAST_STEP, PATH, Missing
from truing.simulation.mechanisms.chains.closed_tree import ClosedTree
from truing.simulation.mechanisms.chains.conditions import ChainInputs
from truing.simulation.mechanisms.chains.mass_centres import moments_off_centre, off_centre
from truing.simulation.mechanisms.chains.transmitted_motions import nodes_moved_alike
from truing.simulation.mechanisms.chains.tree import Node, axis_twist

_ANGLE, _LENGTH = 5e-4, 3e-4  # plausible errors of a joint, rad and m
_GAIN = 5e-4
# Deflection that a plausible compliance gives under the largest load, rad or m.
_MM = 1e-3
# A load that varies by a smaller share of the largest load on the chain is constant, apart from rounding.
# Parts of a length that are smaller by this factor are rounding of the description.
ROUNDED = 1e-4
# Least number of poses before an onset, and from it; in a long campaign not every pose is tried as an onset.
FEWEST, MOST_ONSETS = 4, 120
DECLARED_WEIGHTS = "declared weights"
"""Masses and payload of a campaign's description, on which the size of deflections rests."""
_FEWEST_POSES = 12  # of a group that may scatter


@dataclass(frozen=True)
class ChainScene(Scene["ChainCause"]):
    """Scene of causes that act on a chain: its joints, links, inputs and targets.

    ``places`` (K, 0): instead of the targets' places, of observations that have none. ``distances``: names of both ends
    of each measured distance.
    """

    inputs_of_machine: ChainInputs
    places: NDArray | None = None
    distances: tuple[tuple[str, str], ...] = ()

    @property
    def covariates(self) -> Mapping[str, NDArray]:
        """Columns (B,) or (B, n) that effects may depend on, without readings of joints that stood still."""
        machine = self.inputs_of_machine
        still = {column for column, moved in zip(machine.conditions.columns, machine.moved, strict=True) if not moved}
        return {name: values for name, values in machine.conditions.covariates.items() if name not in still}

    @property
    def inputs(self) -> Mapping[str, NDArray]:
        """Readings (B,) of the joints that moved, by name."""
        machine = self.inputs_of_machine
        return {machine.tree.readings[k]: machine.readings[:, k] for k in np.flatnonzero(machine.moved)}

    @property
    def histories(self) -> Mapping[str, NDArray]:
        """States of stop operators and the reading before the last movement (B, 9), of each joint that moved, by
        name."""
        machine, known = self.inputs_of_machine, self.covariates
        if PATH not in known or LAST_STEP not in known:
            return {}
        past = np.concatenate([known[PATH], (machine.readings - known[LAST_STEP])[..., None]], axis=-1)
        return {machine.tree.readings[k]: past[:, k] for k in np.flatnonzero(machine.moved)}

    @property
    def shape(self) -> NDArray:
        """Positions (K, 3) of the targets in their links, m; (K, 0) for other observations."""
        return self.inputs_of_machine.shape if self.places is None else self.places


@dataclass(frozen=True)
class ChainCause(Cause[ChainScene]):
    """Base class of causes that move nodes of a chain by twists that are linear in the parameters."""

    reach = 100.0
    # Whether a prediction holds the effect at its value at the ends of the measured readings.
    is_held_beyond: ClassVar[bool] = False

    def corrected(self, readings: NDArray, names: Sequence[str]) -> NDArray:
        """Return readings (B, n) of the joints ``names`` as all other causes take them: unchanged."""
        return readings

    def twists(self, machine: ChainInputs) -> NDArray | None:
        """Return the twists (B, N, 6, P) of all nodes per unit of the parameters, SI; None if none moves."""
        return None

    def deviations(self, machine: ChainInputs) -> NDArray | None:
        """Return the deviations (B, n, P) of the joints' motion per unit of the parameters, rad or m; None if none
        deviates."""
        return None

    def joint_deviations(self, machine: ChainInputs) -> tuple[Index, NDArray] | None:
        """Return the joints (k,) that deviate and their deviations (B, k, P), as `deviations`; None if none does."""
        deviations = self.deviations(machine)
        return None if deviations is None else (np.arange(deviations.shape[1]), deviations)

    def deviation_slopes(self, machine: ChainInputs, values: NDArray) -> NDArray | None:
        """Return the derivatives (B, n, P) of the deviations at values (P,), SI; the deviations of a linear cause."""
        return self.deviations(machine)

    def joint_motion(self, machine: ChainInputs, values: NDArray, by_joint: NDArray) -> NDArray | None:
        """Return the derivatives (B, 3 K, P) of channels by the parameters at values (P,), SI, from those (B, K, 3, n)
        by joint motion; None if no joint deviates."""
        slopes = self.deviation_slopes(machine, values)
        return None if slopes is None else by_joint.reshape(len(by_joint), -1, by_joint.shape[-1]) @ slopes

    def deviation(self, machine: ChainInputs, values: NDArray) -> NDArray | None:
        """Return the deviations (B, n) of the joints' motion at values (P,), SI; None if none deviates."""
        deviations = self.deviations(machine)
        return None if deviations is None else deviations @ values

    def shifts(self, machine: ChainInputs) -> NDArray | None:
        """Return the shifts (B, K, 3, P) of targets in their links per unit of the parameters, m; None if none
        moves."""
        return None

    def excess(self, machine: ChainInputs, distances: Sequence[tuple[str, str]]) -> NDArray | None:
        """Return the excess (B, D, P) of read distances between named ends, in m per unit of the parameters; None
        without excess."""
        return None


@dataclass(frozen=True)
class AssumedCentres(ChainCause):
    """Base class of causes by weight that take unknown centres of mass at the origins of their links, if there are
    any."""

    centres_assumed: bool = field(default=False, kw_only=True)

    @property
    def is_assumed(self) -> bool:
        """True if the load has a centre of mass that is unknown."""
        return self.centres_assumed


@dataclass(frozen=True)
class JointCause(ChainCause):
    """Base class of causes that change the motion of one joint, named as in the description of the robot."""

    joint: str = ""
    is_angle: bool = True

    step = Step.DRIVE

    @property
    def subject(self) -> str:
        """The joint."""
        return f"joint {self.joint}"

    def candidates(self, scene: ChainScene) -> Sequence[Self]:
        """Return every joint that moved and to which the cause applies."""
        machine = scene.inputs_of_machine
        found = [
            replace(self, joint=name, is_angle=bool(machine.tree.is_revolute[k]))
            for k, name in enumerate(machine.tree.readings)
            if machine.moved[k]
        ]
        return [cause for cause in found if cause.applies(machine)]

    def applies(self, machine: ChainInputs) -> bool:
        """True if the joint can have the effect in this campaign."""
        return True

    def motion(self, machine: ChainInputs, reading: int) -> NDArray:
        """Return the deviation (B, P) of the joint's motion per unit of the parameters."""
        raise NotImplementedError

    def deviations(self, machine: ChainInputs) -> NDArray:
        """Return the deviation of the joint, zero of all others."""
        reading = machine.tree.readings.index(self.joint)
        return machine.of_joint(reading, self.motion(machine, reading))

    def joint_deviations(self, machine: ChainInputs) -> tuple[Index, NDArray] | None:
        """Return the joint and its deviation (B, 1, P)."""
        reading = machine.tree.readings.index(self.joint)
        return np.array([reading]), self.motion(machine, reading)[:, None]

    def size_named(self, name: str) -> Parameter:
        """Return an angle or a length of plausible size as a parameter."""
        return Parameter(name, "rad", _ANGLE) if self.is_angle else Parameter(name, "mm", _LENGTH, _MM)


@dataclass(frozen=True)
class JointOffset(JointCause):
    """The zero of a joint's reading deviates by more than its tolerance.

    ``start``: a known part of the offset, rad or m, so large that all else must know of it.
    """

    start: float = 0.0

    id = "joint-offset"

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the offset, without its known part."""
        return (self.size_named("offset"),)

    def motion(self, machine: ChainInputs, reading: int) -> NDArray:
        """Return one."""
        return np.ones((len(machine.readings), 1))

    def shared_with(self, scene: ChainScene) -> Mapping[str, Any]:
        """Return the joints whose zeros are the same: about one axis, or slides along parallel ones without a turn
        between that changes their direction."""
        tree = scene.inputs_of_machine.tree
        moved_node = tree.node_of(tree.readings.index(self.joint))
        if sum(node.reading == self.joint for node in tree.nodes) > 1:  # others follow it
            return {}
        alike = moved_alike(scene.inputs_of_machine, moved_node, axis_twist(tree.nodes[moved_node]))
        followed = [node.reading for node in tree.nodes if node.reading != node.joint]
        same = [tree.nodes[k].joint for k, twist in alike if _is_motion_of(tree.nodes[k], twist)]
        partners = [name for name in same if name != self.joint and name in tree.readings and name not in followed]
        return {"alike": [f"joint {name}" for name in partners]} if partners else {}

    def corrected(self, readings: NDArray, names: Sequence[str]) -> NDArray:
        """Return readings (B, n) with the known part of the offset."""
        result = readings.copy()
        result[:, names.index(self.joint)] += self.start
        return result

    def with_known_part(self, values: NDArray) -> NDArray:
        """Return the whole offset (1,), rad or m."""
        return self.start + values

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the whole offset."""
        return super().reported(self.with_known_part(values), covariance, legs)


@dataclass(frozen=True)
class JointGain(JointCause):
    """A joint moves by (1 + gain) times its reading."""

    id = "joint-gain"
    is_held_beyond = True

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the gain."""
        return (Parameter("gain", "1", _GAIN),)

    def motion(self, machine: ChainInputs, reading: int) -> NDArray:
        """Return the readings."""
        return machine.readings[:, reading, None]


@dataclass(frozen=True)
class JointBacklash(JointCause):
    """A joint stops at its reading minus backlash x direction of approach; the full gap is twice the backlash.

    ``first``: direction at the poses before any movement. Nothing is known of it, so both are candidates.
    """

    first: int = 1

    id = "joint-backlash"
    lacking = Missing.APPROACH

    @property
    def family(self) -> str:
        """One family for both directions."""
        return f"{self.id} {self.joint}"

    def candidates(self, scene: ChainScene) -> Sequence[Self]:
        """Return every joint that was approached from both sides, with both directions of its first poses."""
        found, step = super().candidates(scene), scene.covariates.get(LAST_STEP)
        readings = scene.inputs_of_machine.tree.readings
        return [
            replace(cause, first=sense)
            for cause in found
            for sense in (1, -1)
            if sense == self.first or (step is not None and not step[:, readings.index(cause.joint)].all())
        ]

    def applies(self, machine: ChainInputs) -> bool:
        """True if the joint was approached from both sides."""
        came = machine.approach
        return came is not None and bool(np.ptp(came[:, machine.tree.readings.index(self.joint)]) > 0.0)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return half of the gap, negative where a controller compensates too much."""
        return (self.size_named("backlash"),)

    def motion(self, machine: ChainInputs, reading: int) -> NDArray:
        """Return minus the direction of approach."""
        assert machine.approach is not None
        came, step = machine.approach[:, reading], machine.conditions.covariates.get(LAST_STEP)
        return -(came if step is None else np.where(step[:, reading] == 0.0, self.first, came))[:, None]

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return no column: the direction follows from the order of the readings."""
        return ()


@dataclass(frozen=True)
class JointCompliance(JointCause):
    """A joint deflects under the torque of weight about its axis.

    ``parts``: directions in links whose centres of mass are unknown, and ``distances`` (m) by which a centre may be
    off. If ``free``, each distance is a parameter next to the compliance.
    """

    load: float = 1.0  # largest torque, N m, or force, N
    parts: tuple[str, ...] = ()
    distances: tuple[float, ...] = ()
    free: bool = False

    id = "joint-compliance"
    assumes = DECLARED_WEIGHTS
    lacking = Missing.WEIGHT

    @property
    def family(self) -> str:
        """Compliance of one joint, whether centres of mass are free or not."""
        return f"{self.id} {self.joint}"

    def candidates(self, scene: ChainScene) -> Sequence[Self]:
        """Return every joint whose load by weight varies."""
        machine = scene.inputs_of_machine
        result: list[Self] = []
        for cause in super().candidates(scene):
            reading = machine.tree.readings.index(cause.joint)
            if machine.load_varies(reading):
                load = float(np.abs(machine.torque(reading)).max())
                away = off_centre(machine, reading, load)
                result.append(replace(cause, load=load, parts=tuple(away), distances=tuple(away.values())))
        return result

    def one_sided(self, legs: int) -> tuple[int, ...]:
        """Return the compliance: it cannot be negative."""
        return (0,)

    def refined(self) -> Self:
        """Return the form in which unknown centres of mass are fitted."""
        return replace(self, free=True) if self.parts else self

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the compliance; then the distances, if they are free."""
        if not self.is_angle:
            return (Parameter("compliance", "mm/N", _LENGTH / self.load, _MM),)
        compliance = Parameter("compliance", "rad/(N m)", _ANGLE / self.load)
        parts = zip(self.parts, self.distances, strict=True) if self.free else ()
        # A plausible distance is a limit too: centres far away would take the place of the compliance.
        return (compliance, *(Parameter(f"centre {part}", "mm", away / self.reach, _MM) for part, away in parts))

    def motion(self, machine: ChainInputs, reading: int) -> NDArray:
        """Return the torque about the axis, or the force along it, with all centres where they are assumed; zero by
        distances, which act only on a compliant joint."""
        torque = machine.torque(reading)
        return np.column_stack([torque, np.zeros((len(torque), len(self.parts) * self.free))])

    def deviation_slopes(self, machine: ChainInputs, values: NDArray) -> NDArray:
        """Return the derivatives of the deviations by the compliance and the distances."""
        reading = machine.tree.readings.index(self.joint)
        moments = moments_off_centre(machine, reading, self.parts if self.free else ())
        torque = machine.torque(reading) + moments @ values[1:]
        return machine.of_joint(reading, np.column_stack([torque, values[0] * moments]))

    def deviation(self, machine: ChainInputs, values: NDArray) -> NDArray:
        """Return the deviations at a compliance and, if they are free, distances."""
        return np.asarray(values[0] * self.deviation_slopes(machine, values)[..., 0])


@dataclass(frozen=True)
class JointScatter(ChainCause):
    """Joints stop at random positions about their readings: one joint or all, from one side, or in one series."""

    joint: str = ""
    direction: int = 0
    series: int = -1
    is_angle: bool = True

    id = "approach-scatter"
    step = Step.DRIVE
    is_persistent = False
    lacking = Missing.POSES

    @property
    def subject(self) -> str:
        """The joint; empty for all."""
        return f"joint {self.joint}" if self.joint else ""

    def candidates(self, scene: ChainScene) -> Sequence[JointScatter]:
        """Return none: scatter has no mean effect."""
        return ()

    def scatters(self, scene: ChainScene) -> Sequence[ScatterCandidate[JointScatter]]:
        """Return single joints and all of them, in all poses, from each side, and in each series."""
        machine, result = scene.inputs_of_machine, []
        poses, joints = machine.readings.shape
        noisy = machine.noisy
        if not len(noisy) or poses < _FEWEST_POSES:
            return ()
        groups = [(-1, np.ones(poses, bool))]
        numbers = np.unique(machine.conditions.series)
        groups += [(int(s), machine.conditions.series == s) for s in numbers] if len(numbers) > 1 else []
        for joint in (-1, *range(joints)):
            is_scattered = np.array([joint in (-1, k) for k in noisy], bool)
            turns = bool(machine.tree.is_revolute[noisy if joint < 0 else joint].any())
            cause = replace(self, joint=machine.tree.readings[joint] if joint >= 0 else "", is_angle=turns)
            if not is_scattered.any():
                continue
            for series, within in groups:
                if joint >= 0 or series >= 0:
                    result.append(ScatterCandidate(replace(cause, series=series), within[:, None] & is_scattered, True))
            sides = machine.approach
            for side in (1, -1) if joint >= 0 and sides is not None else ():
                came = np.zeros(poses) if sides is None else sides[:, joint] == side
                if 0 < came.sum() < poses:
                    result.append(ScatterCandidate(replace(cause, direction=side), came[:, None] & is_scattered, True))
        return result

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the scatter, one sigma of a joint's motion."""
        return (Parameter("scatter", "rad", 1e-5) if self.is_angle else Parameter("scatter", "mm", 1e-5, _MM),)


@dataclass(frozen=True)
class JointsExchanged(ChainCause):
    """The readings of two joints are in each other's column, in the whole campaign."""

    joints: tuple[str, ...] = ()

    id = "joints-exchanged"
    step = Step.DRIVE
    is_persistent = False

    @property
    def subject(self) -> str:
        """The two joints."""
        return " ".join(f"joint {name}" for name in self.joints)

    def candidates(self, scene: ChainScene) -> Sequence[JointsExchanged]:
        """Return none: the exchange is evident before any search."""
        return ()

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return none."""
        return ()

    def corrected(self, readings: NDArray, names: Sequence[str]) -> NDArray:
        """Return readings (B, n) in the right columns."""
        result = readings.copy()
        a, b = (names.index(name) for name in self.joints)
        result[:, [a, b]] = readings[:, [b, a]]
        return result


def _is_motion_of(node: Node, twist: NDArray) -> bool:
    """Return True if a joint moves by this motion (6,) of unit size, to either side."""
    unit = axis_twist(node)
    return bool(np.abs(twist - (twist @ unit) * unit).max() < ROUNDED)


def moved_alike(machine: ChainInputs, node: int, twist: NDArray) -> list[tuple[int, NDArray]]:
    """Return the nodes, with their motions (6,), at which a motion has the same effect; that node alone in loops, which
    also hold links together that no joint between them moves."""
    if isinstance(machine.tree, ClosedTree):
        return [(node, twist)]
    return nodes_moved_alike(machine.tree, node, twist, {int(k) for k in machine.channels.node})


def onsets_of_change(machine: ChainInputs, most: int = MOST_ONSETS) -> list[tuple[int | str, float]]:
    """Return the poses, and their ranks in time, from which something may have changed; every one of up to ``most``."""
    in_time = np.argsort(machine.order, kind="stable")
    chosen = in_time[FEWEST : len(in_time) - FEWEST + 1 : _onset_spacing(machine, most)]
    return [(machine.conditions.poses[b], float(machine.order[b])) for b in chosen]


def onsets_of_poses(
    machine: ChainInputs, from_order: float, begun_at: Callable[[int | str, float], CauseT], most: int = MOST_ONSETS
) -> Onsets[CauseT]:
    """Return the onsets that a cause can have which acts from the rank ``from_order`` in time on; ``begun_at`` returns
    it from a pose and its rank on."""

    def at_epoch(epoch: int) -> CauseT:
        return begun_at(machine.conditions.poses[epoch], float(machine.order[epoch]))

    return onsets_in_time(machine.order, FEWEST, _onset_spacing(machine, most), from_order, at_epoch)


def _onset_spacing(machine: ChainInputs, most: int) -> int:
    """Return the spacing of the onsets that are tried."""
    return 1 + len(machine.order) // most
