"""Compliance of a leg as a serial chain of flexible elements (force-sensor paper, eq. 18-23).

A part runs along z of the leg from its inner end, clamped, to its outer end, loaded: a cantilever of a section that may
vary along its length. Compliance (6, 6): displacement (m, rad) of the outer end by the wrench (N, N m) there, in the
leg's axes (`geometry.leg_axes`). Beams are slender: shear is neglected.

An element is a length along the leg with parts that are flexible at its outer end. A part's compliance is inversely
proportional to one elastic parameter (a modulus, a stiffness); hence its derivative by the log of that is its negative.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.estimation.rotation import skew
from truing.schemas.faults import Unfit
from truing.simulation.mechanisms.structures.beams import section

# Nodes of the integrals over a notch; the integrands are nearly polynomials in the angle of integration.
_NODES = 64
_ALONG = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Flexibility:
    """Integrals over a part's length, with h the distance to its outer end.

    axial: of 1 / EA; torsion: of 1 / GJ; about_x, about_y: of 1, h and h^2 over EI about that axis.
    """

    axial: float
    torsion: float
    about_x: tuple[float, float, float]
    about_y: tuple[float, float, float]


def cantilever(part: Flexibility) -> NDArray:
    """Return the compliance (6, 6) of a part at its outer end."""
    C = np.zeros((6, 6))
    C[2, 2], C[5, 5] = part.axial, part.torsion
    for sag, turn, sign, (tilt, couple, deflect) in ((1, 3, -1.0, part.about_x), (0, 4, 1.0, part.about_y)):
        C[sag, sag], C[turn, turn] = deflect, tilt
        C[sag, turn] = C[turn, sag] = sign * couple
    return C


def moved_along(compliance: NDArray, distance: NDArray) -> NDArray:
    """Return compliances (..., 6, 6) at a point a distance (...), m, further out along the leg."""
    T = transport(distance)
    return np.swapaxes(T, -1, -2) @ compliance @ T


def transport(distance: NDArray) -> NDArray:
    """Return T (..., 6, 6): the wrench at a part's end by the wrench a distance (...), m, further out."""
    T = np.zeros((*np.shape(distance), 6, 6), np.asarray(distance).dtype)
    T[..., range(6), range(6)] = 1.0
    T[..., 3:, :3] = skew(np.asarray(distance)[..., None] * _ALONG)
    return T


def cylinder_compliance(length: float, diameter: float, youngs_pa: float, poisson: float) -> NDArray:
    """Return the compliance (6, 6) of a solid circular rod, m and Pa."""
    beam = section(diameter, youngs_pa, poisson)
    bent = _uniform(length, beam.bending)
    return cantilever(Flexibility(length / beam.axial, length / beam.torsion, bent, bent))


def leaf_compliance(
    length: float, width: float, thickness: float, youngs_pa: float, poisson: float, soft: str
) -> NDArray:
    """Return the compliance (6, 6) of a leaf spring that bends about s1 (x) or s2 (-y), m and Pa.

    Its torsion constant is that of `rectangle_torsion`. Raises ValueError if soft is no axis, or the leaf is thicker
    than wide.
    """
    if thickness > width:
        raise Unfit("leaf", f"thickness {thickness} m and width {width} m", "a thickness of at most the width")
    shear_pa = youngs_pa / (2.0 * (1.0 + poisson))
    thin, wide = (_uniform(length, youngs_pa * width * thickness * size**2 / 12.0) for size in (thickness, width))
    twist = length / (shear_pa * float(rectangle_torsion(np.array(width), np.array(thickness))))
    return cantilever(Flexibility(length / (youngs_pa * width * thickness), twist, *_soft_first(soft, thin, wide)))


def notch_compliance(width: float, web: float, radius: float, youngs_pa: float, poisson: float, soft: str) -> NDArray:
    """Return the compliance (6, 6) of a circular flexure hinge of length 2 radius, m and Pa.

    Two half circles leave a web between them: thickness web + 2 radius (1 - cos phi), constant width. The integrals are
    over the angle psi with tan(phi/2) = tan(psi/2) / sqrt(1 + 4 radius/web), which smooths the peak of a thin web.
    Raises ValueError if soft is no axis.
    """
    psi, weight = _nodes(_breaks(width, web, radius))
    full, lean = web + 2.0 * radius, 2.0 * radius
    square = full**2 - lean**2
    size = full + lean * np.cos(psi)
    thickness = square / size
    step = weight * radius * (lean + full * np.cos(psi)) / size * np.sqrt(square) / size  # along the leg
    beyond = radius * (1.0 - np.sqrt(square) * np.sin(psi) / size)  # the distance to the outer end
    shear_pa = youngs_pa / (2.0 * (1.0 + poisson))
    torsion = np.sum(step / rectangle_torsion(np.full_like(psi, width), thickness)) / shear_pa
    area = width * thickness
    thin, wide = (_integrals(12.0 * step / (youngs_pa * area * size**2), beyond) for size in (thickness, width))
    axial = np.sum(step / area) / youngs_pa
    return cantilever(Flexibility(float(axial), float(torsion), *_soft_first(soft, thin, wide)))


def rectangle_torsion(first: NDArray, other: NDArray) -> NDArray:
    """Return the torsion constants (...), m^4, of rectangles: a b^3 / 3 (1 - 0.63 b / a), a the longer side.

    The error is 0.1 % for b < a / 2; the value is 12 % too small for a square.
    """
    a, b = np.maximum(first, other), np.minimum(first, other)
    return a * b**3 / 3.0 * (1.0 - 0.63 * b / a)


def universal_joint(part: NDArray, length: float) -> NDArray:
    """Return the compliance (6, 6) at the common centre of two equal crossed leaves or notches of a length, m.

    part: compliance of one of them, soft about s1, at its outer end; the other is turned by 90 degrees about the leg.
    """
    centred = moved_along(part, np.array(-0.5 * length))
    quarter = np.kron(np.eye(2), np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    return centred + quarter @ centred @ quarter.T


def _uniform(length: float, bending: float) -> tuple[float, float, float]:
    return length / bending, length**2 / (2.0 * bending), length**3 / (3.0 * bending)


def _integrals(share: NDArray, beyond: NDArray) -> tuple[float, float, float]:
    return float(np.sum(share)), float(np.sum(share * beyond)), float(np.sum(share * beyond**2))


def _soft_first(
    soft: str, thin: tuple[float, float, float], wide: tuple[float, float, float]
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return bending about x and about y."""
    if soft not in ("s1", "s2"):
        raise Unfit("soft", f"{soft!r}", "s1 or s2")
    return (thin, wide) if soft == "s1" else (wide, thin)


def _breaks(width: float, web: float, radius: float) -> list[float]:
    """Return the limits of the integrals: the ends, and the points where the torsion formula exchanges its sides."""
    end = 2.0 * np.arctan(np.sqrt(1.0 + 4.0 * radius / web))
    full, lean = web + 2.0 * radius, 2.0 * radius
    cosine = ((full**2 - lean**2) / width - full) / lean  # cosine of psi at which the thickness equals the width
    inner = [np.arccos(cosine)] if web < width < full else []
    return [-end, *(-np.array(inner)), *inner, end]


def _nodes(breaks: list[float]) -> tuple[NDArray, NDArray]:
    """Return abscissae and weights (n,) of Gauss's quadrature, piece by piece."""
    x, w = _gauss()
    pieces = list(pairwise(breaks))
    at = [0.5 * (low + high) + 0.5 * (high - low) * x for low, high in pieces]
    return np.concatenate(at), np.concatenate([0.5 * (high - low) * w for low, high in pieces])


@cache
def _gauss() -> tuple[NDArray, NDArray]:
    return np.polynomial.legendre.leggauss(_NODES)


# Relative tolerance of typed numbers with three digits: lengths of elements and legs, and matrices.
_TYPED = 1e-3


@dataclass(frozen=True)
class LegElement:
    """An element of a leg: length, m, and compliances (6, 6) at its outer end with the elastic parameter of each.

    An element with length None fills the rest of each leg. measures: whether it is the leg's force sensor.
    """

    kind: str
    length: float | None
    gives: tuple[tuple[str, NDArray], ...]
    measures: bool = False


def rigid(length: float | None = None) -> LegElement:
    """Return a rigid element; without a length, it fills the rest of the leg."""
    return LegElement("rigid", length, ())


def cylinder(length: float, diameter: float, youngs_pa: float, poisson: float) -> LegElement:
    """Return a solid circular rod."""
    return LegElement("cylinder", length, (("youngs", cylinder_compliance(length, diameter, youngs_pa, poisson)),))


def leaf(length: float, width: float, thickness: float, youngs_pa: float, poisson: float, soft: str) -> LegElement:
    """Return a leaf spring that bends about the leg axis s1 or s2."""
    found = leaf_compliance(length, width, thickness, youngs_pa, poisson, soft)
    return LegElement("leaf", length, (("youngs", found),))


def notch(width: float, web: float, radius: float, youngs_pa: float, poisson: float, soft: str) -> LegElement:
    """Return a circular flexure hinge, 2 radius long, that bends about the leg axis s1 or s2."""
    return LegElement(
        "notch", 2.0 * radius, (("youngs", notch_compliance(width, web, radius, youngs_pa, poisson, soft)),)
    )


def spring(axial: float | None = None, torsion: float | None = None, length: float = 0.0) -> LegElement:
    """Return springs along and about the leg, N/m and N m/rad, rigid if absent; the axial one is the sensor."""
    known = (("axial", 2, axial), ("torsion", 5, torsion))
    gives = tuple((name, _unit_entry(entry) / value) for name, entry, value in known if value is not None)
    return LegElement("spring", length, gives, measures=axial is not None)


def compliance(matrix: ArrayLike, length: float = 0.0) -> LegElement:
    """Return an element of known compliance (6, 6) at its outer end, SI, leg axes; errors as for `passive`."""
    return LegElement("compliance", length, (("scale", passive(matrix, "compliance")),))


def passive(matrix: ArrayLike, what: str) -> NDArray:
    """Return the symmetric part of a given compliance (6, 6).

    Raises ValueError for another shape, a direction of negative compliance, and an asymmetry above 0.1 % of the roots
    of its diagonal.
    """
    given = np.asarray(matrix, float)
    if given.shape != (6, 6):
        raise Unfit(what, f"a matrix of shape {given.shape}", "a compliance of shape (6, 6)")
    size = np.sqrt(np.abs(np.diag(given)))
    size = np.where(size > 0.0, size, 1.0)
    scaled = given / np.outer(size, size)
    asymmetry = float(np.abs(scaled - scaled.T).max())
    if not asymmetry <= _TYPED:
        raise Unfit(
            what, f"an asymmetry of {asymmetry:.2g} of the diagonal", f"a symmetric compliance (at most {_TYPED:g})"
        )
    lowest = float(np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[0])
    if lowest < -_TYPED:
        raise Unfit(
            what, f"a negative eigenvalue ({lowest:.2g} of the diagonal)", "a compliance without negative eigenvalues"
        )
    return 0.5 * (given + given.T)


@dataclass(frozen=True)
class LegParts:
    """The P flexible parts of six legs as compliances at the platform's ends of the legs, leg axes.

    names: element (counted from 1) and parameter of each; compliance (..., 6, P, 6, 6); by_installed and by_middle: its
    derivatives by the sensor's installation error and by the middle joint's clearance, per m.
    """

    names: tuple[str, ...]
    compliance: NDArray
    by_installed: NDArray
    by_middle: NDArray


def leg_parts(elements: Sequence[LegElement], length: NDArray) -> LegParts:
    """Return the flexible parts of legs of lengths (..., 6), m, between the joint centres.

    Raises ValueError if elements and legs differ in length by more than 0.1 %, or all elements are rigid.
    """
    beyond = _distance_to_end(elements, length)
    seat = _force_sensor_index(elements, beyond, length)
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
        raise Unfit("elements", "rigid elements only", "at least one flexible element")
    return LegParts(tuple(names), *(np.stack(each, -3) for each in (compliances, installed, middle)))


def _distance_to_end(elements: Sequence[LegElement], length: NDArray) -> list[NDArray]:
    """Return the distance (..., 6), m, of each element's outer end from the leg's."""
    lengths = [element.length for element in elements]
    total = sum(value for value in lengths if value is not None)
    remaining_length = length - total
    if lengths.count(None) > 1:
        raise Unfit(
            "elements",
            f"{lengths.count(None)} elements without length",
            "at most one, which takes the remaining length",
        )
    if None in lengths and remaining_length.real.min() < 0.0:
        raise Unfit("elements", f"a total length of {total} m", f"at most the shortest leg, {length.min()} m")
    if None not in lengths and np.abs(remaining_length).max() > _TYPED * length.max():
        raise Unfit("elements", f"a total length of {total} m", f"the length of each leg, {length.ravel().tolist()} m")
    filled = [remaining_length if value is None else np.full_like(length, value) for value in lengths]
    outer = [np.zeros_like(length)]
    for value in filled[:0:-1]:
        outer.append(outer[-1] + value)
    return outer[::-1]


def _force_sensor_index(elements: Sequence[LegElement], beyond: list[NDArray], length: NDArray) -> int:
    """Return the index of the force sensor: the first element that measures, otherwise the one at the leg's middle."""
    for j, element in enumerate(elements):
        if element.measures:
            return j
    return next(j for j, distance in enumerate(beyond) if np.all(distance <= 0.5 * length))


def _slope(at_end: NDArray) -> NDArray:
    """Return the derivative (..., 6, 6) of a compliance by the distance to its point of reference: T' with dT =
    [z]x."""
    turn = np.zeros((6, 6))
    turn[3, 1], turn[4, 0] = -1.0, 1.0
    moved = at_end @ turn
    return moved + np.swapaxes(moved, -1, -2)


def _unit_entry(index: int) -> NDArray:
    entry = np.zeros((6, 6))
    entry[index, index] = 1.0
    return entry
