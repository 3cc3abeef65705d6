"""Levers of weight about a joint's axis, and masses whose centres are unknown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from truing.simulation.mechanisms.chains.closed_tree import ClosedTree
from truing.simulation.mechanisms.chains.conditions import ChainInputs
from truing.simulation.mechanisms.chains.tree import STANDARD_GRAVITY

AXES = "xyz"
# Least rms size, relative to the scale, of what is independent of the other functions and of a constant.
_INDEPENDENT = 1e-3
_OFF_CENTRE_M = 0.1  # plausible distance of a centre of mass from a joint, unless half of the link is longer


def levers(machine: ChainInputs, reading: int, nodes: Iterable[int]) -> dict[str, NDArray]:
    """Return the levers (B,) of unit vectors fixed in the links of nodes, under weight about the axis of a joint."""
    assert machine.gravity is not None
    tree, frames = machine.tree, machine.nominal_frames
    node = tree.node_of(reading)
    down = machine.gravity / np.sqrt(np.sum(machine.gravity**2))
    axis = frames.R_before[:, node] @ tree.nodes[node].axis
    across = np.cross(down, axis)  # axis . (arm x down) = arm . (down x axis)
    return {
        f"{tree.nodes[k].link} {name}": np.einsum("bi,bi->b", frames.R[:, k, :, c], across)
        for k in nodes
        for c, name in enumerate(AXES)
    }


def independent(functions: Mapping[str, NDArray], scale: float) -> tuple[str, ...]:
    """Return the names of functions (B,) of the pose, of size ``scale``, that differ from each other and from a
    constant, in their order."""
    basis: list[NDArray] = []
    found: list[str] = []
    for name, values in functions.items():
        remainder = values - values.mean()
        for direction in basis:
            remainder = remainder - direction * (direction @ remainder)
        size = float(np.sqrt(np.sum(remainder**2)))
        if size > _INDEPENDENT * scale * np.sqrt(len(values)):
            basis.append(remainder / size)
            found.append(name)
    return tuple(found)


def weight_of(machine: ChainInputs, node: int) -> NDArray:
    """Return the weight (B,), N, of a node's link and its payload."""
    payload = machine.conditions.payload_kg if node == machine.payload[0] else np.zeros(len(machine.readings))
    return np.asarray(STANDARD_GRAVITY * (machine.tree.nodes[node].mass + payload))


def carries_off_centre(machine: ChainInputs, node: int) -> bool:
    """Return True if a node's link or one that it carries has a weight whose centre of mass is unknown."""
    tree = machine.tree
    beyond = [k for k in map(tree.links.__getitem__, machine.without_centre) if k == node or tree.above[k, node]]
    return any(weight_of(machine, k).any() for k in beyond)


def weights_off_centre(machine: ChainInputs, reading: int) -> dict[str, NDArray]:
    """Return by link the weight (B,), N, that a turning joint carries and whose centre of mass is unknown.

    Empty in loops, and for a joint that slides: where a weight acts does not change the force along it.
    """
    tree = machine.tree
    if machine.gravity is None or isinstance(tree, ClosedTree) or not tree.is_revolute[reading]:
        return {}
    node = tree.node_of(reading)
    weights = {link: weight_of(machine, tree.links[link]) for link in machine.without_centre}
    return {link: weight for link, weight in weights.items() if tree.above[tree.links[link], node] and weight.any()}


def moments_off_centre(machine: ChainInputs, reading: int, parts: Iterable[str]) -> NDArray:
    """Return the torque (B, P), N m, about a joint per metre by which a centre of mass is off in each direction."""
    names = tuple(parts)
    nodes = {part: machine.tree.links[part.rpartition(" ")[0]] for part in names}
    arms = levers(machine, reading, set(nodes.values()))
    moments = [weight_of(machine, nodes[part]) * arms[part] for part in names]
    return np.stack(moments, -1) if moments else np.zeros((len(machine.readings), 0))


def off_centre(machine: ChainInputs, reading: int, load: float) -> dict[str, float]:
    """Return a plausible distance, m, by which each unknown centre of mass is off, by its direction in the link; only
    directions that the poses distinguish under the largest ``load``, N m."""
    distances: dict[str, float] = {}
    for link in weights_off_centre(machine, reading):
        k = machine.tree.links[link]
        ends = [float(np.sqrt(node.t @ node.t)) for node in machine.tree.nodes if node.parent == k]
        distances |= {f"{link} {axis}": max(_OFF_CENTRE_M, max(ends, default=0.0) / 2.0) for axis in AXES}
    moments = moments_off_centre(machine, reading, distances).T * np.array(list(distances.values()))[:, None]
    parts = independent(dict(zip(distances, moments, strict=True)), load)
    return {part: distances[part] for part in parts}
