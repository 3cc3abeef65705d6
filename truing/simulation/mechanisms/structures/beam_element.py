"""A straight beam between two nodes: its 12 x 12 stiffness and how that follows length and section.

Node i at x = 0, node j at x = length, the beam along local x; per node displacements (u_x, u_y, u_z), m, and rotations
(phi_x, phi_y, phi_z), rad, against forces, N, and moments, N m. Telescope report, eq. 20-21; as printed there K12 and
K21 are symmetric, which breaks rigid motions: here K12 = K21'.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.simulation.mechanisms.structures.structure import Section

# The inputs of an element, in the order of its derivatives.
LENGTH, BENDING, AXIAL, TORSION = range(4)


def section(diameter_m: float, youngs_pa: float, poisson: float) -> Section:
    """Return the stiffness of a solid circular section: EI, ES and GJ with J the polar moment."""
    square = diameter_m * diameter_m
    shear_pa = youngs_pa / (2 * (1 + poisson))
    bending, area, polar = np.pi * square**2 / 64, np.pi * square / 4, np.pi * square**2 / 32
    return Section(youngs_pa * bending, youngs_pa * area, shear_pa * polar)


def element_stiffness(length: NDArray, beam: Section) -> NDArray:
    """Return K (..., 12, 12) of beams of lengths (...), m."""
    k1, k2, k3 = beam.bending, beam.axial, beam.torsion
    share = np.stack([k2 / length, k3 / length, *_bent(k1, length)], -1)
    return np.tensordot(share, _PATTERNS, 1)


def element_change(length: NDArray, beam: Section) -> NDArray:
    """Return the derivatives (..., 4, 12, 12) of K by length and by bending, axial and torsion stiffness."""
    k1, k2, k3, zero, one = beam.bending, beam.axial, beam.torsion, 0.0 * length, 1.0 + 0.0 * length
    turn, couple, shear = _bent(k1, length)
    rows = (
        (-k2 / length**2, -k3 / length**2, -turn / length, -2 * couple / length, -3 * shear / length),
        (zero, zero, *_bent(one, length)),
        (one / length, zero, zero, zero, zero),
        (zero, one / length, zero, zero, zero),
    )
    share = np.stack([np.stack(row, -1) for row in rows], -2)
    return np.tensordot(share, _PATTERNS, 1)


def _bent(k1: NDArray | float, length: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Return what bending gives against rotations, between rotations and shifts, and against shifts."""
    return 2 * k1 / length, 6 * k1 / length**2, 12 * k1 / length**3


def _patterns() -> NDArray:
    """Return where each stiffness of a beam stands in K: (5, 12, 12) axial, torsion, turn, couple, shear."""
    axial, torsion, turn, couple, shear = patterns = np.zeros((5, 12, 12))
    apart = np.array([[1.0, -1.0], [-1.0, 1.0]])
    _fill(axial, (0, 6), apart)
    _fill(torsion, (3, 9), apart)
    for shift, angle, sign in ((1, 5, 1.0), (2, 4, -1.0)):  # a shift along y bends about z, one along z about -y
        _fill(shear, (shift, shift + 6), apart)
        _fill(turn, (angle, angle + 6), np.array([[2.0, 1.0], [1.0, 2.0]]))
        couple[np.ix_((shift, shift + 6), (angle, angle + 6))] = sign * np.array([[1.0, 1.0], [-1.0, -1.0]])
    couple += couple.T
    return patterns


def _fill(pattern: NDArray, places: tuple[int, int], block: NDArray) -> None:
    pattern[np.ix_(places, places)] = block


_PATTERNS = _patterns()
