"""Compliance of a leg's elements from the strain energy of a wrench (Castigliano), without matrices.

A leg runs along z of its axes, from the base to the platform. What a section of it carries under a wrench at any point
is a force and the moment about the section; the energy of two such states is the compliance one feels of the other.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from tests.blind.generator.quaternions import Array

# Sections of a notch are summed in panels of Gauss points over the angle on its circle: its waist is a peak.
PANELS, POINTS = 24, 12
ROUNDING = 1e-18  # what is left of a compliance that is none: m/N, 1/N or rad/(N m)


@dataclass(frozen=True)
class Element:
    """One element as campaign.toml has it: ``numbers`` by their names and in their units there; of length None it is as
    long as the others leave each leg.
    """

    kind: str
    length_mm: float | None = 0.0
    numbers: Mapping[str, float] = field(default_factory=dict)
    soft: str = ""
    matrix: Array | None = None

    @property
    def elastic(self) -> int:
        """Number of elastic parameters."""
        return {"rigid": 0, "spring": len(self.numbers)}.get(self.kind, 1)


@dataclass(frozen=True)
class Slices:
    """Sections at distances ``at`` (Q,) from the element's inner end, each ``step`` (Q,) long, m, and what they give:
    along and about z, about x and about y, per length (Q,): 1/EA, 1/GJ, 1/EI.
    """

    at: Array
    step: Array
    along: Array
    twist: Array
    about_x: Array
    about_y: Array


Carried = Callable[[Array], tuple[Array, Array]]
"""At distances (Q,) along the leg: forces and moments about there (Q, 3, 6), leg axes, by six states."""


def flexibilities(element: Element, start: float, length: float, carried: Carried) -> Array:
    """Compliances (elastic, 6, 6) that the six states feel of one element from ``start``, by its elastic parameters."""
    if element.kind in ("rigid", "spring", "compliance"):
        force, moment = (side[0] for side in carried(np.array([start + length])))
        state = np.concatenate([force, moment])
        return state.T @ _lumped(element) @ state
    slices = _slices(element, length)
    force, moment = carried(start + slices.at)
    parts = (
        (force[:, 2], slices.along),
        (moment[:, 2], slices.twist),
        (moment[:, 0], slices.about_x),
        (moment[:, 1], slices.about_y),
    )
    return sum((state.T * (give * slices.step)) @ state for state, give in parts)[None]


def _lumped(element: Element) -> Array:
    """Compliances (elastic, 6, 6) of what gives at one place, leg axes."""
    if element.matrix is not None:
        return element.matrix[None]
    places = {"axial_n_per_m": 2, "torsion_n_m_per_rad": 5}
    given = np.zeros((element.elastic, 6, 6))
    for number, (name, value) in enumerate(element.numbers.items()):
        given[number, places[name], places[name]] = 1 / value
    return given


def _slices(element: Element, length: float) -> Slices:
    of = element.numbers
    youngs, shear = 1e9 * of["youngs_gpa"], 1e9 * of["youngs_gpa"] / (2 + 2 * of["poisson"])
    if element.kind == "cylinder":
        at, step = _even(length)
        radius = np.full_like(at, of["diameter_mm"] / 2e3)
        area, bend = np.pi * radius**2, np.pi * radius**4 / 4
        return Slices(at, step, 1 / (youngs * area), 1 / (2 * shear * bend), 1 / (youngs * bend), 1 / (youngs * bend))
    at, step = _even(length)
    thickness = np.full_like(at, of.get("thickness_mm", 0.0) / 1e3)
    if element.kind == "notch":
        at, step, thickness = _notched(of["web_mm"] / 1e3, of["radius_mm"] / 1e3)
    width = np.full_like(at, of["width_mm"] / 1e3)
    thin, wide = width * thickness**3 / 12, width**3 * thickness / 12
    x, y = (thin, wide) if element.soft == "s1" else (wide, thin)
    short, long = np.minimum(width, thickness), np.maximum(width, thickness)
    twist = long * short**3 / 3 * (1 - 0.63 * short / long)
    area = youngs * width * thickness
    return Slices(at, step, 1 / area, 1 / (shear * twist), 1 / (youngs * x), 1 / (youngs * y))


def _even(length: float) -> tuple[Array, Array]:
    node, weight = np.polynomial.legendre.leggauss(3)  # moments grow along a leg as straight lines do: exact
    return length * (node + 1) / 2, length * weight / 2


def _notched(web: float, radius: float) -> tuple[Array, Array, Array]:
    """Distances, steps and thickness between two half circles, by the angle on them."""
    node, weight = np.polynomial.legendre.leggauss(POINTS)
    # Panels that shrink towards the waist, where nearly all of it gives.
    edge = np.pi / 2 * np.sinh(np.linspace(-4.0, 4.0, PANELS + 1)) / np.sinh(4.0)
    half = np.diff(edge)[:, None] / 2
    angle = (edge[:-1, None] + half * (node + 1)).ravel()
    step = radius * np.cos(angle) * (half * weight).ravel()
    return radius * (1 + np.sin(angle)), step, web + 2 * radius * (1 - np.cos(angle))


def universal_joint(leaf: Element, leaf_mm: float) -> Array:
    """Compliance (6, 6) of two crossed leaves of a length about their common centre, leg axes."""
    centre = leaf_mm / 2e3

    def carried(at: Array) -> tuple[Array, Array]:
        arm = centre - at
        force = np.broadcast_to(np.eye(3, 6), (len(at), 3, 6))
        moment = np.zeros((len(at), 3, 6))
        moment[:, :, 3:] = np.eye(3)
        moment[:, 0, 1], moment[:, 1, 0] = -arm, arm  # (0, 0, arm) x force
        return force, moment

    crossed = [Element(leaf.kind, leaf_mm, leaf.numbers, soft) for soft in ("s1", "s2")]
    found = sum(flexibilities(each, 0.0, leaf_mm / 1e3, carried)[0] for each in crossed)
    return np.where(np.abs(found) > ROUNDING, found, 0.0)
