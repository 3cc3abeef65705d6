"""Causes that deform the links of a chain: growth with temperature and bending under weight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Parameter, Step
from truing.simulation.inputs import Missing
from truing.simulation.mechanisms.chains.causes import (
    DECLARED_WEIGHTS,
    ROUNDED,
    AssumedCentres,
    ChainCause,
    ChainScene,
    moved_alike,
)
from truing.simulation.mechanisms.chains.conditions import ChainInputs
from truing.simulation.mechanisms.chains.mass_centres import carries_off_centre
from truing.simulation.mechanisms.chains.tree import JointKind

_GROWTH = 1e-5  # plausible coefficient of growth, 1/K
_ROTATION = 5e-4  # plausible rotation of a link's end under the largest load, rad
# A rotation that varies by a smaller share of the largest one is constant, apart from rounding.
_LEAST_LOAD = 1e-6


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
        link = machine.tree.links[self.link]
        return [k for k, node in enumerate(machine.tree.nodes) if node.parent == link]


@dataclass(frozen=True)
class LinkGrowth(LinkCause):
    """A link grows by growth x temperature difference, from the joint that moves it to those that it carries.

    ``along``: a joint at one end of the link; only the length along its axis grows. The description chooses the
    end of a link on this axis, so that another link may have this length. Heat of motors may warm the link more than
    the recorded temperature shows. The range of growth is therefore not that of its material.
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
        temperature_rise = machine.temperature_rise
        if temperature_rise is None or not np.isfinite(temperature_rise).all() or not np.ptp(temperature_rise) > 0.0:
            return ()
        long = [replace(self, link=growth.link) for growth in lengths_of_links(machine)]
        return [self, *long, *_lengths_along(long, machine)] if long else ()

    def shared_with(self, scene: ChainScene) -> Mapping[str, Any]:
        """Return the links to which the length may also belong, and the joints between, which do not turn it."""
        machine, nodes = scene.inputs_of_machine, scene.inputs_of_machine.tree.nodes
        ends = self._children(machine) if self.link else []
        if len(ends) != 1:
            return {}
        alike = moved_alike(machine, ends[0], np.r_[self._vector(machine, ends[0]), np.zeros(3)])
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
        result = np.zeros((len(machine.readings), machine.tree.size, 6, 1))
        assert machine.temperature_rise is not None
        nodes = range(1, machine.tree.size) if not self.link else self._children(machine)
        for k in nodes:
            result[:, k, :3, 0] = np.multiply.outer(machine.temperature_rise, self._vector(machine, k))
        return result

    def unit_growth(self, machine: ChainInputs) -> NDArray:
        """Return the shift (nodes, 6) of the next joints by a unit of length, along the link's vector to each."""
        result = np.zeros((machine.tree.size, 6))
        for k in self._children(machine):
            vector = self._vector(machine, k)
            result[k, :3] = vector / max(float(np.sqrt(vector @ vector)), 1e-300)
        return result

    def _vector(self, machine: ChainInputs, k: int) -> NDArray:
        """Return the vector (3,), m, that grows, from the link's joint to that of node k, in the frame of node k."""
        node = machine.tree.nodes[k]
        vector = node.R.T @ node.t
        if not self.along:
            return vector
        axis = node.axis if node.joint == self.along else node.R.T @ machine.tree.nodes[node.parent].axis
        return np.asarray((vector @ axis) * axis)


def lengths_of_links(machine: ChainInputs) -> list[LinkGrowth]:
    """Return the growth of every link that has a length."""
    links = [LinkGrowth(link=name) for name in machine.tree.links]
    return [cause for cause in links if cause.unit_growth(machine).any()]


def _lengths_along(links: Sequence[LinkGrowth], machine: ChainInputs) -> list[LinkGrowth]:
    """Return, for each axis of a turning joint, the growth of the longest part along it of a link; none for an axis
    along which a whole link lies."""
    longest: dict[str, tuple[float, LinkGrowth]] = {}
    for cause in links:
        ends = cause._children(machine)
        if len(ends) != 1:
            continue
        total = float(np.sqrt(np.sum(cause._vector(machine, ends[0]) ** 2)))
        for node in (machine.tree.nodes[ends[0]], machine.tree.nodes[machine.tree.links[cause.link]]):
            if node.kind is JointKind.REVOLUTE:
                candidate = replace(cause, along=node.joint)
                part = float(np.sqrt(np.sum(candidate._vector(machine, ends[0]) ** 2)))
                size = np.inf if part > (1.0 - ROUNDED) * total else part
                if part > ROUNDED * total and size > longest.get(node.joint, (0.0, candidate))[0]:
                    longest[node.joint] = (size, candidate)
    return [cause for part, cause in longest.values() if part < np.inf]


@dataclass(frozen=True)
class LinkBending(AssumedCentres, LinkCause):
    """A link bends as a beam of one flexibility 1/(E I) under the weight that it carries."""

    load: float = 1.0  # largest rotation of its end per unit of flexibility, N m2

    id = "link-bending"
    assumes = DECLARED_WEIGHTS
    lacking = Missing.WEIGHT

    def candidates(self, scene: ChainScene) -> Sequence[LinkBending]:
        """Return every link with a length and a varying load."""
        machine, result = scene.inputs_of_machine, []
        for name in machine.tree.links:
            turned = replace(self, link=name).twists(machine)[:, :, 3:, 0]
            if np.ptp(turned, axis=0).max(initial=0.0) > _LEAST_LOAD * np.abs(turned).max(initial=0.0):
                assumed = carries_off_centre(machine, machine.tree.links[name])
                result.append(replace(self, link=name, load=float(np.abs(turned).max()), centres_assumed=assumed))
        return result

    def one_sided(self, legs: int) -> tuple[int, ...]:
        """Return the flexibility: it cannot be negative."""
        return (0,)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the flexibility 1/(E I)."""
        return (Parameter("flexibility", "1/(N m2)", _ROTATION / self.load),)

    def twists(self, machine: ChainInputs) -> NDArray:
        """Return shift and rotation of the link's far ends, as of a cantilever with force and moment at its end."""
        result = np.zeros((len(machine.readings), machine.tree.size, 6, 1))
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
            result[:, k, 3:, 0] = moment * length + of_force * length**2 / 2.0
            bent = np.cross(moment * length**2 / 2.0 + of_force * length**3 / 3.0, unit)
            result[:, k, :3, 0] = bent
        return result
