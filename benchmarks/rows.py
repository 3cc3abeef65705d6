"""Rows of the table of all benchmarks: ours, the best peer, their ratio and the limit.

A benchmark hands rows to ``record_row``. ``python -m benchmarks`` collects them through a file that it names in the
environment, because benchmarks measure in processes of their own.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Collection, Iterable, Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

FILE = "TRUING_BENCHMARK_ROWS"  # environment variable with the path of the file of rows
_PER_SECOND = {"s": 1.0, "ms": 1e3, "µs": 1e6, "ns": 1e9}


class Holds(StrEnum):
    """State of a row's limit: kept, exceeded, or open."""

    YES = "yes"
    NO = "no"
    OPEN = "open"  # a peer is unmeasured, and those that were measured do not exceed the limit
    NO_LIMIT = "no limit"


class PeerState(StrEnum):
    """True if a peer was measured."""

    MEASURED = "measured"
    UNMEASURED = "unmeasured"  # not installed here
    MISSED = "missed"  # did not solve the problem, so that there is no ratio


@dataclass(frozen=True)
class Peer:
    """Another library: its value, how many times better ours is (median over repeats), and whether it was measured."""

    name: str
    value: float | None = None
    ratio: float | None = None
    state: PeerState = PeerState.UNMEASURED


@dataclass(frozen=True)
class Row:
    """One figure of ours in a unit, with its peers.

    ``least_ratio``: limit of the ratio to the best peer; ``limit``: limit of the value itself.
    """

    what: str
    value: float
    unit: str
    peers: tuple[Peer, ...] = ()
    least_ratio: float | None = None
    limit: float | None = None
    more_is_better: bool = False

    @property
    def best(self) -> Peer | None:
        """The peer over which ours has the smallest advantage; None if none was measured."""
        return min((peer for peer in self.peers if peer.ratio is not None), key=_ratio, default=None)

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Names of peers that were not measured, which are neither beaten nor better."""
        return tuple(peer.name for peer in self.peers if peer.state == PeerState.UNMEASURED)

    @property
    def holds(self) -> Holds:
        """State of the limits; open if a peer is unmeasured."""
        if self.limit is None and self.least_ratio is None:
            return Holds.NO_LIMIT
        if self.limit is not None and not _within(self.value, self.limit, self.more_is_better):
            return Holds.NO
        if self.least_ratio is None:
            return Holds.YES
        if self.best is not None and _ratio(self.best) < self.least_ratio:
            return Holds.NO
        return Holds.OPEN if self.best is None or self.unmeasured else Holds.YES

    @staticmethod
    def read(written: Mapping[str, Any]) -> Row:
        """The row as ``record_row`` wrote it."""
        return Row(**{**written, "peers": tuple(Peer(**peer) for peer in written["peers"])})


def _ratio(peer: Peer) -> float:
    return math.inf if peer.ratio is None else peer.ratio


def _within(value: float, limit: float, more_is_better: bool) -> bool:
    return value >= limit if more_is_better else value <= limit


def record_row(row: Row) -> None:
    """Add a row to the table of this call of ``python -m benchmarks``; nothing elsewhere."""
    if file := os.environ.get(FILE):
        with Path(file).open("a", encoding="utf-8") as rows:
            rows.write(json.dumps(asdict(row)) + "\n")


def timed_row(
    what: str,
    seconds: Mapping[str, np.ndarray],
    ours: str,
    *,
    unmeasured: Iterable[str] = (),
    missed: Collection[str] = (),
    own: Iterable[str] = (),
    unit: str = "ms",
    least_ratio: float | None = None,
    limit: float | None = None,
) -> Row:
    """Row from seconds (repeats,) per name, given in a unit of time; ratios are taken repeat by repeat.

    ``missed``: rows that did not solve the problem: peers get no ratio, and ours raises ValueError; ``own``: other rows
    of ours, which are no peers.
    """
    if ours in missed:
        raise ValueError(f"{what}: ours missed the solution")
    missed, skipped, times = set(missed), {ours, *own}, _PER_SECOND[unit]
    others = [
        Peer(name, times * float(np.median(s)), state=PeerState.MISSED)
        if name in missed
        else Peer(name, times * float(np.median(s)), float(np.median(s / seconds[ours])), PeerState.MEASURED)
        for name, s in seconds.items()
        if name not in skipped
    ]
    peers = (*others, *map(Peer, unmeasured))
    return Row(what, times * float(np.median(seconds[ours])), unit, peers, least_ratio, limit)
