"""Straight beams, and a leg as a chain of them, flexure - tube - flexure (telescope report, eq. 20-28).

An element has node i at x = 0, node j at x = length, the beam along local x; per node displacements (u_x, u_y, u_z), m,
and rotations (phi_x, phi_y, phi_z), rad, against forces, N, and moments, N m. As printed, K12 and K21 of eq. 20-21 are
symmetric, which breaks rigid motions: here K12 = K21'.

A leg has the nodes a' (root, on the base), c', d' and b' (on the platform), from root to platform. It is condensed to
its two ends. Legs are batches: arrays lead with (..., L).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.mechanisms.legs.kinematics import unit
from truing.simulation.mechanisms.structures.structure import BeamSection

# The inputs of an element, in the order of its derivatives.
LENGTH, BENDING, AXIAL, TORSION = range(4)


def section(diameter_m: float, youngs_pa: float, poisson: float) -> BeamSection:
    """Return the stiffness of a solid circular section: EI, ES and GJ with J the polar moment."""
    square = diameter_m * diameter_m
    shear_pa = youngs_pa / (2 * (1 + poisson))
    bending, area, polar = np.pi * square**2 / 64, np.pi * square / 4, np.pi * square**2 / 32
    return BeamSection(youngs_pa * bending, youngs_pa * area, shear_pa * polar)


def element_stiffness(length: NDArray, beam: BeamSection) -> NDArray:
    """Return K (..., 12, 12) of beams of lengths (...), m."""
    k1, k2, k3 = beam.bending, beam.axial, beam.torsion
    share = np.stack([k2 / length, k3 / length, *_bending_stiffness(k1, length)], -1)
    return np.tensordot(share, _PATTERNS, 1)


def element_change(length: NDArray, beam: BeamSection) -> NDArray:
    """Return the derivatives (..., 4, 12, 12) of K by length and by bending, axial and torsion stiffness."""
    k1, k2, k3, zero, ones = beam.bending, beam.axial, beam.torsion, 0.0 * length, 1.0 + 0.0 * length
    turn, couple, shear = _bending_stiffness(k1, length)
    rows = (
        (-k2 / length**2, -k3 / length**2, -turn / length, -2 * couple / length, -3 * shear / length),
        (zero, zero, *_bending_stiffness(ones, length)),
        (ones / length, zero, zero, zero, zero),
        (zero, ones / length, zero, zero, zero),
    )
    share = np.stack([np.stack(row, -1) for row in rows], -2)
    return np.tensordot(share, _PATTERNS, 1)


def _bending_stiffness(k1: NDArray | float, length: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Return the bending stiffness between rotations, between rotation and shift, and between shifts."""
    return 2 * k1 / length, 6 * k1 / length**2, 12 * k1 / length**3


def _patterns() -> NDArray:
    """Return the patterns (5, 12, 12) of a beam's stiffnesses in K: axial, torsion, turn, couple, shear."""
    axial, torsion, turn, couple, shear = patterns = np.zeros((5, 12, 12))
    apart = np.array([[1.0, -1.0], [-1.0, 1.0]])
    _write_block(axial, (0, 6), apart)
    _write_block(torsion, (3, 9), apart)
    for shift, angle, sign in ((1, 5, 1.0), (2, 4, -1.0)):  # a shift along y bends about z, one along z about -y
        _write_block(shear, (shift, shift + 6), apart)
        _write_block(turn, (angle, angle + 6), np.array([[2.0, 1.0], [1.0, 2.0]]))
        couple[np.ix_((shift, shift + 6), (angle, angle + 6))] = sign * np.array([[1.0, 1.0], [-1.0, -1.0]])
    couple += couple.T
    return patterns


def _write_block(pattern: NDArray, corner: tuple[int, int], block: NDArray) -> None:
    pattern[np.ix_(corner, corner)] = block


_PATTERNS = _patterns()


_SECTIONS = [BENDING, AXIAL, TORSION]
_FLEXURE_A, _TUBE, _FLEXURE_B = slice(0, 12), slice(6, 18), slice(12, 24)
_INNER, _ENDS = np.arange(6, 18), np.r_[0:6, 18:24]


@dataclass(frozen=True)
class Chain:
    """Parts of a leg: lengths (..., L), m, of a flexure and of the tube between the flexures, and their sections."""

    flexure_length: NDArray
    tube_length: NDArray
    flexure: BeamSection
    tube: BeamSection


@dataclass(frozen=True)
class Nodes:
    """Nodes of legs (..., L, 3), m: a and c at the lower joint, base frame; d and b at the upper joint, platform
    frame."""

    a: NDArray
    c: NDArray
    d: NDArray
    b: NDArray


def nodes(lower: NDArray, upper: NDArray, half: NDArray, R0: NDArray) -> Nodes:
    """Return the nodes (eq. 22) from joints lower (base frame) and upper (platform frame) in the flexures' middle.

    half: half a flexure along its leg at the reference, l_b z0 / 2 (..., L, 3), base frame; R0: the platform's rotation
    there.
    """
    seen = half @ R0
    return Nodes(lower - half, lower + half, upper - seen, upper + seen)


def assembled(chain: Chain) -> NDArray:
    """Return K (..., L, 24, 24) over the nodes a', c', d', b', along local x (eq. 23-24)."""
    joint = element_stiffness(chain.flexure_length, chain.flexure)
    tube = element_stiffness(chain.tube_length, chain.tube)
    return _in_chain(joint, (_FLEXURE_A, _FLEXURE_B)) + _in_chain(tube, (_TUBE,))


def assembled_change(chain: Chain) -> NDArray:
    """Return the derivatives (..., L, 8, 24, 24) of `assembled` by its inputs.

    In order: lengths of flexure and tube; bending, axial and torsion stiffness of the flexure; those of the tube.
    """
    joint = _in_chain(element_change(chain.flexure_length, chain.flexure), (_FLEXURE_A, _FLEXURE_B))
    tube = _in_chain(element_change(chain.tube_length, chain.tube), (_TUBE,))
    lengths = [joint[..., LENGTH, :, :], tube[..., LENGTH, :, :]]
    return np.concatenate([np.stack(lengths, -3), joint[..., _SECTIONS, :, :], tube[..., _SECTIONS, :, :]], -3)


def recovery_matrix(stiffness: NDArray) -> NDArray:
    """Return T (..., 24, 12): displacements of all nodes by those of the ends a', b', without load between them."""
    inner = stiffness[..., _INNER[:, None], _INNER]
    fixed = stiffness[..., _INNER[:, None], _ENDS]
    follow = np.zeros((*stiffness.shape[:-2], 24, 12), stiffness.dtype)
    follow[..., _INNER, :] = -np.linalg.solve(inner, fixed)
    follow[..., _ENDS, np.arange(12)] = 1.0
    return follow


def condensed(stiffness: NDArray) -> NDArray:
    """Return K_c - K_f' K_u^-1 K_f (..., 12, 12) over a', b' of an assembled chain (eq. 25-27)."""
    ends = stiffness[..., _ENDS, :]
    return ends @ recovery_matrix(stiffness)


def condensed_change(stiffness: NDArray, change: NDArray) -> NDArray:
    """Return the derivatives (..., n, 12, 12) of `condensed` from those of the assembled chain (..., n, 24, 24).

    T' dK T: a motion of the nodes between the ends does no work to first order, as no load acts on them.
    """
    follow = recovery_matrix(stiffness)[..., None, :, :]
    return np.swapaxes(follow, -1, -2) @ change @ follow


def beam_axes(z: NDArray) -> NDArray:
    """Return the axes (..., 3, 3), columns, of beams along z (..., 3): local x is the leg (eq. 28 as corrected).

    The other two axes are arbitrary: the sections are circular.
    """
    least = np.eye(3)[np.argmin(np.abs(z), -1)]
    x = unit(least - z * np.sum(z * least, -1)[..., None])
    return np.stack([z, x, np.cross(z, x)], -1)


def in_frame(stiffness: NDArray, axes: NDArray) -> NDArray:
    """Return T K T' (..., n, n), n a multiple of 3, with T = diag(axes, ..., axes) (eq. 28)."""
    count = stiffness.shape[-1] // 3
    blocks = np.kron(np.eye(count), axes)
    return blocks @ stiffness @ np.swapaxes(blocks, -1, -2)


def _in_chain(element: NDArray, blocks: tuple[slice, ...]) -> NDArray:
    """Add elements (..., 12, 12) at their blocks among the nodes of a chain (..., 24, 24)."""
    chain = np.zeros((*element.shape[:-2], 24, 24), element.dtype)
    for rows in blocks:
        chain[..., rows, rows] += element
    return chain
