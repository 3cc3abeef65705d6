"""Groupings of epochs into blocks (series, runs, days, directions, regions) that can be left out block by block."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from truing.inference.arrays import Array, Integers

# Fewest epochs in a block, largest share of all epochs in one block, fewest blocks, least share of epochs in blocks.
_FEWEST_IN_BLOCK, _MOST_OF_ALL, FEWEST_BLOCKS, _LEAST_TOGETHER = 4, 0.5, 3, 2.0 / 3.0
_MOST_BLOCKS = 12  # where there are more, several are left out together
_HALVINGS = 2  # successive halvings of the inputs' range: four regions
_PAUSE_S = 6 * 3600.0  # between two days of measurement


class BlockKind(StrEnum):
    """Property that the epochs of a block have in common; kinds whose blocks are farther apart come first."""

    SERIES = "series"
    RUN = "run"
    DAY = "day"
    DIRECTION = "direction"
    REGION = "region"


@dataclass(frozen=True)
class EpochBlocks:
    """Block number (B,) of each epoch, -1 for none, and the kind of the blocks."""

    kind: BlockKind
    numbers: Integers

    @property
    def count(self) -> int:
        """Number of blocks."""
        return int(self.numbers.max(initial=-1)) + 1


def possible_blocks(groupings: Mapping[BlockKind, Integers], epochs: int) -> list[EpochBlocks]:
    """Return the groupings (B,), -1 for none, that can be left out block by block, in the order of their kinds.

    Such a grouping has at least three blocks, which hold at least two thirds of all epochs. Each block has at least
    four epochs, and at most half of all epochs.
    """
    numbered = ((kind, _large_enough(groupings[kind], epochs)) for kind in BlockKind if kind in groupings)
    return [EpochBlocks(kind, numbers) for kind, numbers in numbered if numbers is not None]


def _large_enough(groups: Integers, epochs: int) -> Integers | None:
    """Return the groups (B,) that are large enough, renumbered, -1 for none; None where they do not qualify
    as blocks."""
    large, counts = np.unique(groups[groups >= 0], return_counts=True)
    large, counts = large[counts >= _FEWEST_IN_BLOCK], counts[counts >= _FEWEST_IN_BLOCK]
    if len(large) < FEWEST_BLOCKS or counts.max() > _MOST_OF_ALL * epochs or counts.sum() < _LEAST_TOGETHER * epochs:
        return None
    index = np.searchsorted(large, groups).clip(0, len(large) - 1)
    number = index if len(large) <= _MOST_BLOCKS else index * _MOST_BLOCKS // len(large)
    return np.asarray(np.where(large[index] == groups, number, -1))


def regions(inputs: Array) -> Integers:
    """Return the number (B,) of the region of inputs (B, D) in which each epoch lies.

    The inputs are halved at the median across their longest extension, then each half again; equal inputs share a
    region.
    """
    spread = np.ptp(inputs, axis=0)
    scaled = inputs / np.where(spread > 0.0, spread, 1.0)
    region = np.zeros(len(inputs), int)
    for _ in range(_HALVINGS):
        upper = np.zeros(len(inputs), int)
        for number in np.unique(region):
            members = np.flatnonzero(region == number)
            upper[members] = _upper_half(scaled[members])
        region = 2 * region + upper
    return np.unique(region, return_inverse=True)[1]


def _upper_half(places: Array) -> Integers:
    """Return 1 for places (B, D) beyond the median along their longest extension, otherwise 0."""
    centred = places - places.mean(0)
    along = np.round(centred @ np.linalg.svd(centred, full_matrices=False)[2][0], 9)
    return np.asarray(along > np.median(along), int)


def days(time_s: Array) -> Integers:
    """Return the number (B,) of the day of each epoch; a pause of six hours begins a new day.

    Epochs without a time have -1.
    """
    known = np.isfinite(time_s)
    day = np.full(len(time_s), -1)
    order = np.argsort(time_s[known], kind="stable")
    begins = np.concatenate([[0], (np.diff(time_s[known][order]) > _PAUSE_S).cumsum()]) if known.any() else np.zeros(0)
    day[np.flatnonzero(known)[order]] = begins
    return day


def group_numbers(columns: Array) -> Integers:
    """Return a number (B,) for each epoch, the same for equal columns (B, D); -1 where a column holds none."""
    known = np.isfinite(columns).all(1)
    numbers = np.full(len(columns), -1)
    if known.any():
        numbers[known] = np.unique(columns[known], axis=0, return_inverse=True)[1].ravel()
    return numbers
