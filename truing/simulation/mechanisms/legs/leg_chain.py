"""A leg as a chain of beams, flexure - tube - flexure, condensed to its two ends (telescope report, eq. 22-28).

Nodes a' (root, on the base), c', d' and b' (on the platform), from root to platform; loads and displacements as in
`beam_element`. Legs are batches: arrays lead with (..., L).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.mechanisms.legs.kinematics import unit
from truing.simulation.mechanisms.structures.beam_element import (
    AXIAL,
    BENDING,
    LENGTH,
    TORSION,
    element_change,
    element_stiffness,
)
from truing.simulation.mechanisms.structures.structure import Section

_SECTIONS = [BENDING, AXIAL, TORSION]
_FLEXURE_A, _TUBE, _FLEXURE_B = slice(0, 12), slice(6, 18), slice(12, 24)
_INNER, _ENDS = np.arange(6, 18), np.r_[0:6, 18:24]


@dataclass(frozen=True)
class Chain:
    """What a leg consists of: lengths (..., L), m, of a flexure and of the tube between them, and their sections."""

    flexure_length: NDArray
    tube_length: NDArray
    flexure: Section
    tube: Section


@dataclass(frozen=True)
class Nodes:
    """Nodes of legs (..., L, 3), m: a and c about the lower joint, base frame; d and b about the upper, platform's."""

    a: NDArray
    c: NDArray
    d: NDArray
    b: NDArray


def nodes(lower: NDArray, upper: NDArray, half: NDArray, R0: NDArray) -> Nodes:
    """Return the nodes (eq. 22): joints lower (base frame) and upper (platform frame) lie in the flexures' middle.

    half: half a flexure along its leg at home, l_b z0 / 2 (..., L, 3), base frame; R0: the platform's rotation there.
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


def followed(stiffness: NDArray) -> NDArray:
    """Return T (..., 24, 12): displacements of all nodes where the ends a', b' are moved and no load acts between."""
    inner = stiffness[..., _INNER[:, None], _INNER]
    fixed = stiffness[..., _INNER[:, None], _ENDS]
    follow = np.zeros((*stiffness.shape[:-2], 24, 12), stiffness.dtype)
    follow[..., _INNER, :] = -np.linalg.solve(inner, fixed)
    follow[..., _ENDS, np.arange(12)] = 1.0
    return follow


def condensed(stiffness: NDArray) -> NDArray:
    """Return K_c - K_f' K_u^-1 K_f (..., 12, 12) over a', b' of an assembled chain (eq. 25-27)."""
    ends = stiffness[..., _ENDS, :]
    return ends @ followed(stiffness)


def condensed_change(stiffness: NDArray, change: NDArray) -> NDArray:
    """Return the derivatives (..., n, 12, 12) of `condensed` by what changes the assembled chain (..., n, 24, 24).

    T' dK T: moving the nodes between the ends does no work to first order, as no load acts on them.
    """
    follow = followed(stiffness)[..., None, :, :]
    return np.swapaxes(follow, -1, -2) @ change @ follow


def beam_axes(z: NDArray) -> NDArray:
    """Return the axes (..., 3, 3), columns, of beams along z (..., 3): local x is the leg (eq. 28 as corrected).

    The other two are any across it: circular sections do not tell them apart.
    """
    least = np.eye(3)[np.argmin(np.abs(z), -1)]
    x = unit(least - z * np.sum(z * least, -1)[..., None])
    return np.stack([z, x, np.cross(z, x)], -1)


def in_frame(stiffness: NDArray, axes: NDArray) -> NDArray:
    """Return T K T' (..., n, n), n a multiple of 3, with T = diag(axes, ..., axes) (eq. 28)."""
    count = stiffness.shape[-1] // 3
    blocks = np.kron(np.eye(count), axes)
    return blocks @ stiffness @ np.swapaxes(blocks, -1, -2)


def _in_chain(element: NDArray, places: tuple[slice, ...]) -> NDArray:
    """Return elements (..., 12, 12) added at their places among the nodes of a chain (..., 24, 24)."""
    chain = np.zeros((*element.shape[:-2], 24, 24), element.dtype)
    for place in places:
        chain[..., place, place] += element
    return chain
