"""Slips in some rows of a table of readings: which rows agree with their poses, and where those that do not stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

_FEWEST, _FEWEST_APART = 4, 3  # rows that agree, and rows that do not
_LEAST_SHARE = 0.2  # of all rows agree: fewer may do so by chance
_NEAR = 0.3  # of the movement: rows that miss by about the same
_MOST_CENTRES = 200  # rows around which others are looked for
_FAR = 10.0  # typical misfits of rows that agree, from which on a row does not
_CLEARLY = 0.2  # of the movement
_HALF = 0.5  # of the misfit: what decides whether a row is better with the slip undone
_LEFT = (3.0, 0.1)  # what undone rows miss by at most: over that of rows that agree, and of their own misfit before
_EXPLAINED = 0.9  # of the rows that do not agree
_MOST_STRETCHES = 3


@dataclass(frozen=True)
class Agreement:
    """Rows that agree but for one offset (L,), m; distance (B,) of every row, its ``limit``, and the typical one."""

    offset: Array
    distance: Array
    limit: float
    typical: float

    @property
    def apart(self) -> Index:
        """Return the rows that do not agree."""
        return np.flatnonzero(self.distance > self.limit)


def agreement(readings: Array, asked: Array, noise: float) -> Agreement | None:
    """Return how the largest set of rows that agree does so, readings and asked (B, L) in m; None where all rows do.

    Rows agree where they miss what their poses ask for by about the same offset.
    """
    misfit = readings - asked
    moved = float(np.sqrt(np.mean((asked - asked.mean(axis=0)) ** 2)))
    near = max(_NEAR * moved, 3.0 * noise)
    centres = misfit[:: -(-len(misfit) // _MOST_CENTRES)]
    sizes = [int(np.sum(_distance(misfit, centre) < near)) for centre in centres]
    best = centres[int(np.argmax(sizes))]
    members = _distance(misfit, best) < near
    if members.sum() < max(_FEWEST, _LEAST_SHARE * len(misfit)):
        return None
    offset = np.median(misfit[members], axis=0)
    distance = _distance(misfit, offset)
    typical = max(float(np.median(distance[members])), noise)
    found = Agreement(offset, distance, max(_FAR * typical, _CLEARLY * moved), typical)
    return found if len(found.apart) >= _FEWEST_APART else None


def _distance(misfit: Array, offset: Array) -> Array:
    return np.asarray(np.sqrt(np.mean((misfit - offset) ** 2, axis=1)))


def slipped_rows(undone: Array, asked: Array, agreed: Agreement) -> tuple[Mask, Mask] | None:
    """Return the rows (B,) that a slip concerns and those that it does not; None where it does not explain the rest.

    undone (B, L): all readings with the slip undone. Rows in which it makes no difference are in neither.
    """
    after = _distance(undone - asked, agreed.offset)
    before = agreed.distance
    slipped, kept = after < _HALF * before, before < _HALF * after
    slipped &= before > _FAR * agreed.typical
    if slipped.sum() < _FEWEST_APART or not kept.any():
        return None
    least = max(_LEFT[0] * _rms(before[kept & (before <= agreed.limit)]), _LEFT[1] * _rms(before[slipped]))
    apart = before > agreed.limit
    explained = np.mean((slipped & (after <= agreed.limit))[apart])
    return (slipped, kept) if _rms(after[slipped]) <= least and explained >= _EXPLAINED else None


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def places(slipped: Mask, kept: Mask, poses: Sequence[str], groups: Sequence[tuple[str, Sequence[str]]]) -> list[str]:
    """Return where rows (B,) that slipped stand: a group, a few stretches, a regular pattern, or each by its name.

    groups: name of a column and its value in each row.
    """
    named = [one for name, values in groups for one in _whole_groups(name, np.asarray(values), slipped, kept)]
    stretches = _stretches(slipped, kept)
    if len(stretches) <= _MOST_STRETCHES:
        return [*named, *(_stretch(first, last, poses) for first, last in stretches)]
    at = np.flatnonzero(slipped)
    step = int(np.gcd.reduce(np.diff(at)))
    if step > 1 and not kept[np.arange(at[0], at[-1] + 1, step)].any():
        return [*named, f"every {_NTH.get(step, f'{step}th')} pose from {poses[at[0]]} to {poses[at[-1]]}"]
    return named or [_stretch(first, last, poses) for first, last in stretches]


def _whole_groups(name: str, values: NDArray[np.str_], slipped: Mask, kept: Mask) -> list[str]:
    """The values of a column whose rows are those that slipped, and no others."""
    own = list(dict.fromkeys(values[slipped].tolist()))
    inside = np.isin(values, own)
    return [] if (inside & kept).any() or not (~inside & kept).any() else [f"{name} {one}" for one in own]


_NTH = {2: "second", 3: "third", 4: "fourth", 5: "fifth"}


def _stretches(slipped: Mask, kept: Mask) -> list[tuple[int, int]]:
    """First and last of the rows that slipped and follow each other, with none between that did not."""
    found: list[tuple[int, int]] = []
    for row in np.flatnonzero(slipped).tolist():
        if found and not kept[found[-1][1] : row].any():
            found[-1] = (found[-1][0], row)
        else:
            found.append((row, row))
    return found


def _stretch(first: int, last: int, poses: Sequence[str]) -> str:
    if first == last:
        return f"pose {poses[first]}"
    if last == len(poses) - 1:
        return f"from pose {poses[first]} on"
    return f"up to pose {poses[last]}" if first == 0 else f"from pose {poses[first]} to pose {poses[last]}"
