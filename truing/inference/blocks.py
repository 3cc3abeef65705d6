"""Epochs in blocks that belong together: which grouping of a campaign can be left out block by block."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from truing.inference.arrays import Array, Integers

# A block holds so many epochs at least, and no more than this share of all; as many blocks, with this share of all.
_FEWEST_IN_BLOCK, _MOST_OF_ALL, FEWEST_BLOCKS, _LEAST_TOGETHER = 4, 0.5, 3, 2.0 / 3.0
_MOST_BLOCKS = 12  # of more, several are left out together
_HALVINGS = 2  # of a workspace, one after the other: four regions
_PAUSE_S = 6 * 3600.0  # between two days of measurement


class BlockKind(StrEnum):
    """What the epochs of a block have in common; the farther from any other epoch, the earlier."""

    SERIES = "series"
    RUN = "run"
    DAY = "day"
    DIRECTION = "direction"
    REGION = "region"


@dataclass(frozen=True)
class EpochBlocks:
    """Which block each epoch (B,) is of, by number, -1 for none; what the epochs of a block have in common."""

    kind: BlockKind
    numbers: Integers

    @property
    def count(self) -> int:
        """How many blocks there are."""
        return int(self.numbers.max(initial=-1)) + 1


def possible_blocks(groupings: Mapping[BlockKind, Integers], epochs: int) -> list[EpochBlocks]:
    """Return the groupings (B,), -1 for none, that can be left out block by block, in the order of their kinds.

    They have three blocks or more, each of four epochs or more and of at most half of all, and two thirds of the epochs
    in them.
    """
    numbered = ((kind, _large_enough(groupings[kind], epochs)) for kind in BlockKind if kind in groupings)
    return [EpochBlocks(kind, numbers) for kind, numbers in numbered if numbers is not None]


def _large_enough(groups: Integers, epochs: int) -> Integers | None:
    """Return the groups (B,) that are large enough, numbered anew, -1 for none; None where they are no blocks."""
    kept, counts = np.unique(groups[groups >= 0], return_counts=True)
    kept, counts = kept[counts >= _FEWEST_IN_BLOCK], counts[counts >= _FEWEST_IN_BLOCK]
    if len(kept) < FEWEST_BLOCKS or counts.max() > _MOST_OF_ALL * epochs or counts.sum() < _LEAST_TOGETHER * epochs:
        return None
    place = np.searchsorted(kept, groups).clip(0, len(kept) - 1)
    number = place if len(kept) <= _MOST_BLOCKS else place * _MOST_BLOCKS // len(kept)
    return np.asarray(np.where(kept[place] == groups, number, -1))


def regions(inputs: Array) -> Integers:
    """Return the region (B,) of each epoch by its inputs (B, D), by number.

    The inputs are halved at the median across their longest extension, then each half in turn; what is in one place is
    in one region.
    """
    spread = np.ptp(inputs, axis=0)
    scaled = inputs / np.where(spread > 0.0, spread, 1.0)
    found = np.zeros(len(inputs), int)
    for _ in range(_HALVINGS):
        upper = np.zeros(len(inputs), int)
        for number in np.unique(found):
            own = np.flatnonzero(found == number)
            upper[own] = _upper_half(scaled[own])
        found = 2 * found + upper
    return np.unique(found, return_inverse=True)[1]


def _upper_half(places: Array) -> Integers:
    """Return which places (B, D) lie beyond the median along their longest extension."""
    centred = places - places.mean(0)
    along = np.round(centred @ np.linalg.svd(centred, full_matrices=False)[2][0], 9)
    return np.asarray(along > np.median(along), int)


def days(time_s: Array) -> Integers:
    """Return the day (B,) of each epoch, by number: where nothing was measured for a quarter of a day, the next begins.

    Epochs without a time have none, -1.
    """
    known = np.isfinite(time_s)
    found = np.full(len(time_s), -1)
    order = np.argsort(time_s[known], kind="stable")
    begins = np.concatenate([[0], (np.diff(time_s[known][order]) > _PAUSE_S).cumsum()]) if known.any() else np.zeros(0)
    found[np.flatnonzero(known)[order]] = begins
    return found


def group_numbers(columns: Array) -> Integers:
    """Return a number (B,) for each epoch, the same for equal columns (B, D); -1 where a column holds none."""
    known = np.isfinite(columns).all(1)
    found = np.full(len(columns), -1)
    if known.any():
        found[known] = np.unique(columns[known], axis=0, return_inverse=True)[1].ravel()
    return found
