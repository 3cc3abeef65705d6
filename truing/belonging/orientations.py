"""Do measured orientations turn with the links of a chain; and slips in how rotations were written down."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from truing.arrays import Array
from truing.belonging.relation import RecordSlip, SlipKind

# Misfit, as a share of the spread of orientations, and least size, rad, above which they do not belong to the links:
# far beyond zeros of joints that a calibration finds.
_FOREIGN, _LEAST = 0.1, 0.05
_EXPLAINED = 0.2  # of the misfit: what a slip may leave
_ROUNDS, _MOST_POSES = 40, 200
_ALIKE = 4.0  # traces of rotations from pose to pose that differ by more times the limit, rad, are of other rotations
_ORDERS = tuple("".join(own) for own in product("XYZ", repeat=3) if own[0] != own[1] != own[2])
_MEASURED = "measured orientations"


@dataclass(frozen=True)
class TurningMisfit:
    """Misfit of orientations, its limit and that without the slips, rad; ``slips`` explain them equally well."""

    before: float
    limit: float
    after: float
    slips: tuple[RecordSlip, ...]


def turning_misfit(links: NDArray, measured: NDArray, euler: str | None) -> TurningMisfit:
    """Compare orientations of a link (B, 3, 3) by the chain with measured ones (B, 3, 3); seek slips if they differ.

    Base and tool are turned so that they fit best. ``euler``: the order in which Euler angles were read; None if
    orientations were no Euler angles.
    """
    few = np.unique(np.linspace(0, len(links) - 1, min(len(links), _MOST_POSES)).round().astype(int))
    links, measured = links[few], measured[few]
    limit = max(_FOREIGN * max(_spread(links), _spread(measured)), _LEAST)
    before = _misfit(links, measured, limit)
    if before <= limit:
        return TurningMisfit(before, limit, before, ())
    enough = min(_EXPLAINED * before, limit)
    found = [
        (_misfit(links, other, enough), slip)
        for slip, other in _otherwise(measured, euler)
        if np.sqrt(np.mean((_turned(links) - _turned(other)) ** 2)) < _ALIKE * limit
    ]
    found = [(after, slip) for after, slip in found if after < enough]
    least = min((after for after, _ in found), default=before)
    return TurningMisfit(before, limit, least, tuple(slip for after, slip in found if after <= 2.0 * least))


def _otherwise(measured: NDArray, euler: str | None) -> Iterator[tuple[RecordSlip, Array]]:
    """Yield slips with the orientations (B, 3, 3) without them."""
    read = Rotation.from_matrix(measured)
    if euler is None:
        quaternions = read.as_quat()  # x, y, z, w
        yield _slip("xyzw"), Rotation.from_quat(np.roll(quaternions, 1, 1)).as_matrix()
        yield _slip("wxyz"), Rotation.from_quat(np.roll(quaternions, -1, 1)).as_matrix()
    else:
        angles = read.as_euler(euler)
        for order in (*_ORDERS, *(own.lower() for own in _ORDERS)):
            if order != euler:
                yield _slip(order), Rotation.from_euler(order, angles).as_matrix()
    yield _slip("inverse"), np.swapaxes(measured, -1, -2)
    for signs in ((-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, -1.0)):
        mirror = np.diag(signs)
        yield RecordSlip(SlipKind.MIRRORED, _MEASURED), mirror @ measured @ mirror


def _slip(written: str) -> RecordSlip:
    return RecordSlip(SlipKind.ROTATION, _MEASURED, (written,))


def _misfit(links: NDArray, measured: NDArray, enough: float) -> float:
    """Return the rms angle, rad, between base @ links @ tool and measured orientations, of the best rotations, or of
    the first that leave ``enough``."""
    least = np.inf
    for tool in _starts():
        least = min(least, _fitted(links, measured, tool))
        if least <= enough:
            break
    return least


def _turned(orientations: NDArray) -> Array:
    """Return the traces (B - 1,) of the rotations from one to the next, which no base and no tool change."""
    return np.asarray(np.einsum("bij,bij->b", orientations[:-1], orientations[1:]))


def _fitted(links: NDArray, measured: NDArray, tool: Array) -> float:
    """Return the rms angle, rad, after alternating Procrustes fits of base and tool from a rotation of the tool."""
    base, last = np.eye(3), np.inf
    for _ in range(_ROUNDS):
        base = _nearest(np.einsum("bij,bkj->ik", measured, links @ tool))
        tool = _nearest(np.einsum("bji,bjk->ik", base @ links, measured))
        now = float(np.sum((base @ links @ tool - measured) ** 2))
        if last - now < 1e-9 * now:
            break
        last = now
    away = Rotation.from_matrix(base @ links @ tool).inv() * Rotation.from_matrix(measured)
    return float(np.sqrt(np.mean(away.magnitude() ** 2)))


def _starts() -> list[Array]:
    """Return the 24 rotations of a cube."""
    found = [
        np.array(signs)[:, None] * np.eye(3)[list(axes)]
        for axes in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return [own for own in found if np.linalg.det(own) > 0.0]


def _nearest(total: NDArray) -> Array:
    left, _, right = np.linalg.svd(total)
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)


def _spread(turned: NDArray) -> float:
    """Return the rms angle, rad, of orientations (B, 3, 3) about their mean."""
    mean = _nearest(turned.sum(0))
    return float(np.sqrt(np.mean(Rotation.from_matrix(mean.T @ turned).magnitude() ** 2)))
