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
from truing.belonging.relation import RecordSlip, RotationForm
from truing.belonging.rotation_writing import (
    INVERTED,
    WrittenRotations,
    otherwise_written,
    rotation_slip,
    written_otherwise_in_part,
)
from truing.belonging.slips_in_rows import Agreement, slipped_rows

# Misfit, as a share of the spread of orientations, and least size, rad, above which they do not belong to the links:
# far beyond zeros of joints that a calibration finds.
_FOREIGN, _LEAST = 0.1, 0.05
# The same where a slip explains the misfit: rotation vectors and Euler angles differ little if all turns are small.
_NOTABLE, _LEAST_NOTABLE = 0.02, 0.005
_EXPLAINED = 0.2  # of the misfit: what a slip may leave
_ROUNDS, _MOST_ROUNDS, _MOST_POSES = 40, 2000, 200  # slow where orientations spread little
_FAR, _MOST_STRAY = 5.0, 0.1  # typical misfits beyond which a row is stray, and the largest share of such rows
_ALIKE = 4.0  # traces of rotations from pose to pose that differ by more times the limit, rad, are of other rotations
_POSITIONS, _POSES = "measured positions", "measured poses"
_TURNED = 0.35  # rad: frames that differ by less do so by wrong zeros, by more through a slip
# Rows that agree: fewest, least share, stretches and random draws that are tried, with their sizes.
_FEWEST_AGREE, _LEAST_SHARE, _STRETCHES, _FEWEST_DRAWN, _MOST_FITTED = 6, 0.2, 12, 4, 30
_ROUNDS_OF_SETS, _NEARLY_HALF = 5, 0.4  # a share that hardly another set of rows exceeds
_SETTLED = 1e-4  # share by which a round of a fit improves it at least


@dataclass(frozen=True)
class TurningMisfit:
    """Misfit of orientations, its limit and that without the slips, rad; ``slips`` explain them equally well.

    ``stray``: rows (B,) far from the others, which do not count. ``apart``: where orientations turn with the links, but
    measured positions contradict them or the links, the misfit, rad, of orientations on the base that positions fit;
    None elsewhere. ``apart_after``: that without the slips. ``rows``: rows (B,) that the slips concern, and those that
    are right as recorded; None where slips concern all. ``notable``: misfit, rad, from which on slips are sought.
    """

    before: float
    limit: float
    after: float
    slips: tuple[RecordSlip, ...]
    stray: Mask
    apart: float | None = None
    apart_after: float | None = None
    rows: tuple[Mask, Mask] | None = None
    notable: float = 0.0


def turning_misfit(
    links: NDArray, written: WrittenRotations, positions: tuple[NDArray, NDArray] | None = None
) -> TurningMisfit:
    """Compare orientations of a link (B, 3, 3) by the chain with measured ones; seek slips if they differ.

    Base and tool are turned so that they fit best. ``positions``: those of the link by the chain (B, 3), and as
    measured (B, 3), m. Where several slips explain the orientations, as cyclic exchanges of the axes do, positions
    decide.
    """
    turning = _of_all(links, written, positions)
    if turning.slips or not (turning.stray.any() or turning.before > turning.notable):
        return turning
    return _in_some_rows(links, written, positions, turning) or turning


def _of_all(
    links: NDArray, written: WrittenRotations, positions: tuple[NDArray, NDArray] | None = None
) -> TurningMisfit:
    """Compare orientations with the chain, and seek a slip in all of them."""
    measured = written.R
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
    links, measured, written = links[few], measured[few], written.subset(few)
    near = None if positions is None else (positions[0][few], positions[1][few])
    before = _rms(_angles(frames, links, measured))
    if before <= notable:
        turning = TurningMisfit(before, limit, before, (), stray, notable=notable)
        return turning if near is None else _placed_misfit(turning, links, written, near)
    enough = min(_EXPLAINED * before, limit)
    tried = [
        (slip, other, _places(links, other, enough))
        for slip, other in otherwise_written(written)
        if np.sqrt(np.mean((_turned(links) - _turned(other)) ** 2)) < _ALIKE * limit
    ]
    misfits = [(_rms(_angles(frames, links, other)), slip, other, frames[0]) for slip, other, frames in tried]
    misfits = [one for one in misfits if one[0] < enough]
    least = min((after for after, *_ in misfits), default=before)
    alike = [(slip, _missed(other, base, near)) for after, slip, other, base in misfits if after <= 2.0 * least]
    nearest = min((missed for _, missed in alike), default=0.0)
    slips = tuple(slip for slip, missed in alike if missed <= 2.0 * nearest)
    whole = rotation_slip(RotationForm.INVERSE, quantity=_POSES)
    if near is not None and slips and slips[0].form in INVERTED:
        inverse = np.swapaxes(measured, -1, -2)
        if _is_placed(links, near[0], -np.einsum("bij,bj->bi", inverse, near[1])) and not _is_placed(links, *near):
            slips = (whole,)
    return TurningMisfit(before, notable if slips else limit, least, slips, stray, notable=notable)


def _in_some_rows(
    links: NDArray,
    written: WrittenRotations,
    positions: tuple[NDArray, NDArray] | None,
    turning: TurningMisfit,
) -> TurningMisfit | None:
    """Return the slips in some rows that explain those that miss the base and tool of the others; None where none does,
    or where positions of these rows miss as well, as they do by wrong readings."""
    frames, near = _frames_of_most(links, written.R, turning.notable)
    if near.sum() < max(_FEWEST_AGREE, _LEAST_SHARE * len(near)):
        return None
    if positions is not None:
        frames, near = _placed_better(links, written.R, positions, (frames, near), turning.notable)
    away = _angles(frames, links, written.R)
    typical = float(np.median(away[near]))
    agreed = Agreement(np.zeros(1), away, max(_FAR * typical, turning.notable), typical)
    found = list[tuple[float, RecordSlip, Array, tuple[Mask, Mask]]]()
    for slip, other in written_otherwise_in_part(written):
        after = _angles(frames, links, other)
        rows = slipped_rows(after[:, None], np.zeros((len(after), 1)), agreed)
        if rows is not None:
            found.append((_rms(after[rows[0]]), slip, other, rows))
    if not found:
        return None
    found.sort(key=lambda one: one[0])
    least, _, other, rows = found[0]
    slips = tuple(slip for after, slip, _, (slipped, _) in found if after <= 2.0 * least and (slipped == rows[0]).all())
    if positions is not None:
        right, inverted = _missed_in_rows(links, written.R, frames, near, positions, rows[0])
        if inverted < _EXPLAINED * right:
            slips = (rotation_slip(RotationForm.INVERSE, quantity=_POSES),)
        elif right > _FAR * _missed_in_rows(links, written.R, frames, near, positions, near)[0]:
            return None
    before = _rms(away)
    return TurningMisfit(
        before, turning.notable, least, slips, np.zeros(len(near), bool), notable=turning.notable, rows=rows
    )


def _placed_better(
    links: NDArray,
    measured: NDArray,
    positions: tuple[NDArray, NDArray],
    found: tuple[tuple[Array, Array], Mask],
    notable: float,
) -> tuple[tuple[Array, Array], Mask]:
    """Return base and tool of the rows found, or of the others where these agree too and their positions fit better.

    Of an arm of parallel axes, inverse orientations agree among themselves.
    """
    frames, near = found
    if (~near).sum() < _FEWEST_AGREE:
        return found
    other = _places(links[~near], measured[~near], notable)
    others = _angles(other, links, measured) <= notable
    if others.sum() < max(_FEWEST_AGREE, _LEAST_SHARE * len(near)):
        return found
    missed = [
        _missed_in_rows(links, measured, *part, positions, part[1])[0] for part in ((frames, near), (other, others))
    ]
    return (other, others) if missed[1] < _EXPLAINED * missed[0] else found


def _missed_in_rows(
    links: NDArray,
    measured: NDArray,
    frames: tuple[Array, Array],
    near: Mask,
    positions: tuple[NDArray, NDArray],
    rows: Mask,
) -> tuple[float, float]:
    """Return the rms distances, m, of some rows' positions (B, 3) as recorded and of inverse poses; rows ``near`` place
    base and tool."""
    on_base, seen = frames[0] @ links, positions[1]
    about = seen - positions[0] @ frames[0].T
    design = np.concatenate([np.broadcast_to(np.eye(3), links.shape), on_base], axis=2)
    places = np.linalg.lstsq(design[near].reshape(-1, 6), about[near].ravel(), rcond=None)[0]
    by_chain = positions[0] @ frames[0].T + design @ places
    inverse = -np.einsum("bji,bj->bi", measured, seen)
    return _rms((seen - by_chain)[rows]), _rms((inverse - by_chain)[rows])


def _frames_of_most(links: NDArray, measured: NDArray, notable: float) -> tuple[tuple[Array, Array], Mask]:
    """Return base and tool (3, 3) of the largest set of rows that agree within ``notable``, rad, and this set (B,)."""
    best, near = (np.eye(3), np.eye(3)), np.zeros(len(links), bool)
    for chosen in _windows(len(links)):
        frames = _places(links[chosen], measured[chosen], notable)
        agree = _angles(frames, links, measured) <= notable
        if agree.sum() > near.sum():
            best, near = frames, agree
        if near.mean() > _NEARLY_HALF:
            break
    for _ in range(_ROUNDS_OF_SETS if near.any() else 0):
        bases, tools = _fitted(links[near], measured[near], best[1][None])
        best = bases[0], tools[0]
        agree = _angles(best, links, measured) <= notable
        if (agree == near).all():
            break
        near = agree
    return best, near


def _windows(count: int) -> Iterator[NDArray]:
    """Yield rows to which base and tool are fitted: stretches, every second and third row, and random ones."""
    length = max(_FEWEST_AGREE, count // 5)
    for first in np.unique(np.linspace(0, max(count - length, 0), _STRETCHES).astype(int)).tolist():
        yield np.arange(first, min(first + length, count))
    for step in (2, 3):
        for first in range(step):
            yield np.arange(first, count, step)[:_MOST_FITTED]
    rng = np.random.default_rng(0)
    for _ in range(_STRETCHES):
        yield rng.permutation(count)[:_FEWEST_DRAWN]


def _placed_misfit(
    turning: TurningMisfit, links: NDArray, written: WrittenRotations, near: tuple[NDArray, NDArray]
) -> TurningMisfit:
    """Return the misfit of orientations on the base that positions fit, if it is large; with slips that explain it.

    Each may fit the chain in a frame of its own, though both are of one instrument: cyclic exchanges of axes only turn
    the frame of orientations. ``near``: positions by the chain and as measured (B, 3), m.
    """
    measured, (by_chain, seen) = written.R, near
    base, alone = _alone(links, by_chain, seen)
    missed = _missed_angle(base, links, measured)
    if alone > _FOREIGN * _about_mean(seen):
        turned = np.einsum("bij,bj->bi", measured, seen)
        for form, places in ((RotationForm.BODY_AXES, turned), (RotationForm.OF_INVERSE, -turned)):
            base, alone = _alone(links, by_chain, places)
            after = _missed_angle(base, links, measured)
            if alone < _EXPLAINED * _FOREIGN * _about_mean(places) and after < _TURNED:
                slip = rotation_slip(form, quantity=_POSITIONS)
                return replace(turning, slips=(slip,), apart=missed, apart_after=after)
        return turning
    if missed < _TURNED:
        return turning
    found = list[tuple[float, RecordSlip]]()
    for slip, other in (*_cycled(measured, written.euler), *otherwise_written(written)):
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
    """Return the base (3, 3) that fits measured positions (B, 3) with a place of the tool, and their rms distance,
    m."""
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
        for axes, shift in (("yzx", 1), ("zxy", 2)):
            order = np.roll(np.eye(3), shift, axis=0)
            yield rotation_slip(RotationForm.AXES, axes), order @ measured @ order.T


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
