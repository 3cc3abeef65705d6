"""Do measured orientations turn with the links of a chain, in the frame of the measured positions; and slips in how
rotations and poses were written down."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
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
_MEASURED, _POSITIONS, _POSES = "measured orientations", "measured positions", "measured poses"
_BODY_AXES, _OF_INVERSE = "body axes", "of the inverse"
_INVERTED = ("inverse", "inversion")
_TURNED = 0.35  # rad: frames that differ by less do so by wrong zeros, by more through a slip
_SETTLED = 1e-4  # share by which a round of a fit improves it at least


@dataclass(frozen=True)
class TurningMisfit:
    """Misfit of orientations, its limit and that without the slips, rad; ``slips`` explain them equally well.

    ``stray``: rows (B,) far from the others, which do not count. ``apart``: where orientations turn with the links, but
    measured positions contradict them or the links, the misfit, rad, of orientations on the base that positions fit;
    None elsewhere. ``apart_after``: that without the slips.
    """

    before: float
    limit: float
    after: float
    slips: tuple[RecordSlip, ...]
    stray: Mask
    apart: float | None = None
    apart_after: float | None = None


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
        turning = TurningMisfit(before, limit, before, (), stray)
        return turning if near is None else _placed_misfit(turning, links, measured, euler, near)
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
    whole = _slip("inverse", _POSES)
    if near is not None and slips and slips[0].subjects[0] in _INVERTED:
        inverse = np.swapaxes(measured, -1, -2)
        if _is_placed(links, near[0], -np.einsum("bij,bj->bi", inverse, near[1])) and not _is_placed(links, *near):
            slips = (whole,)
    return TurningMisfit(before, notable if slips else limit, least, slips, stray)


def _placed_misfit(
    turning: TurningMisfit, links: NDArray, measured: NDArray, euler: str | None, near: tuple[NDArray, NDArray]
) -> TurningMisfit:
    """Return the misfit of orientations on the base that positions fit, if it is large; with slips that explain it.

    Each may fit the chain in a frame of its own, though both are of one instrument: cyclic exchanges of axes only turn
    the frame of orientations. ``near``: positions by the chain and as measured (B, 3), m.
    """
    by_chain, seen = near
    base, alone = _alone(links, by_chain, seen)
    missed = _missed_angle(base, links, measured)
    if alone > _FOREIGN * _about_mean(seen):
        turned = np.einsum("bij,bj->bi", measured, seen)
        for written, places in ((_BODY_AXES, turned), (_OF_INVERSE, -turned)):
            base, alone = _alone(links, by_chain, places)
            after = _missed_angle(base, links, measured)
            if alone < _EXPLAINED * _FOREIGN * _about_mean(places) and after < _TURNED:
                return replace(turning, slips=(_slip(written, _POSITIONS),), apart=missed, apart_after=after)
        return turning
    if missed < _TURNED:
        return turning
    found = list[tuple[float, RecordSlip]]()
    for slip, other in (*_cycled(measured, euler), *otherwise_written(measured, euler)):
        after = _missed_angle(base, links, other)
        if after < _EXPLAINED * missed:
            found.append((after, slip))
    least = min((after for after, _ in found), default=missed)
    slips = tuple(slip for after, slip in found if after <= 2.0 * least)
    return replace(turning, slips=slips, apart=missed, apart_after=least if slips else None)


def _missed_angle(base: Array, links: NDArray, measured: NDArray) -> float:
    """Return the rms angle, rad, of measured orientations (B, 3, 3) from the links on a base, with the best tool."""
    on_base = base @ links
    return _rms(_angles((base, _nearest(np.einsum("bji,bjk->ik", on_base, measured))), links, measured))


def _is_placed(links: NDArray, by_chain: NDArray, seen: NDArray) -> bool:
    """Return True where measured positions (B, 3) follow the link, on a free base and with a free tool."""
    return _alone(links, by_chain, seen)[1] <= _FOREIGN * _about_mean(seen)


def _about_mean(values: NDArray) -> float:
    return _rms(values - values.mean(axis=0)) * np.sqrt(3.0)


def _alone(links: NDArray, by_chain: NDArray, seen: NDArray) -> tuple[Array, float]:
    """Return the base (3, 3) that measured positions (B, 3) fit, with the place of the tool, and their rms distance, m,
    from the chain on it."""
    tool, about, base, away = np.zeros(3), seen - seen.mean(axis=0), np.eye(3), np.inf
    for _ in range(_ROUNDS):
        places = by_chain + links @ tool
        places = places - places.mean(axis=0)
        base = _nearest(about.T @ places)
        last, away = away, float(np.sqrt(np.mean(np.sum((about - places @ base.T) ** 2, axis=1))))
        if last - away <= _SETTLED * away:
            break
        rest = seen @ base - by_chain
        design = np.concatenate([np.broadcast_to(np.eye(3), links.shape), links], axis=2).reshape(-1, 6)
        tool = np.linalg.lstsq(design, rest.ravel(), rcond=None)[0][3:]
    return base, away


def _cycled(measured: NDArray, euler: str | None) -> Iterator[tuple[RecordSlip, Array]]:
    """Yield orientations (B, 3, 3) whose components along x, y and z were moved on by one, or by two."""
    if euler is None:
        for written, shift in (("components yzx", 1), ("components zxy", 2)):
            order = np.roll(np.eye(3), shift, axis=0)
            yield _slip(written), order @ measured @ order.T


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


def _slip(written: str, quantity: str = _MEASURED) -> RecordSlip:
    return RecordSlip(SlipKind.ROTATION, quantity, (written,))


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
    first, *others = _starts()  # the first is often enough; the others are fitted at once
    for tools in (first[None], np.stack(others)):
        bases, tools = _fitted(links, measured, tools)
        for frames in zip(bases, tools, strict=True):
            candidates.append((_rms(_angles(frames, links, measured)), frames))
            if candidates[-1][0] <= enough:
                bases, tools = _fitted(links, measured, frames[1][None], _MOST_ROUNDS)
                return bases[0], tools[0]
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


def _fitted(links: NDArray, measured: NDArray, tools: Array, rounds: int = _ROUNDS) -> tuple[Array, Array]:
    """Return bases and tools (n, 3, 3) after alternating Procrustes fits from each of n rotations of the tool."""
    bases, tools = np.broadcast_to(np.eye(3), tools.shape).copy(), tools.copy()
    moving, last = np.arange(len(tools)), np.full(len(tools), np.inf)
    # The sums over orientations of measured @ (links @ tool).T and of (base @ links).T @ measured, as products.
    of_base = np.einsum("bij,bkl->ikjl", measured, links).reshape(9, 9)
    of_tool = of_base.reshape(3, 3, 3, 3).transpose(3, 2, 0, 1).reshape(9, 9)
    for _ in range(rounds):
        base = _nearest((of_base @ np.swapaxes(tools[moving], 1, 2).reshape(-1, 9).T).T.reshape(-1, 3, 3))
        tool = _nearest((of_tool @ base.reshape(-1, 9).T).T.reshape(-1, 3, 3))
        bases[moving], tools[moving] = base, tool
        now = np.sum((base[:, None] @ links @ tool[:, None] - measured) ** 2, axis=(1, 2, 3))
        goes_on = last - now >= 1e-9 * now
        moving, last = moving[goes_on], now[goes_on]
        if not len(moving):
            break
    return bases, tools


def _starts() -> list[Array]:
    """Return the 24 rotations of a cube."""
    rotations = [
        np.array(signs)[:, None] * np.eye(3)[list(axes)]
        for axes in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return [rotation for rotation in rotations if np.linalg.det(rotation) > 0.0]


def _nearest(total: NDArray) -> Array:
    """Return the rotations (..., 3, 3) nearest to matrices."""
    left, _, right = np.linalg.svd(total)
    left[..., 2] *= np.linalg.det(left @ right)[..., None]
    return np.asarray(left @ right)


def _spread(turned: NDArray) -> float:
    """Return the rms angle, rad, of orientations (B, 3, 3) about their mean."""
    mean = _nearest(turned.sum(0))
    return _rms(Rotation.from_matrix(mean.T @ turned).magnitude())
