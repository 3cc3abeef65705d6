"""Data of the poses of a chain: `ChainConditions`; measurements on it: `Channels`; both for model and causes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.simulation.inputs import (
    FINE_STOPS,
    LAST_STEP,
    MEMORY,
    ORDER,
    PATH,
    RATE,
    TEMPERATURE,
    TIME,
    approach,
    histories,
    rates,
)
from truing.simulation.mechanisms.chains.tree import Tree, TreeFrames

APPROACH = "approach"
# Seconds since a joint stopped: (B,) as the campaign has it, and (B, n) by the times of the poses.
SINCE_MOTION, BETWEEN = "since_motion_s", "time since the pose before the last movement"
# A load that varies by a smaller share of the largest load on the chain is constant, apart from rounding.
_LEAST_LOAD = 1e-6
# Range of a revolute joint, over the widest, below which it was held still.
_STOOD_STILL = 1e-3
# Share of the poses beyond either end of the usual range of an input.
_BEYOND = 0.01


@dataclass(frozen=True)
class MeasuredChannels:
    """K channels of three numbers each: the position of a target, or the orientation of a link.

    ``node`` (K,) is the link's; ``is_rotation`` (K,) marks orientations.
    """

    names: tuple[str, ...]
    links: tuple[str, ...]
    node: Index
    is_rotation: Mask


@dataclass(frozen=True)
class ChainConditions:
    """Readings (B, n) of the joints, rad or m, and covariates (B,) or (B, n) by column, at B poses.

    ``series`` (B,) numbers the frames of the measurement. ``reference`` (B, K, 3, 3) are the measured orientations,
    from which those channels count. ``payload_kg`` (B,) is the mass at the tip. ``columns`` (n,) names the covariates
    with the readings, in the units of the table. ``input_factor`` (B, H): factor of the prior sigmas of readings.
    ``deviations`` (B, N, 6): twists of all nodes that are known already, m and rad; none if absent. ``coupling``
    (B, K, 3, 3): part of the noise of each channel per noise of the next one, a position before its orientation; none
    if absent.
    """

    readings: NDArray
    covariates: Mapping[str, NDArray]
    poses: tuple[int | str, ...]
    series: Index
    reference: NDArray
    payload_kg: NDArray
    columns: tuple[str, ...] = ()
    input_factor: NDArray | None = None
    deviations: NDArray | None = None
    coupling: NDArray | None = None

    def subset(self, rows: Mask) -> ChainConditions:
        """Return the conditions of some poses."""
        return replace(
            self,
            readings=self.readings[rows],
            covariates={name: values[rows] for name, values in self.covariates.items()},
            poses=tuple(pose for pose, wanted in zip(self.poses, rows, strict=True) if wanted),
            series=self.series[rows],
            reference=self.reference[rows],
            payload_kg=self.payload_kg[rows],
            input_factor=None if self.input_factor is None else self.input_factor[rows],
            deviations=None if self.deviations is None else self.deviations[rows],
            coupling=None if self.coupling is None else self.coupling[rows],
        )


def moved_joints(readings: NDArray, is_revolute: Mask) -> Mask:
    """Return the mask (n,) of joints that moved, by readings (B, n).

    A revolute joint that covers less than a thousandth of the widest range was held still: its reading shows only how
    well. A slide may be a fine stage on a coarse one.
    """
    covered = np.ptp(readings, axis=0)
    least = _STOOD_STILL * covered[is_revolute].max(initial=0.0)
    return np.asarray(covered > np.where(is_revolute, least, 0.0))


@dataclass(frozen=True)
class ChainInputs:
    """Inputs of an effect on a chain: the tree, readings, covariates, and the load that each node carries.

    ``force``, ``moment`` (B, N, 3) are those of weight at each joint's origin, along the axes of its frame, N and N m;
    zero where no mass is known. ``shape`` (K, 3) are the targets in their links, m; ``noisy`` are the readings with
    noise. ``gravity`` (3,): its direction in the base's frame; None if it is unknown. ``gear_orders``: known orders of
    errors by joint, per turn; of a slide rad/m. ``payload``: node that carries the payload, and its centre of mass (3,)
    in that link, m. ``without_centre``: links with a mass whose centre is unknown, and assumed at the link's origin.
    """

    tree: Tree
    channels: MeasuredChannels
    conditions: ChainConditions
    force: NDArray
    moment: NDArray
    reference_temperature_c: float
    shape: NDArray = field(default_factory=lambda: np.zeros((0, 3)))
    noisy: Index = field(default_factory=lambda: np.zeros(0, int))
    gravity: NDArray | None = None
    gear_orders: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    payload: tuple[int, NDArray] = field(default_factory=lambda: (0, np.zeros(3)))
    without_centre: tuple[str, ...] = ()

    @classmethod
    def weightless(
        cls,
        tree: Tree,
        channels: MeasuredChannels,
        conditions: ChainConditions,
        reference_temperature_c: float,
        shape: NDArray,
        noisy: Index,
    ) -> ChainInputs:
        """Return the inputs without loads, as the direction of gravity is unknown."""
        force, moment = np.zeros((2, len(conditions.readings), tree.size, 3))
        return cls(tree, channels, conditions, force, moment, reference_temperature_c, shape, noisy)

    def under(self, gravity: NDArray | None) -> ChainInputs:
        """Return the inputs under weight along a direction (3,) in the base's frame; unchanged if it is unknown."""
        if gravity is None:
            return self
        force, moment = _loads(self.tree, self.conditions, gravity, self.payload)
        return replace(self, force=force, moment=moment, gravity=gravity)

    @cached_property
    def without_payload(self) -> ChainInputs:
        """Inputs under the weight of links alone."""
        bare = replace(self.conditions, payload_kg=np.zeros_like(self.conditions.payload_kg))
        return replace(self, conditions=bare).under(self.gravity)

    @property
    def readings(self) -> NDArray:
        """Readings (B, n), rad or m."""
        return self.conditions.readings

    @cached_property
    def moved(self) -> Mask:
        """Mask (n,) of the joints that moved."""
        return moved_joints(self.readings, self.tree.is_revolute)

    @cached_property
    def nominal_frames(self) -> TreeFrames:
        """Frames (B, N) at the readings, of the tree without any effect."""
        return self.tree.frames(self.readings)

    @property
    def temperature_rise(self) -> Array | None:
        """Temperature (B,) above the reference, K; None if it is unknown."""
        found = self.conditions.covariates.get(TEMPERATURE)
        return None if found is None else np.asarray(found - self.reference_temperature_c)

    @property
    def order(self) -> Array:
        """Rank (B,) of each pose in time."""
        return np.asarray(self.conditions.covariates[ORDER], float)

    @property
    def approach(self) -> Array | None:
        """Direction (B, n) of each joint's last movement; None if it is unknown."""
        found = self.conditions.covariates.get(APPROACH)
        return None if found is None else np.asarray(found)

    def torque(self, reading: int) -> Array:
        """Return the torque (B,) of weight about the axis of a joint, N m, or the force along it, N."""
        k = self.tree.node_of(reading)
        load = self.moment if self.tree.is_revolute[reading] else self.force
        return np.asarray(load[:, k] @ self.tree.nodes[k].axis)

    def largest_load(self, turns: bool) -> float:
        """Return the largest moment, N m, or force, N, that weight puts on any joint."""
        return float(np.abs(self.moment if turns else self.force).max(initial=0.0))

    def load_varies(self, reading: int) -> bool:
        """True if the load by weight on a joint varies by more than rounding of the largest load on the chain."""
        largest = self.largest_load(bool(self.tree.is_revolute[reading]))
        return bool(np.ptp(self.torque(reading)) > _LEAST_LOAD * largest)

    def of_joint(self, reading: int, motion: NDArray) -> Array:
        """Return the deviations (B, n, P) of all joints from that (B, P) of one joint's motion, rad or m."""
        result = np.zeros((len(motion), len(self.tree.readings), motion.shape[-1]))
        result[:, reading] = motion
        return result

    def at_node(self, node: int, twists: NDArray) -> Array:
        """Return the twists (B, N, 6, P) of a twist (B, 6, P) of one node."""
        result = np.zeros((len(twists), self.tree.size, *twists.shape[1:]))
        result[:, node] = twists
        return result


def _loads(
    tree: Tree, conditions: ChainConditions, gravity: NDArray, payload: tuple[int, NDArray]
) -> tuple[NDArray, NDArray]:
    """Return force and moment (B, N, 3) of weight at each joint's origin, along the axes of its frame, N and N m."""
    carried = {payload[0]: (conditions.payload_kg, payload[1])} if conditions.payload_kg.any() else {}
    return tree.gravity_load(conditions.readings, gravity, carried)


def usual_range(values: NDArray) -> Array:
    """Return the ends (2, ...) of the range in which nearly all values (B, ...) lie; a few beyond show no function."""
    return np.asarray(np.quantile(values, (_BEYOND, 1.0 - _BEYOND), axis=0))


def movements(readings: NDArray, covariates: Mapping[str, NDArray], least: NDArray) -> dict[str, NDArray]:
    """Return each joint's last movement larger than ``least`` (n,), from readings (B, n) in order of time.

    Its direction (B, n), +1 before any; its size (B, n), rad or m, 0 before any; its history (B, n, 3), the states in
    -1 .. 1 of stop operators, and its path (B, n, 8), those of more of them. Where times are known, there are also the
    seconds (B, n) since the pose before it, infinite before any; and the rates (B, n) of readings along a smooth path.
    Rows with a reading that is not finite are passed over.
    """
    order, time = covariates[ORDER], covariates.get(TIME)
    read = np.flatnonzero(np.isfinite(readings).all(1))
    result = {APPROACH: np.ones(readings.shape), LAST_STEP: np.zeros(readings.shape)}
    result[MEMORY], result[PATH] = histories(readings, order), histories(readings, order, FINE_STOPS)
    if time is not None:
        result[BETWEEN] = np.full(readings.shape, np.inf)
    moving = rates(readings, time)
    result |= {} if moving is None else {RATE: moving}
    rows = read[np.argsort(order[read], kind="stable")]
    if not len(rows):
        return result
    for k, limit in enumerate(least):
        result[APPROACH][rows, k] = approach(readings[rows, k : k + 1], order[rows], float(limit))[:, 0]
    steps = np.diff(readings[rows], axis=0, prepend=readings[rows][:1])
    numbers = np.arange(len(rows))[:, None]
    last = np.maximum.accumulate(np.where(np.abs(steps) > least, numbers, 0), axis=0)
    result[LAST_STEP][rows] = np.where(last > 0, np.take_along_axis(steps, last, 0), 0.0)
    if time is not None:
        result[BETWEEN][rows] = np.where(last > 0, time[rows][:, None] - time[rows][np.maximum(last - 1, 0)], np.inf)
    return result
