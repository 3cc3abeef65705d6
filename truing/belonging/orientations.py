"""Do measured orientations turn with the links of a chain; and slips in how rotations were written down."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from truing.arrays import Array, Mask
from truing.belonging.relation import RecordSlip, SlipKind

# Misfit, as a share of the spread of orientations, and least size, rad, above which they do not belong to the links:
# far beyond zeros of joints that a calibration finds.
_FOREIGN, _LEAST = 0.1, 0.05
# The same where a slip explains the misfit: rotation vectors and Euler angles differ little if all turns are small.
_NOTABLE, _LEAST_NOTABLE = 0.02, 0.005
_EXPLAINED = 0.2  # of the misfit: what a slip may leave
_ROUNDS, _MOST_ROUNDS, _MOST_POSES = 40, 2000, 200  # slow where orientations spread little
_FAR, _MOST_STRAY = 5.0, 0.1  # typical misfits beyond which a row is stray, and the largest share of such rows
_ALIKE = 4.0  # traces of rotations from pose to pose that differ by more times the limit, rad, are of other rotations
_ORDERS = tuple("".join(own) for own in product("XYZ", repeat=3) if own[0] != own[1] != own[2])
_MEASURED = "measured orientations"


@dataclass(frozen=True)
class TurningMisfit:
    """Misfit of orientations, its limit and that without the slips, rad; ``slips`` explain them equally well.

    ``stray``: rows (B,) far from the others, which do not count.
    """

    before: float
    limit: float
    after: float
    slips: tuple[RecordSlip, ...]
    stray: Mask


def turning_misfit(
    links: NDArray, measured: NDArray, euler: str | None, positions: tuple[NDArray, NDArray] | None = None
) -> TurningMisfit:
    """Compare orientations of a link (B, 3, 3) by the chain with measured ones (B, 3, 3); seek slips if they differ.

    Base and tool are turned so that they fit best. ``euler``: the order in which Euler angles were read; None if
    orientations were no Euler angles. ``positions``: those of the link by the chain (B, 3), and as measured (B, 3), m.
    Where several slips explain the orientations, as cyclic exchanges of the axes do, positions decide.
    """
    few = np.unique(np.linspace(0, len(links) - 1, min(len(links), _MOST_POSES)).round().astype(int))
    spread = max(_spread(links[few]), _spread(measured[few]))
    limit, notable = max(_FOREIGN * spread, _LEAST), max(_NOTABLE * spread, _LEAST_NOTABLE)
    frames = _places(links[few], measured[few], notable)
    away = _angles(frames, links, measured)
    stray = away > max(limit, _FAR * float(np.median(away)))
    if stray.any() and stray.mean() <= _MOST_STRAY:
        few = few[~stray[few]]
        frames = _places(links[few], measured[few], notable)
        away = _angles(frames, links, measured)
        stray = away > max(limit, _FAR * float(np.median(away)))
    else:
        stray = np.zeros(len(links), bool)
    links, measured = links[few], measured[few]
    near = None if positions is None else (positions[0][few], positions[1][few])
    before = _rms(_angles(frames, links, measured))
    if before <= notable:
        return TurningMisfit(before, limit, before, (), stray)
    enough = min(_EXPLAINED * before, limit)
    tried = [
        (slip, other, _places(links, other, enough))
        for slip, other in otherwise_written(measured, euler)
        if np.sqrt(np.mean((_turned(links) - _turned(other)) ** 2)) < _ALIKE * limit
    ]
    misfits = [(_rms(_angles(frames, links, other)), slip, other, frames[0]) for slip, other, frames in tried]
    misfits = [one for one in misfits if one[0] < enough]
    least = min((after for after, *_ in misfits), default=before)
    alike = [(slip, _missed(other, base, near)) for after, slip, other, base in misfits if after <= 2.0 * least]
    nearest = min((missed for _, missed in alike), default=0.0)
    slips = tuple(slip for slip, missed in alike if missed <= 2.0 * nearest)
    return TurningMisfit(before, notable if slips else limit, least, slips, stray)


def otherwise_written(measured: NDArray, euler: str | None) -> Iterator[tuple[RecordSlip, Array]]:
    """Yield slips with the orientations (B, 3, 3) without them.

    A slip that reverses an odd number of components of the quaternion, or exchanges two, is an orthogonal map of four
    dimensions with determinant -1. That is an inversion between two constant rotations, and an unknown base and tool
    take these up. So the scalar at the other end, and rotation vectors with two components exchanged or one reversed,
    are no trials of their own. Mirrored axes are no inversion, and cannot be seen at all.
    """
    yield _slip("inversion" if euler is None else "inverse"), np.swapaxes(measured, -1, -2)
    read = Rotation.from_matrix(measured)
    angles = read.as_rotvec() if euler is None else read.as_euler(euler)
    for order in (*_ORDERS, *(letters.lower() for letters in _ORDERS)):
        if order != euler:
            yield _slip(order), Rotation.from_euler(order, angles).as_matrix()


def _slip(written: str) -> RecordSlip:
    return RecordSlip(SlipKind.ROTATION, _MEASURED, (written,))


def _missed(measured: NDArray, base: Array, positions: tuple[NDArray, NDArray] | None) -> float:
    """Return the rms distance, m, of measured positions from the chain on a base (3, 3), with the best places of base
    and tool; 0 where no positions are known."""
    if positions is None:
        return 0.0
    by_chain, seen = positions
    ground = np.broadcast_to(np.eye(3), measured.shape)
    design = np.concatenate([ground, measured], axis=2).reshape(-1, 6)
    off = (seen - by_chain @ base.T).ravel()
    return _rms(off - design @ np.linalg.lstsq(design, off, rcond=None)[0])


def _places(links: NDArray, measured: NDArray, enough: float) -> tuple[Array, Array]:
    """Return the base and the tool (3, 3) of the least misfit between base @ links @ tool and measured orientations.

    The search ends with the first that leave at most ``enough``, rad, and improves it until it converges.
    """
    candidates: list[tuple[float, tuple[Array, Array]]] = []
    for tool in _starts():
        frames = _fitted(links, measured, tool)
        candidates.append((_rms(_angles(frames, links, measured)), frames))
        if candidates[-1][0] <= enough:
            return _fitted(links, measured, frames[1], _MOST_ROUNDS)
    return min(candidates, key=lambda candidate: candidate[0])[1]


def _angles(frames: tuple[Array, Array], links: NDArray, measured: NDArray) -> Array:
    """Return the angles (B,), rad, between base @ links @ tool and measured orientations."""
    base, tool = frames
    away = Rotation.from_matrix(base @ links @ tool).inv() * Rotation.from_matrix(measured)
    return np.asarray(away.magnitude())


def _rms(values: NDArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _turned(orientations: NDArray) -> Array:
    """Return the traces (B - 1,) of the rotations from one to the next, which no base and no tool change."""
    return np.asarray(np.einsum("bij,bij->b", orientations[:-1], orientations[1:]))


def _fitted(links: NDArray, measured: NDArray, tool: Array, rounds: int = _ROUNDS) -> tuple[Array, Array]:
    """Return base and tool after alternating Procrustes fits from a rotation of the tool."""
    base, last = np.eye(3), np.inf
    for _ in range(rounds):
        base = _nearest(np.einsum("bij,bkj->ik", measured, links @ tool))
        tool = _nearest(np.einsum("bji,bjk->ik", base @ links, measured))
        now = float(np.sum((base @ links @ tool - measured) ** 2))
        if last - now < 1e-9 * now:
            break
        last = now
    return base, tool


def _starts() -> list[Array]:
    """Return the 24 rotations of a cube."""
    rotations = [
        np.array(signs)[:, None] * np.eye(3)[list(axes)]
        for axes in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return [rotation for rotation in rotations if np.linalg.det(rotation) > 0.0]


def _nearest(total: NDArray) -> Array:
    left, _, right = np.linalg.svd(total)
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)


def _spread(turned: NDArray) -> float:
    """Return the rms angle, rad, of orientations (B, 3, 3) about their mean."""
    mean = _nearest(turned.sum(0))
    return _rms(Rotation.from_matrix(mean.T @ turned).magnitude())
