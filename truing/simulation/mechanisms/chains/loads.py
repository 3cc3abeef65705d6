"""Causes by weight other than the compliance of joints and links: a tilting column, and joints under unknown masses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Parameter, Step
from truing.simulation.inputs import Missing
from truing.simulation.mechanisms.chains.causes import DECLARED_WEIGHTS, AssumedCentres, ChainScene, JointCause
from truing.simulation.mechanisms.chains.closed_tree import ClosedTree
from truing.simulation.mechanisms.chains.conditions import ChainInputs
from truing.simulation.mechanisms.chains.link_causes import LinkCause
from truing.simulation.mechanisms.chains.mass_centres import (
    AXES,
    carries_off_centre,
    independent,
    levers,
    weights_off_centre,
)
from truing.simulation.mechanisms.chains.tree import JointKind

_TILT, _PIVOT_M = 2e-4, 0.5  # plausible tilt under the largest moment, and height above the place that it turns about
_SAG = 5e-4  # rad
_MM = 1e-3
_VARIES = 1e-6  # N m
# Axes of the base along which gravity may act; cosine from which on two directions are the same.
_DIRECTIONS = {
    f"{sign}{axis}": way * np.eye(3)[k] for k, axis in enumerate(AXES) for sign, way in (("+", 1.0), ("-", -1.0))
}
_SAME_WAY = 0.9
# Share of the largest load by which a load varies; plausible deflections under the largest load, rad and m.
_VARIES_LOAD, _DEFLECTED, _DEFLECTED_M = 1e-6, 5e-4, 3e-4
_DEPTHS = (1, 2, 0)  # nearest moving links with an unknown centre of mass; 0: all


@dataclass(frozen=True)
class ColumnTilt(AssumedCentres, LinkCause):
    """A column or rail under the chain tilts by tilt x moment of the weight on it, and shifts by shift x moment.

    The link is the base, or one that slides; the moment acts at its origin. ``shift`` is tilt x height of that origin
    above the place about which it turns. ``about``: an axis of the joint's frame that alone tilts, as of a rail; empty
    for all.
    """

    about: str = ""
    load: float = 1.0  # largest moment, N m

    id = "column-tilt"
    assumes = DECLARED_WEIGHTS
    lacking = Missing.WEIGHT

    def candidates(self, scene: ChainScene) -> Sequence[ColumnTilt]:
        """Return the base and every link that slides, in all directions or about one axis, where moments vary."""
        machine, result = scene.inputs_of_machine, []
        for k, node in enumerate(machine.tree.nodes):
            slides = node.kind is JointKind.PRISMATIC and node.joint in machine.tree.readings
            if not (k == 0 or slides):
                continue
            varying = np.ptp(self._moment(machine, k), axis=0) > _VARIES
            axes = ["", *(axis for axis, varies in zip(AXES, varying, strict=True) if varies)] if varying.any() else []
            for about in axes if sum(varying) > 1 else axes[:1]:
                tilt = replace(self, link=node.link, about=about, centres_assumed=carries_off_centre(machine, k))
                result.append(replace(tilt, load=float(np.abs(tilt._moment(machine, k)).max())))
        return result

    def one_sided(self, legs: int) -> tuple[int, ...]:
        """Return the tilt, and the shift: a column turns about a place below what it carries.

        A negative shift counts against the cause, and does not exclude it.
        """
        return (0, 1)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return tilt and shift per moment."""
        scale = _TILT / self.load
        return Parameter("tilt", "rad/(N m)", scale), Parameter("shift", "mm/(N m)", _PIVOT_M * scale, _MM)

    def twists(self, machine: ChainInputs) -> NDArray:
        """Return the rotation of the link about its origin, and its horizontal shift."""
        k = machine.tree.links[self.link]
        moment, force = self._moment(machine, k), machine.force[:, k]
        up = -force / np.maximum(np.sqrt(np.sum(force**2, -1, keepdims=True)), 1e-12)
        found = np.zeros((len(moment), 6, 2))
        found[:, :3, 0] = np.cross(self._slide(machine, k), moment)
        found[:, 3:, 0] = moment
        found[:, :3, 1] = np.cross(moment, up)
        return machine.at_node(k, found)

    def _slide(self, machine: ChainInputs, k: int) -> NDArray:
        """Return the way (B, 3), m, from the joint's origin to that of the link, in the joint's frame."""
        node, k_in = machine.tree.nodes[k], machine.tree.input_of[k]
        slid = np.zeros(len(machine.readings)) if k_in < 0 else node.factor * machine.readings[:, k_in] + node.shift
        return np.multiply.outer(slid, node.axis)

    def _moment(self, machine: ChainInputs, k: int) -> NDArray:
        """Return the moment (B, 3), N m, about the link's origin, along the axes of the joint's frame."""
        moment = machine.moment[:, k] - np.cross(self._slide(machine, k), machine.force[:, k])
        return moment * np.array([self.about in ("", axis) for axis in AXES], float)


@dataclass(frozen=True)
class JointSag(JointCause):
    """A joint deflects under links of unknown mass: its deviation is a sum over directions fixed in these links.

    Each parameter is the deviation for one direction of the centre of mass when that is horizontal and square to the
    axis: compliance x weight x distance, of which only the product shows. ``parts`` are those directions, link by
    link, that the poses distinguish.
    """

    parts: tuple[str, ...] = ()

    id = "joint-sag"
    lacking = Missing.GRAVITY

    @property
    def family(self) -> str:
        """All forms of one joint."""
        return f"{self.id} {self.joint}"

    def missing_input(self, scene: ChainScene) -> Missing | None:
        """Return the direction of gravity if it is unknown; with known masses the compliance is tested instead."""
        return self.lacking if scene.inputs_of_machine.gravity is None else None

    def candidates(self, scene: ChainScene) -> Sequence[Self]:
        """Return every revolute joint that carries links of unknown mass alone, with the nearest link, two, or all."""
        found: dict[str, Self] = {}
        for cause in super().candidates(scene):
            for depth in _DEPTHS:
                parts = _independent_parts(scene.inputs_of_machine, cause.joint, depth)
                if parts:
                    sag = replace(cause, parts=parts)
                    found.setdefault(sag.key, sag)
        return list(found.values())

    def applies(self, machine: ChainInputs) -> bool:
        """True if gravity is known, and no mass that the joint carries.

        A payload that changes, and masses of unknown centre that are assumed on the joint's axis, do not count.
        Never in loops: there a joint also carries links that no joint above it moves.
        """
        if isinstance(machine.tree, ClosedTree):
            return False
        reading = machine.tree.readings.index(self.joint)
        joint_node, without_centre = machine.tree.node_of(reading), weights_off_centre(machine, reading)
        carried = [node for k, node in enumerate(machine.tree.nodes) if machine.tree.above[k, joint_node]]
        payload = machine.conditions.payload_kg
        tip = machine.tree.nodes[machine.payload[0]].link
        weighed = any(node.mass > 0.0 and node.link not in without_centre for node in carried)
        weighed |= bool(payload.any() and not np.ptp(payload) > 0.0) and tip not in without_centre
        weighed |= bool(without_centre) and machine.load_varies(reading)
        slides = any(node.kind is JointKind.PRISMATIC for node in carried)
        return machine.gravity is not None and self.is_angle and not weighed and not slides

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return a deviation for each direction."""
        return tuple(Parameter(f"sag {part}", "rad", _SAG) for part in self.parts)

    def motion(self, machine: ChainInputs, reading: int) -> NDArray:
        """Return the lever of the weight about the axis (B, P), per unit of mass times distance in each direction."""
        found = _levers(machine, reading)
        return np.stack([found[part] for part in self.parts], -1)


@dataclass(frozen=True)
class GravityDirection(AssumedCentres):
    """Joints deflect under weight along another axis of the base than the declared gravity.

    ``loads``: largest torque of each of the ``joints`` then, N m, or force, N; each has a compliance. ``is_opposite``:
    the direction is against the declared one, so that a controller that corrects too much deflection acts alike.
    """

    direction: str = "-z"
    joints: tuple[str, ...] = ()
    are_angles: tuple[bool, ...] = ()
    loads: tuple[float, ...] = ()
    is_opposite: bool = False

    id = "gravity-direction"
    lacking = Missing.WEIGHT
    step = Step.DRIVE

    @property
    def family(self) -> str:
        """One for all directions."""
        return self.id

    def candidates(self, scene: ChainScene) -> Sequence[Self]:
        """Return all other axes of the base, with every joint whose load varies, and with all of them."""
        machine = scene.inputs_of_machine
        if machine.gravity is None:
            return ()
        declared = machine.gravity / np.sqrt(np.sum(machine.gravity**2))
        result: list[Self] = []
        for name, down in _DIRECTIONS.items():
            if down @ declared > _SAME_WAY:
                continue
            towards = replace(self, direction=name, is_opposite=bool(down @ declared < -_SAME_WAY))
            single = list(towards._of_single_joints(machine.under(down)))
            result += single
            if len(single) > 1:
                result.append(
                    replace(
                        single[0],
                        joints=tuple(joint for cause in single for joint in cause.joints),
                        are_angles=tuple(is_angle for cause in single for is_angle in cause.are_angles),
                        loads=tuple(load for cause in single for load in cause.loads),
                        centres_assumed=any(cause.centres_assumed for cause in single),
                    )
                )
        return result

    def _of_single_joints(self, machine: ChainInputs) -> Iterator[Self]:
        for k, joint in enumerate(machine.tree.readings):
            torque, is_angle = machine.torque(k), bool(machine.tree.is_revolute[k])
            if np.ptp(torque) > _VARIES_LOAD * machine.largest_load(is_angle):
                largest = float(np.abs(torque).max())
                tilt = replace(self, joints=(joint,), are_angles=(is_angle,), loads=(largest,))
                yield replace(tilt, centres_assumed=is_angle and carries_off_centre(machine, machine.tree.node_of(k)))

    def prior(self, scene: ChainScene) -> float:
        """Return the relative prior weight: all joints are as probable as all single ones together."""
        return float(len(self.joints))

    def one_sided(self, legs: int) -> tuple[int, ...]:
        """Return all compliances: they cannot be negative."""
        return tuple(range(len(self.joints)))

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the compliance of each joint."""
        return tuple(
            Parameter(f"compliance {joint}", "rad/(N m)", _DEFLECTED / load)
            if is_angle
            else Parameter(f"compliance {joint}", "mm/N", _DEFLECTED_M / load, _MM)
            for joint, is_angle, load in zip(self.joints, self.are_angles, self.loads, strict=True)
        )

    def deviations(self, machine: ChainInputs) -> NDArray:
        """Return the torque about the axis of each joint, or the force along it."""
        other_gravity, names = machine.under(_DIRECTIONS[self.direction]), machine.tree.readings
        result = np.zeros((len(machine.readings), len(names), len(self.joints)))
        for index, joint in enumerate(self.joints):
            result[:, names.index(joint), index] = other_gravity.torque(names.index(joint))
        return result


def _independent_parts(machine: ChainInputs, joint: str, depth: int) -> tuple[str, ...]:
    """Return the directions of the nearest links whose levers the poses distinguish from each other and a constant."""
    found = _levers(machine, machine.tree.readings.index(joint))
    return independent(dict(list(found.items())[: len(AXES) * depth or None]), 1.0)


def _levers(machine: ChainInputs, reading: int) -> dict[str, NDArray]:
    """Return the levers (B,) of unit vectors fixed in each moving link that a joint carries, the nearest link first."""
    tree, node = machine.tree, machine.tree.node_of(reading)
    moving = [int(k) for k in np.flatnonzero(tree.above[:, node]) if tree.nodes[k].kind is not JointKind.FIXED]
    return levers(machine, reading, moving)
