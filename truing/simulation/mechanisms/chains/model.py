"""Class `ChainModel`: targets and orientations on a chain as a function of the unknowns, with exact derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index
from truing.estimation.rotation import exp_so3, inverse_left_jacobian_so3, left_jacobian_so3, log_so3
from truing.inference.model import ErrorPathway, PartialDesign
from truing.simulation.cause import OBSERVED, Effect
from truing.simulation.effects_model import EffectsModel, Prediction
from truing.simulation.inputs import ORDER, ranks
from truing.simulation.mechanisms.chains.causes import ChainCause, ChainScene
from truing.simulation.mechanisms.chains.conditions import ChainConditions, ChainInputs, MeasuredChannels
from truing.simulation.mechanisms.chains.tree import TWIST, Tree, TreeFrames

TWISTS, JOINTS = "twists", "joints"
# Prior sigmas of the base's place and of a target's place where nothing is known of them; they only scale equations.
FREE_TWIST = np.array([0.05] * 3 + [0.05] * 3)
FREE_PLACE = 0.05


@dataclass(frozen=True)
class KnownChain:
    """Prior knowledge of a chain; m and rad.

    ``base_R`` (S, 3, 3), ``base_t`` (S, 3): start values of the base's place in each frame of the measurement.
    ``modes`` (N, 6, Q): errors of the links per prior sigma, ``modes_known`` if that is a tolerance. ``offsets`` (n,):
    prior sigma of each joint's zero, 0 if exact. ``shape`` (K, 3): start values of the channels' places in their
    links; ``shape_modes`` (K, 3, W) their errors per prior sigma, ``shape_known`` (W,) if surveyed. ``tool`` (K, 3, 3):
    start values of the orientations. ``reading_sigma`` (n,): noise of the readings. ``gravity`` (3,): its direction
    in the base's frame; ``payload``: the node that carries it, and its centre of mass, m; ``without_centre``: links
    with a mass whose centre is unknown. ``gear_orders``: known orders of errors by joint, per turn, or rad/m of a
    slide. ``end_modes`` (N, 6, W): twists of nodes without motion to which those errors of the places amount that move
    all targets of a link's end.
    """

    base_R: NDArray
    base_t: NDArray
    is_base_free: bool
    modes: NDArray
    modes_known: bool
    offsets: NDArray
    shape: NDArray
    shape_modes: NDArray
    shape_known: NDArray
    tool: NDArray
    reading_sigma: NDArray
    gravity: NDArray | None = None
    payload: tuple[int, NDArray] = (0, np.zeros(3))
    without_centre: tuple[str, ...] = ()
    reference_temperature_c: float = 20.0
    gear_orders: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    end_modes: NDArray | None = None

    def end_twists(self, nodes: int) -> NDArray:
        """Return the twists (N, 6, W) of nodes without motion per unit of the errors of the places."""
        return np.zeros((nodes, TWIST, self.shape_modes.shape[-1])) if self.end_modes is None else self.end_modes


@dataclass(frozen=True)
class ChainModel(EffectsModel[ChainCause]):
    """A chain with K channels as a function of the unknowns for a set of effects.

    Unknowns are in standard deviations of their priors. Shared ones: places of the base, geometry of the links, zeros
    of the joints, places of the targets, effects. Local ones of each pose: errors of the joint readings.
    """

    tree: Tree
    channels: MeasuredChannels
    known: KnownChain
    conditions: ChainConditions

    channel_word = "target"

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names (K,) of the channels."""
        return self.channels.names

    @property
    def channel_kinds(self) -> tuple[str, ...]:
        """Links (K,) that carry the channels."""
        return self.channels.links

    @property
    def channel_groups(self) -> NDArray:
        """Noise group (K,) of each channel: positions and orientations of each link."""
        links = {name: k for k, name in enumerate(dict.fromkeys(self.channels.links))}
        return np.array([2 * links[link] for link in self.channels.links], int) + self.channels.is_rotation

    @property
    def is_angle(self) -> NDArray:
        """Mask (K,) of the channels that are orientations."""
        return self.channels.is_rotation

    @property
    def part_count(self) -> int:
        """Number of joints that are read."""
        return len(self.tree.readings)

    @property
    def free_offsets(self) -> Index:
        """Readings whose zero has a prior uncertainty."""
        return np.flatnonzero(self.known.offsets > 0.0)

    @property
    def noisy(self) -> Index:
        """Readings with noise."""
        return np.flatnonzero(self.known.reading_sigma > 0.0)

    @property
    def _sizes(self) -> dict[str, int]:
        return {
            "base": TWIST * len(self.known.base_t) if self.known.is_base_free else 0,
            "links": self.known.modes.shape[-1],
            "zeros": len(self.free_offsets),
            "shape": self.known.shape_modes.shape[-1],
        }

    @property
    def setup(self) -> NDArray:
        """Mask (G,) of the places of the base and of targets that are not surveyed."""
        placed = np.zeros(self.shared_size, bool)
        placed[self.layout["base"]] = placed[self.layout["shape"]] = True
        return placed & ~self._shared_known

    @property
    def local_size(self) -> int:
        """Number of local unknowns H: errors of the readings that have noise."""
        return len(self.noisy)

    @property
    def unpredicted(self) -> NDArray:
        """Mask (H,) of the local unknowns that the chain does not predict: none."""
        return np.zeros(self.local_size, bool)

    @property
    def input_scale(self) -> NDArray:
        """Prior sigma (H,) of each reading, rad or m."""
        return np.asarray(self.known.reading_sigma[self.noisy])

    @property
    def error_pathways(self) -> tuple[ErrorPathway, ...]:
        """Directions of errors of the joints' motion, and of the base."""
        joints = [ErrorPathway(JOINTS, k, f"joint {name}", name) for k, name in enumerate(self.tree.readings)]
        return *joints, *(ErrorPathway(TWISTS, column) for column in range(TWIST))

    def with_input_factor(self, factor: NDArray) -> Self:
        """Return the model with the prior sigmas of the readings multiplied by factors (B, H)."""
        return replace(self, conditions=replace(self.conditions, input_factor=factor))

    @property
    def _input_factor(self) -> NDArray:
        """Factors (B, H) or (1, 1) of the readings' prior sigmas."""
        factor = self.conditions.input_factor
        return np.ones((1, 1)) if factor is None else factor

    @property
    def _shared_known(self) -> NDArray:
        known = np.zeros(self.shared_size, bool)
        known[self.layout["links"]] = self.known.modes_known
        known[self.layout["zeros"]] = True
        known[self.layout["shape"]] = self.known.shape_known
        return known

    @property
    def blocks(self) -> NDArray:
        """Ranks (B,) of the poses in time: any pose can be left out of a fit."""
        return ranks(self.conditions.covariates[ORDER])

    @cached_property
    def own_conditions(self) -> ChainConditions:
        """Conditions with readings in their right columns, and with zeros that are known to be far off."""
        readings = self.conditions.readings
        for cause in self.causes:
            readings = cause.corrected(readings, self.tree.readings)
        return replace(self.conditions, readings=readings)

    @cached_property
    def machine(self) -> ChainInputs:
        """Inputs of the effects."""
        known = self.known
        inputs = ChainInputs.weightless(
            self.tree, self.channels, self.own_conditions, known.reference_temperature_c, known.shape, self.noisy
        )
        inputs = replace(inputs, payload=known.payload, gear_orders=known.gear_orders)
        return replace(inputs, without_centre=known.without_centre).under(known.gravity)

    @property
    def scene(self) -> ChainScene:
        """Scene from which causes propose candidates."""
        return ChainScene(self.machine)

    def at(self, conditions: ChainConditions) -> Self:
        """Return the model at other poses."""
        return replace(self, conditions=conditions)

    def rescaled(self, readings: float, survey: float) -> Self:
        """Return the model with the noise of the readings, and of surveyed targets, multiplied by factors."""
        factor = np.where(self.known.shape_known, survey, 1.0)
        modes, ends = self.known.shape_modes * factor, self.known.end_twists(self.tree.size) * factor
        sigma = self.known.reading_sigma * readings
        return replace(self, known=replace(self.known, shape_modes=modes, end_modes=ends, reading_sigma=sigma))

    def twists(self, shared: NDArray, local: NDArray) -> Array:
        """Return the twists (B, N, 6) of all nodes at shared (G,) and local (B, H) unknowns."""
        result = np.zeros((len(self.conditions.readings), self.tree.size, TWIST))
        if self.conditions.deviations is not None:
            result += self.conditions.deviations
        result += self.known.modes @ shared[self.layout["links"]]
        for part, slopes in self._geometry_twists:
            result += slopes @ shared[part]
        if self.local_size:
            result += np.einsum("bh,hni->bni", local * self._input_factor, self._reading_twists)
        for effect in self.effects(shared):
            if (moved := effect.cause.twists(self.machine)) is not None:
                result += moved @ effect.values
            if (turned := effect.cause.deviation(self.machine, effect.values)) is not None:
                result += np.tensordot(turned, self.tree.axis_twists, 1)
        return result

    def places(self, shared: NDArray) -> Array:
        """Return the places (B, K, 3) of the channels in their links; rotation vectors for orientations."""
        shape = self.known.shape + self.known.shape_modes @ shared[self.layout["shape"]]
        found = np.broadcast_to(shape, (len(self.conditions.readings), *shape.shape))
        for effect in self.effects(shared):
            if (moved := effect.cause.shifts(self.machine)) is not None:
                found = found + moved @ effect.values
        return np.asarray(found)

    def tree_frames(self, shared: NDArray, local: NDArray) -> TreeFrames:
        """Return the frames of all nodes (B, N) in the frame of the measurement."""
        series = self.conditions.series
        base = self.known.base_R[series], self.known.base_t[series]
        return self.tree.frames(self.own_conditions.readings, self.twists(shared, local), base)

    @cached_property
    def _geometry_twists(self) -> list[tuple[slice, NDArray]]:
        """Twists (B or 1, N, 6, P) per unknown of base and joint zeros."""
        result: list[tuple[slice, NDArray]] = []
        if self.known.is_base_free:
            series = np.eye(len(self.known.base_t))[self.conditions.series]
            moved = np.einsum("bs,ij->bisj", series, np.diag(FREE_TWIST)).reshape(len(series), TWIST, -1)
            result.append((self.layout["base"], self.machine.at_node(0, moved)))
        if len(offsets := self.free_offsets):
            sigma = self.known.offsets[offsets]
            result.append(
                (self.layout["zeros"], np.moveaxis(self.tree.axis_twists[offsets] * sigma[:, None, None], 0, -1)[None])
            )
        return result

    @cached_property
    def _reading_twists(self) -> Array:
        """Twists (H, N, 6) per local unknown."""
        noisy = self.noisy
        return np.asarray(self.tree.axis_twists[noisy] * self.known.reading_sigma[noisy, None, None])

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> Prediction:
        """Return the channels (B, K, 3), m and rad, and derivatives at shared (G,) and local (B, H) unknowns."""
        if not by_shared and not self.local_size:
            values = ChainModel.points(self, shared, local)
            return self._prediction(shared, values, None, np.zeros((*values.shape, 0)))
        values, by_twist, by_place = self._measured(shared, local)
        by_local = self._decoupled(self._by_local(by_twist))
        slopes = self._decoupled(self._by_shared(by_twist, by_place, shared)) if by_shared else None
        return self._prediction(shared, self._decoupled(values), slopes, by_local)

    def points(self, shared: NDArray, local: NDArray) -> Array:
        """Return the channels (B, K, 3), m and rad, at shared (G,) and local (B, H) unknowns."""
        frames, positions = self.tree_frames(shared, local), self.places(shared)
        return self._decoupled(self._values(frames, positions))

    def _decoupled(self, found: NDArray) -> Array:
        """Return channels (B, K, 3, ...) minus the part whose noise is correlated with the next channel.

        The noise of what remains is independent, and a measured orientation is zero, so that measured values are kept.
        """
        if self.conditions.coupling is None:
            return found
        decoupled = found.copy()
        decoupled[:, :-1] -= np.einsum("bkij,bkj...->bki...", self.conditions.coupling[:, :-1], found[:, 1:])
        return decoupled

    def _values(self, frames: TreeFrames, positions: NDArray) -> Array:
        nodes = self.channels.node
        found = frames.t[:, nodes] + np.einsum("bkij,bkj->bki", frames.R[:, nodes], positions)
        if (turned := self.channels.is_rotation).any():
            seen = frames.R[:, nodes[turned]] @ self.known.tool[turned] @ exp_so3(positions[:, turned])
            found[:, turned] = log_so3(seen @ np.swapaxes(self.conditions.reference[:, turned], -1, -2))
        return np.asarray(found)

    def _measured(self, shared: NDArray, local: NDArray) -> tuple[Array, Array, Array]:
        """Return the channels (B, K, 3); and their derivatives by all twists (B, K, 3, N, 6) and by the places of the
        channels in their links (B, K, 3, 3)."""
        frames, positions = self.tree_frames(shared, local), self.places(shared)
        values, nodes = self._values(frames, positions), self.channels.node
        by_twist, by_place = self.tree.point_slopes(frames, nodes, values), frames.R[:, nodes].copy()
        if (turned := self.channels.is_rotation).any():
            unrolled = inverse_left_jacobian_so3(values[:, turned])
            slopes = self.tree.rotation_slopes(frames, nodes[turned])
            by_twist[:, turned] = np.einsum("bkij,bkjnc->bkinc", unrolled, slopes)
            tools = frames.R[:, nodes[turned]] @ self.known.tool[turned] @ left_jacobian_so3(positions[:, turned])
            by_place[:, turned] = unrolled @ tools
        return values, by_twist, by_place

    def _by_local(self, by_twist: NDArray) -> Array:
        slopes = np.einsum("bkinc,hnc->bkih", by_twist, self._reading_twists)
        return np.asarray(slopes * self._input_factor[:, None, None])

    def _by_shared(self, by_twist: NDArray, by_place: NDArray, shared: NDArray) -> Array:
        """Return the derivatives (B, K, 3, G) by the shared unknowns."""
        count, channels = by_twist.shape[:2]
        slopes = np.zeros((count, channels, 3, self.shared_size))
        flat = by_twist.reshape(count, channels * 3, -1)
        slopes[..., self.layout["links"]] = (flat @ self.known.modes.reshape(flat.shape[-1], -1)).reshape(
            count, channels, 3, -1
        )
        for part, twists in self._geometry_twists:
            slopes[..., part] += (flat @ twists.reshape(len(twists), flat.shape[-1], -1)).reshape(
                count, channels, 3, -1
            )
        slopes[..., self.layout["shape"]] = by_place @ self.known.shape_modes
        for effect in self.effects(shared):
            twists, sigma = slopes[..., self.layout[effect.cause.key]], self.effect_sigma(effect.cause)
            np.multiply(self._by_effect(effect, by_twist, by_place), sigma, out=twists)
        return slopes

    def _by_effect(self, effect: Effect[ChainCause], by_twist: NDArray, by_place: NDArray) -> Array:
        """Return the derivatives (B, K, 3, P) of the channels by an effect's parameters, SI."""
        cause, (count, channels) = effect.cause, by_twist.shape[:2]
        parts: list[Array] = []
        if (moved := cause.twists(self.machine)) is not None:
            flat = by_twist.reshape(count, channels * 3, -1)
            parts.append(flat @ moved.reshape(len(moved), flat.shape[-1], -1))
        if (turned := cause.joint_motion(self.machine, effect.values, self._by_joint(by_twist))) is not None:
            parts.append(turned)
        if (shift := cause.shifts(self.machine)) is not None:
            parts.append(by_place @ shift)
        shape = (count, channels, 3, len(self.effect_scale(cause)))
        parts = [part.reshape(shape) for part in parts]
        return np.asarray(sum(parts[1:], parts[0]) if parts else np.zeros(shape))

    def _by_joint(self, by_twist: NDArray) -> Array:
        """Return the derivatives (B, K, 3, n) of the channels by the motion of each joint."""
        return np.asarray(np.tensordot(by_twist, self.tree.axis_twists, ((3, 4), (1, 2))))

    def rotations(self, shared: NDArray, local: NDArray) -> Array:
        """Return the derivatives (B, K, 3, 3) of the channels by their places in their links."""
        return self._measured(shared, local)[2]

    def pathways(self, shared: NDArray, local: NDArray) -> dict[str, NDArray]:
        """Return the derivatives (B, K, 3, C) of the channels by the twists of all nodes, and by the joints."""
        by_twist = self._decoupled(self._measured(shared, local)[1])
        return {TWISTS: by_twist.reshape(*by_twist.shape[:3], -1), JOINTS: self._by_joint(by_twist)}

    def design_matrix(self, shared: NDArray, local: NDArray) -> Callable[[ChainCause], dict[str, NDArray]]:
        """Return the function from a cause to its twists, deviations of joints and shifts (B, C, P) per plausible
        scale."""
        machine, other_designs = self.machine, self._other_designs(shared, local)

        def found(cause: ChainCause) -> dict[str, NDArray]:
            by = other_designs(cause)
            if (turned := cause.deviations(machine)) is not None:
                by[JOINTS] = turned * self.effect_scale(cause)
            return by

        return found

    def partial_designs(
        self, shared: NDArray, local: NDArray
    ) -> Callable[[ChainCause], Mapping[str, NDArray | PartialDesign]]:
        """Return the same function for candidates, whose designs hold only the joints that move."""
        machine, other_designs = self.machine, self._other_designs(shared, local)

        def found(cause: ChainCause) -> Mapping[str, NDArray | PartialDesign]:
            by: dict[str, NDArray | PartialDesign] = {**other_designs(cause)}
            if (turned := cause.joint_deviations(machine)) is not None:
                by[JOINTS] = PartialDesign(turned[0], turned[1] * self.effect_scale(cause))
            return by

        return found

    def _other_designs(self, shared: NDArray, local: NDArray) -> Callable[[ChainCause], dict[str, NDArray]]:
        """Return the function from a cause to its twists, and shifts of targets, per plausible scale."""
        machine, observed = self.machine, self._observed_shifts(shared, local)

        def found(cause: ChainCause) -> dict[str, NDArray]:
            scale, twists, by = self.effect_scale(cause), cause.twists(machine), {}
            if twists is not None:
                by[TWISTS] = twists.reshape(len(twists), -1, twists.shape[-1]) * scale
            if (shifts := cause.shifts(machine)) is not None:
                by[OBSERVED] = observed(shifts * scale)
            return by

        return found

    def _observed_shifts(self, shared: NDArray, local: NDArray) -> Callable[[NDArray], Array]:
        """Return the function from shifts (B, K, 3, P) of the targets in their links to changes (B, C, P) of the
        observations."""
        rotations = self.rotations(shared, local)

        def found(shifts: NDArray) -> Array:
            return (rotations @ shifts).reshape(len(shifts), -1, shifts.shape[-1])

        return found
