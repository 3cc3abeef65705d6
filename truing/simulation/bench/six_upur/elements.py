"""A leg as a serial chain of elements, from the base to the platform (force-sensor paper, eq. 18-23).

An element is a length along the leg and parts that give at its outer end. A part's compliance is inversely
proportional to one elastic parameter (a modulus, a stiffness), which makes derivatives by these a matter of a sign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.schemas.faults import Unfit
from truing.simulation.bench.six_upur import flexible_parts as parts
from truing.simulation.bench.six_upur.flexible_parts import moved_along

# What is typed has three digits or so: lengths of elements and legs, and matrices, agree to this.
_TYPED = 1e-3


@dataclass(frozen=True)
class Element:
    """An element of a leg: length, m, and compliances (6, 6) at its outer end by the elastic parameter they go with.

    A length of None takes up what the other elements leave of each leg. measures: whether it is the leg's force sensor.
    """

    kind: str
    length: float | None
    gives: tuple[tuple[str, NDArray], ...]
    measures: bool = False


def rigid(length: float | None = None) -> Element:
    """Return an element that does not give; without a length, the rest of the leg."""
    return Element("rigid", length, ())


def cylinder(length: float, diameter: float, youngs_pa: float, poisson: float) -> Element:
    """Return a solid circular rod."""
    return Element("cylinder", length, (("youngs", parts.cylinder(length, diameter, youngs_pa, poisson)),))


def leaf(length: float, width: float, thickness: float, youngs_pa: float, poisson: float, soft: str) -> Element:
    """Return a leaf spring that bends about the leg axis s1 or s2."""
    found = parts.leaf(length, width, thickness, youngs_pa, poisson, soft)
    return Element("leaf", length, (("youngs", found),))


def notch(width: float, web: float, radius: float, youngs_pa: float, poisson: float, soft: str) -> Element:
    """Return a circular flexure hinge, 2 radius long, that bends about the leg axis s1 or s2."""
    return Element("notch", 2.0 * radius, (("youngs", parts.notch(width, web, radius, youngs_pa, poisson, soft)),))


def spring(axial: float | None = None, torsion: float | None = None, length: float = 0.0) -> Element:
    """Return springs along and about the leg, N/m and N m/rad, rigid where absent; the axial one is the sensor."""
    known = (("axial", 2, axial), ("torsion", 5, torsion))
    gives = tuple((name, _at(place) / value) for name, place, value in known if value is not None)
    return Element("spring", length, gives, measures=axial is not None)


def compliance(matrix: ArrayLike, length: float = 0.0) -> Element:
    """Return an element of known compliance (6, 6) at its outer end, SI, leg axes; errors as for `passive`."""
    return Element("compliance", length, (("scale", passive(matrix, "compliance")),))


def passive(matrix: ArrayLike, what: str) -> NDArray:
    """Return the symmetric part of a given compliance (6, 6).

    Raises ValueError for another shape, for an asymmetry of more than 0.1 % of the roots of its diagonal, and where
    something moves against its load.
    """
    given = np.asarray(matrix, float)
    if given.shape != (6, 6):
        raise Unfit(what, f"shape {given.shape}", "(6, 6)")
    size = np.sqrt(np.abs(np.diag(given)))
    size = np.where(size > 0.0, size, 1.0)
    scaled = given / np.outer(size, size)
    asymmetry = float(np.abs(scaled - scaled.T).max())
    if not asymmetry <= _TYPED:
        raise Unfit(what, f"an asymmetry of {asymmetry:.2g} of its diagonal", "a symmetric matrix")
    lowest = float(np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[0])
    if lowest < -_TYPED:
        raise Unfit(what, f"a direction that moves against its load ({lowest:.2g})", "none")
    return 0.5 * (given + given.T)


@dataclass(frozen=True)
class LegParts:
    """The P flexible parts of six legs as the platform's ends feel them, leg axes.

    names: element (counted from 1) and parameter of each; compliance (..., 6, P, 6, 6); by_installed and
    by_middle: its derivatives by the sensor's installation error and by the middle joint's clearance, per m.
    """

    names: tuple[str, ...]
    compliance: NDArray
    by_installed: NDArray
    by_middle: NDArray


def leg_parts(elements: Sequence[Element], length: NDArray) -> LegParts:
    """Return the flexible parts of legs of lengths (..., 6), m, between the joint centres.

    Raises ValueError where elements and legs differ in length by more than 0.1 %, or nothing gives.
    """
    beyond = _beyond(elements, length)
    seat = _seat(elements, beyond, length)
    names, compliances, installed, middle = [], [], [], []
    for j, element in enumerate(elements):
        distance = beyond[j]
        for name, local in element.gives:
            at_end = moved_along(local, distance)
            slope = _slope(at_end)
            names.append(f"{j + 1} {element.kind} {name}")
            compliances.append(at_end)
            installed.append(slope if j < seat else np.zeros_like(slope))
            middle.append(-slope)
    if not names:
        raise Unfit("elements", "none that gives", "a flexible leg")
    return LegParts(tuple(names), *(np.stack(each, -3) for each in (compliances, installed, middle)))


def _beyond(elements: Sequence[Element], length: NDArray) -> list[NDArray]:
    """Return how far (..., 6), m, each element's outer end is from the leg's."""
    lengths = [element.length for element in elements]
    given = sum(value for value in lengths if value is not None)
    rest = length - given
    if lengths.count(None) > 1:
        raise Unfit("elements", f"{lengths.count(None)} without length", "one at most to take the rest")
    if None in lengths and rest.real.min() < 0.0:
        raise Unfit("elements", f"{given} m in all", f"no more than the shortest leg, {length.min()} m")
    if None not in lengths and np.abs(rest).max() > _TYPED * length.max():
        raise Unfit("elements", f"{given} m in all", f"each leg's length, {length.ravel().tolist()} m")
    filled = [rest if value is None else np.full_like(length, value) for value in lengths]
    outer = [np.zeros_like(length)]
    for value in filled[:0:-1]:
        outer.append(outer[-1] + value)
    return outer[::-1]


def _seat(elements: Sequence[Element], beyond: list[NDArray], length: NDArray) -> int:
    """Return where the force sensor sits: the first element that measures, else the one that the middle is in."""
    for j, element in enumerate(elements):
        if element.measures:
            return j
    return next(j for j, distance in enumerate(beyond) if np.all(distance <= 0.5 * length))


def _slope(at_end: NDArray) -> NDArray:
    """Return the derivative (..., 6, 6) of a compliance by its distance to where it is seen: T' with dT = [z]x."""
    turn = np.zeros((6, 6))
    turn[3, 1], turn[4, 0] = -1.0, 1.0
    moved = at_end @ turn
    return moved + np.swapaxes(moved, -1, -2)


def _at(place: int) -> NDArray:
    found = np.zeros((6, 6))
    found[place, place] = 1.0
    return found
