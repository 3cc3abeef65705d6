"""Causes that act on a chain: joints, links, base and targets; base class `ChainCause` and scene `ChainScene`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from truing.inference.model import ChannelCandidates, ScatterCandidate
from truing.simulation.cause import Cause, Parameter, ReportedParameter, Scene, Step
from truing.simulation.inputs import LAST_STEP, ORDER, PATH, TIME, Missing
from truing.simulation.mechanisms.chains.centres import moments_off_centre, off_centre
from truing.simulation.mechanisms.chains.closed_tree import ClosedTree
from truing.simulation.mechanisms.chains.conditions import ChainInputs
from truing.simulation.mechanisms.chains.passing import nodes_moved_alike
from truing.simulation.mechanisms.chains.tree import JointKind, Node, axis_twist

_ANGLE, _LENGTH = 5e-4, 3e-4  # plausible errors of a joint, rad and m
_GAIN = 5e-4
_GROWTH = 1e-5
_OFF_M = 1e-4  # plausible offset of an instrument of distances, m
# Deflection that a plausible compliance gives under the largest load, rad or m.
_MM = 1e-3
# A load that varies by a smaller share of the largest load on the chain is constant, apart from rounding.
_LEAST_LOAD = 1e-6
# Parts of a length that are smaller by this factor are rounding of the description.
_ROUNDED = 1e-4
# Least number of poses before an onset, and from it; in a long campaign not every pose is tried as an onset.
_FEWEST, _MOST_ONSETS = 4, 60
_FEW_ONSETS = 2  # of these, every so many for targets seen by distances
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
        """Columns (B,) or (B, n) that effects may depend on."""
        return self.inputs_of_machine.conditions.covariates

    @property
    def inputs(self) -> Mapping[str, NDArray]:
        """Readings (B,) of the joints by name."""
        machine = self.inputs_of_machine
        return dict(zip(machine.tree.readings, machine.readings.T, strict=True))

    @property
    def histories(self) -> Mapping[str, NDArray]:
        """States of stop operators and the reading before the last movement (B, 9), of each joint by name."""
        machine, known = self.inputs_of_machine, self.covariates
        if PATH not in known or LAST_STEP not in known:
            return {}
        past = np.concatenate([known[PATH], (machine.readings - known[LAST_STEP])[..., None]], axis=-1)
        return dict(zip(machine.tree.readings, past.swapaxes(0, 1), strict=True))

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

    def deviation_slopes(self, machine: ChainInputs, values: NDArray) -> NDArray | None:
        """Return the derivatives (B, n, P) of the deviations at values (P,), SI; the deviations of a linear cause."""
        return self.deviations(machine)

    def joint_motion(self, machine: ChainInputs, values: NDArray, by_joint: NDArray) -> NDArray | None:
        """Return the derivatives (B, 3 K, P) of channels by the parameters at values (P,), SI, from those by the motion
        of each joint (B, K, 3, n); None if no joint deviates."""
        own = self.deviation_slopes(machine, values)
        return None if own is None else by_joint.reshape(len(by_joint), -1, by_joint.shape[-1]) @ own

    def deviation(self, machine: ChainInputs, values: NDArray) -> NDArray | None:
        """Return the deviations (B, n) of the joints' motion at values (P,), SI; None if none deviates."""
        own = self.deviations(machine)
        return None if own is None else own @ values

    def shifts(self, machine: ChainInputs) -> NDArray | None:
        """Return the shifts (B, K, 3, P) of targets in their links per unit of the parameters, m; None if none
        moves."""
        return None

    def excess(self, machine: ChainInputs, distances: Sequence[tuple[str, str]]) -> NDArray | None:
        """Return by how much distances between named ends are read too long (B, D, P) per unit of the parameters, m;
        None if they are not."""
        return None


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
            if np.ptp(machine.readings[:, k]) > 0.0
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
        own = tree.node_of(tree.readings.index(self.joint))
        if sum(node.reading == self.joint for node in tree.nodes) > 1:  # others follow it
            return {}
        alike = _moved_alike(scene.inputs_of_machine, own, axis_twist(tree.nodes[own]))
        followed = [node.reading for node in tree.nodes if node.reading != node.joint]
        same = [tree.nodes[k].joint for k, twist in alike if _is_motion_of(tree.nodes[k], twist)]
        others = [name for name in same if name != self.joint and name in tree.readings and name not in followed]
        return {"alike": [f"joint {name}" for name in others]} if others else {}

    def corrected(self, readings: NDArray, names: Sequence[str]) -> NDArray:
        """Return readings (B, n) with the known part of the offset."""
        found = readings.copy()
        found[:, names.index(self.joint)] += self.start
        return found

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
    """A joint stops at its reading minus backlash x direction of approach; the full gap is twice the backlash."""

    id = "joint-backlash"
    lacking = Missing.APPROACH

    def applies(self, machine: ChainInputs) -> bool:
        """True if the joint was approached from both sides."""
        came = machine.approach
        return came is not None and bool(np.ptp(came[:, machine.tree.readings.index(self.joint)]) > 0.0)

    def one_sided(self, legs: int) -> tuple[int, ...]:
        """Return the gap: it cannot be negative."""
        return (0,)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return half of the gap."""
        return (self.size_named("backlash"),)

    def motion(self, machine: ChainInputs, reading: int) -> NDArray:
        """Return minus the direction of approach."""
        assert machine.approach is not None
        return -machine.approach[:, reading, None]

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
    lacking = Missing.WEIGHT

    @property
    def family(self) -> str:
        """Compliance of one joint, whether centres of mass are free or not."""
        return f"{self.id} {self.joint}"

    def candidates(self, scene: ChainScene) -> Sequence[Self]:
        """Return every joint whose load by weight varies."""
        machine = scene.inputs_of_machine
        found: list[Self] = []
        for cause in super().candidates(scene):
            reading = machine.tree.readings.index(cause.joint)
            if machine.load_varies(reading):
                load = float(np.abs(machine.torque(reading)).max())
                away = off_centre(machine, reading, load)
                found.append(replace(cause, load=load, parts=tuple(away), distances=tuple(away.values())))
        return found

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
        own = zip(self.parts, self.distances, strict=True) if self.free else ()
        # A plausible distance is a limit too: centres far away would take the place of the compliance.
        return (compliance, *(Parameter(f"centre {part}", "mm", away / self.reach, _MM) for part, away in own))

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
class LinkCause(ChainCause):
    """Base class of causes that deform one link, named as in the description of the robot."""

    link: str = ""

    step = Step.STRUCTURE

    @property
    def subject(self) -> str:
        """The link."""
        return f"link {self.link}"

    def _children(self, machine: ChainInputs) -> list[int]:
        """Return the nodes whose joints sit on the link."""
        own = machine.tree.links[self.link]
        return [k for k, node in enumerate(machine.tree.nodes) if node.parent == own]


@dataclass(frozen=True)
class LinkGrowth(LinkCause):
    """A link grows by growth x temperature difference, from the joint that moves it to those that it carries.

    ``along``: a joint at one end of the link; only the length along its axis grows. Where on this axis a link ends is a
    choice of the description, so that another link may have this length.
    """

    along: str = ""

    id = "link-growth"
    lacking = Missing.TEMPERATURE

    @property
    def subject(self) -> str:
        """The link; empty for all links."""
        return f"link {self.link}" if self.link else ""

    def candidates(self, scene: ChainScene) -> Sequence[LinkGrowth]:
        """Return all links together, every link with a length, and the lengths along axes that no link is made of; none
        if the temperature does not vary."""
        machine = scene.inputs_of_machine
        heat = machine.heat
        if heat is None or not np.isfinite(heat).all() or not np.ptp(heat) > 0.0:
            return ()
        links = [replace(self, link=name) for name in machine.tree.links]
        long = [cause for cause in links if cause.twists(machine).any()]
        return [self, *long, *_lengths_along(long, machine)] if long else ()

    def shared_with(self, scene: ChainScene) -> Mapping[str, Any]:
        """Return the links to which the length may belong as well, and the joints between, which do not turn it."""
        machine, nodes = scene.inputs_of_machine, scene.inputs_of_machine.tree.nodes
        ends = self._children(machine) if self.link else []
        if len(ends) != 1:
            return {}
        alike = _moved_alike(machine, ends[0], np.r_[self._vector(machine, ends[0]), np.zeros(3)])
        of_link = {nodes[k].parent: nodes[k] for k, _ in alike if nodes[k].parent >= 0}
        named = [
            nodes[link].link
            for link, far in of_link.items()  # a further frame of a rigid link has no length of its own
            if link == 0 or nodes[link].kind is not JointKind.FIXED or np.any(far.t)
        ]
        between = [nodes[k] for k, _ in alike[:-1] if nodes[k].kind is not JointKind.FIXED]
        if len(named) < 2:
            return {}
        return {
            "alike": [f"link {name}" for name in named if name != self.link],
            "between": [f"joint {node.joint}" for node in between],
            "turns": all(node.kind is JointKind.REVOLUTE for node in between),
        }

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the temperature."""
        return ("temperature_c",)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the coefficient of growth."""
        return (Parameter("growth", "1/K", _GROWTH),)

    def twists(self, machine: ChainInputs) -> NDArray:
        """Return the shift of the next joints along the link's vector."""
        found = np.zeros((len(machine.readings), machine.tree.size, 6, 1))
        assert machine.heat is not None
        nodes = range(1, machine.tree.size) if not self.link else self._children(machine)
        for k in nodes:
            found[:, k, :3, 0] = np.multiply.outer(machine.heat, self._vector(machine, k))
        return found

    def _vector(self, machine: ChainInputs, k: int) -> NDArray:
        """Return the vector (3,), m, that grows, from the link's joint to that of node k, in the frame of node k."""
        node = machine.tree.nodes[k]
        vector = node.R.T @ node.t
        if not self.along:
            return vector
        axis = node.axis if node.joint == self.along else node.R.T @ machine.tree.nodes[node.parent].axis
        return np.asarray((vector @ axis) * axis)


def _lengths_along(links: Sequence[LinkGrowth], machine: ChainInputs) -> list[LinkGrowth]:
    """Return, for each axis of a turning joint, the growth of the longest part along it of a link; none for an axis
    along which a whole link lies."""
    longest: dict[str, tuple[float, LinkGrowth]] = {}
    for cause in links:
        ends = cause._children(machine)
        if len(ends) != 1:
            continue
        whole = float(np.sqrt(np.sum(cause._vector(machine, ends[0]) ** 2)))
        for node in (machine.tree.nodes[ends[0]], machine.tree.nodes[machine.tree.links[cause.link]]):
            if node.kind is JointKind.REVOLUTE:
                own = replace(cause, along=node.joint)
                part = float(np.sqrt(np.sum(own._vector(machine, ends[0]) ** 2)))
                size = np.inf if part > (1.0 - _ROUNDED) * whole else part
                if part > _ROUNDED * whole and size > longest.get(node.joint, (0.0, own))[0]:
                    longest[node.joint] = (size, own)
    return [cause for part, cause in longest.values() if part < np.inf]


@dataclass(frozen=True)
class LinkBending(LinkCause):
    """A link bends as a beam of one flexibility 1/(E I) under the weight that it carries."""

    load: float = 1.0  # largest rotation of its end per unit of flexibility, N m2

    id = "link-bending"
    lacking = Missing.WEIGHT

    def candidates(self, scene: ChainScene) -> Sequence[LinkBending]:
        """Return every link with a length and a varying load."""
        machine, found = scene.inputs_of_machine, []
        for name in machine.tree.links:
            turned = replace(self, link=name).twists(machine)[:, :, 3:, 0]
            if np.ptp(turned, axis=0).max(initial=0.0) > _LEAST_LOAD * np.abs(turned).max(initial=0.0):
                found.append(replace(self, link=name, load=float(np.abs(turned).max())))
        return found

    def one_sided(self, legs: int) -> tuple[int, ...]:
        """Return the flexibility: it cannot be negative."""
        return (0,)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the flexibility 1/(E I)."""
        return (Parameter("flexibility", "1/(N m2)", _ANGLE / self.load),)

    def twists(self, machine: ChainInputs) -> NDArray:
        """Return shift and rotation of the link's far ends, as of a cantilever with force and moment at its end."""
        found = np.zeros((len(machine.readings), machine.tree.size, 6, 1))
        for k in self._children(machine):
            node = machine.tree.nodes[k]
            along = node.R.T @ node.t
            length = float(np.sqrt(along @ along))
            if not length > 0.0:
                continue
            unit = along / length
            force, moment = (
                load[:, k] - np.multiply.outer(load[:, k] @ unit, unit) for load in (machine.force, machine.moment)
            )
            of_force = np.cross(unit, force)  # moment per unit of distance from the end
            found[:, k, 3:, 0] = moment * length + of_force * length**2 / 2.0
            bent = np.cross(moment * length**2 / 2.0 + of_force * length**3 / 3.0, unit)
            found[:, k, :3, 0] = bent
        return found


_MOTION = (
    *(Parameter(f"d{axis}", "mm", 1e-4, _MM) for axis in "xyz"),
    *(Parameter(f"turn_{axis}", "rad", 1e-4) for axis in "xyz"),
)


@dataclass(frozen=True)
class BaseDrift(ChainCause):
    """The base moves steadily against the instrument, in one series or all; parameters: from its first to last pose."""

    id = "base-drift"
    step = Step.INSTRUMENT
    is_persistent = False

    start: float = 0.0
    span: float = 1.0
    column: str = ORDER

    def candidates(self, scene: ChainScene) -> Sequence[BaseDrift]:
        """Return the drift with time, or with the order of poses if times are unknown."""
        covariates = scene.covariates
        column = TIME if TIME in covariates else ORDER
        values = covariates[column]
        if not np.isfinite(values).all() or not np.ptp(values) > 0.0:
            return ()
        return (replace(self, start=float(values.min()), span=float(np.ptp(values)), column=column),)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the motion from the first to the last pose, in the frame of the base."""
        return _MOTION

    def twists(self, machine: ChainInputs) -> NDArray:
        """Return the motion in proportion to time."""
        share = (machine.conditions.covariates[self.column] - self.start) / self.span
        return machine.at_node(0, share[:, None, None] * np.eye(6))


@dataclass(frozen=True)
class BaseJump(ChainCause):
    """The base is displaced from some pose on."""

    from_pose: int | str = ""
    from_order: float = -np.inf

    id = "base-jump"
    step = Step.INSTRUMENT
    is_persistent = False

    def candidates(self, scene: ChainScene) -> Sequence[BaseJump]:
        """Return an onset at every pose, or at every few poses of a long campaign."""
        machine = scene.inputs_of_machine
        return [replace(self, from_pose=pose, from_order=order) for pose, order in _onsets(machine)]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the motion, in the frame of the base."""
        return _MOTION

    def twists(self, machine: ChainInputs) -> NDArray:
        """Return the motion, from the pose on."""
        late = (machine.order >= self.from_order).astype(float)
        return machine.at_node(0, late[:, None, None] * np.eye(6))

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the motion, and the first pose after it."""
        return (
            *super().reported(values, covariance, legs),
            ReportedParameter("from_pose", str(self.from_pose), None, ""),
        )


@dataclass(frozen=True)
class DistanceOffset(ChainCause):
    """Distances are read too long by a constant from some pose on: all of them, or those of one ``end``."""

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
        """Return an onset at every pose, or at every few poses, for all distances and for those of each station."""
        onsets = _onsets(scene.inputs_of_machine) if scene.distances else []
        counts = Counter(end for pair in scene.distances for end in set(pair))
        ends = [end for end, number in counts.items() if number < len(scene.distances)]
        return [
            replace(self, end=end, from_pose=pose, from_order=order) for end in ("", *ends) for pose, order in onsets
        ]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the shift of the readings."""
        return (Parameter("shift", "mm", _OFF_M, _MM),)

    def excess(self, machine: ChainInputs, distances: Sequence[tuple[str, str]]) -> NDArray:
        """Return one for the distances concerned, from the pose on."""
        own = np.array([not self.end or self.end in pair for pair in distances], float)
        return ((machine.order >= self.from_order)[:, None] * own)[..., None]

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the shift, and the first pose with it."""
        return (
            *super().reported(values, covariance, legs),
            ReportedParameter("from_pose", str(self.from_pose), None, ""),
        )


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
        onsets, named = _onsets(machine)[::_FEW_ONSETS], machine.channels
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
        targets, onsets = np.flatnonzero(~machine.channels.is_rotation), _onsets(machine)
        if not onsets or not len(targets) or scene.places is not None:
            return ()
        late = np.stack([machine.order >= order for _, order in onsets])
        seen = (
            np.ones((len(machine.order), len(targets)), int)
            if scene.seen is None
            else scene.seen[:, targets].astype(int)
        )
        after = late.astype(int) @ seen
        usable = (after >= _FEWEST) & (seen.sum(0) - after >= _FEWEST)

        def member(target: int, onset: int) -> ChainTargetMoved:
            k = int(targets[target])
            names = {"body": machine.channels.links[k], "target": machine.channels.names[k]}
            return replace(self, **names, from_pose=onsets[onset][0], from_order=onsets[onset][1])  # type: ignore[arg-type]

        return [ChannelCandidates(late[..., None].astype(float), targets, usable, 1e-4, member)]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the shift in the link's frame."""
        return tuple(Parameter(f"d{axis}", "mm", 1e-4, _MM) for axis in "xyz")

    def shifts(self, machine: ChainInputs) -> NDArray:
        """Return the shift of the target, from the pose on; zero if it was not measured."""
        found = np.zeros((len(machine.readings), len(machine.channels.names), 3, 3))
        for k, name in enumerate(zip(machine.channels.links, machine.channels.names, strict=True)):
            if name == (self.body, self.target) and not machine.channels.is_rotation[k]:
                found[machine.order >= self.from_order, k] = np.eye(3)
        return found

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the shift, and the first displaced pose."""
        return (
            *super().reported(values, covariance, legs),
            ReportedParameter("from_pose", str(self.from_pose), None, ""),
        )


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
        machine, found = scene.inputs_of_machine, []
        poses, joints = machine.readings.shape
        noisy = machine.noisy
        if not len(noisy) or poses < _FEWEST_POSES:
            return ()
        groups = [(-1, np.ones(poses, bool))]
        numbers = np.unique(machine.conditions.series)
        groups += [(int(s), machine.conditions.series == s) for s in numbers] if len(numbers) > 1 else []
        for joint in (-1, *range(joints)):
            own = np.array([joint in (-1, k) for k in noisy], bool)
            turns = bool(machine.tree.is_revolute[noisy if joint < 0 else joint].any())
            cause = replace(self, joint=machine.tree.readings[joint] if joint >= 0 else "", is_angle=turns)
            if not own.any():
                continue
            for series, within in groups:
                if joint >= 0 or series >= 0:
                    found.append(ScatterCandidate(replace(cause, series=series), within[:, None] & own, True))
            sides = machine.approach
            for side in (1, -1) if joint >= 0 and sides is not None else ():
                came = np.zeros(poses) if sides is None else sides[:, joint] == side
                if 0 < came.sum() < poses:
                    found.append(ScatterCandidate(replace(cause, direction=side), came[:, None] & own, True))
        return found

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
        found = readings.copy()
        a, b = (names.index(name) for name in self.joints)
        found[:, [a, b]] = readings[:, [b, a]]
        return found


def _is_motion_of(node: Node, twist: NDArray) -> bool:
    """Return True if a joint moves by this motion (6,) of unit size, to either side."""
    unit = axis_twist(node)
    return bool(np.abs(twist - (twist @ unit) * unit).max() < _ROUNDED)


def _moved_alike(machine: ChainInputs, node: int, twist: NDArray) -> list[tuple[int, NDArray]]:
    """Return the nodes, with their motions (6,), at which a motion has the same effect; that node alone in loops, which
    also hold links together that no joint between them moves."""
    if isinstance(machine.tree, ClosedTree):
        return [(node, twist)]
    return nodes_moved_alike(machine.tree, node, twist, {int(k) for k in machine.channels.node})


def _onsets(machine: ChainInputs) -> list[tuple[int | str, float]]:
    """Return the poses, and their ranks in time, from which something may have changed."""
    in_time = np.argsort(machine.order, kind="stable")
    step = 1 + len(in_time) // _MOST_ONSETS
    chosen = in_time[_FEWEST : len(in_time) - _FEWEST + 1 : step]
    return [(machine.conditions.poses[b], float(machine.order[b])) for b in chosen]
