"""Test of declared masses and their centres against the size of a chain: slips between g, N and kg, m and mm.

The bounds are properties of matter and of known arms. Within them, pounds and newtons in place of kilograms look like a
heavier arm or payload. These slips are listed as not detectable here; the deflections show the ratio of payload and
masses (cause weight-factor).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from truing.arrays import Array
from truing.belonging.relation import RecordSlip, RelationState, RelationTest, SlipKind

WEIGHTS = "masses-against-lengths"
_STEEL = 7850.0  # kg/m^3: no arm is as heavy as a cube of steel as long as its reach
_PAYLOAD = 500.0  # kg/m^3: the same for a payload; known arms carry at most a thirtieth of that
_MOST_CARRIED = 10.0  # times the mass of all links that an arm carries at most
_USUALLY_CARRIED = 1.0  # times that mass: known arms carry a tenth to a half of it, few more than all of it
_SHORTEST = 0.2  # m: reach below which nothing is tested
_FARTHEST, _NEAREST = 3.0, 1e-3  # reaches: no centre of mass is farther off, and not all are so near
_FEWEST = 3  # centres that are all too near
_NEAREST_PAYLOAD = 2e-4  # m: nobody gives the centre of a payload to less than that
_LONG = 0.1  # share of the reach from which a link is long
_BEHIND = 0.25  # share of a long link's length: counterweights and motors shift its centre behind its joint by less
_GRAMS, _MILLI = 1e-3, 1e-3
_NEWTON = 1.0 / 9.80665
_MASSES, _PAYLOAD_KG = "masses of links", "payload_kg"


@dataclass(frozen=True)
class Weights:
    """Declared masses (N,), kg, and centres (N, 3), m, of links, those of the payload, and the reach of a chain, m.

    ``com`` and ``payload_com`` are zero where no centre is declared. ``is_complete``: every link that moves has a mass.
    ``ends`` (N, 3), m: the next joint of each link, in the frame of ``com``; ``links`` (N,): their names.
    """

    mass: Array
    com: Array
    payload_kg: float
    payload_com: Array
    reach: float
    is_complete: bool = False
    ends: Array | None = None
    links: Sequence[str] = ()


def relate_weights(weights: Weights) -> RelationTest:
    """Return the test of masses and centres of mass by the reach of the chain."""
    if not (weights.mass.any() or weights.payload_kg) or weights.reach < _SHORTEST:
        return RelationTest(WEIGHTS, RelationState.NOT_TESTED, "no-masses")
    slips = tuple(_slips(weights))
    if slips:
        return RelationTest(WEIGHTS, RelationState.FAILS, "slip", "", float(len(slips)), None, 0.0, "1", slips)
    declared = ((_MASSES, weights.mass.any()), (_PAYLOAD_KG, weights.payload_kg))
    unseen = tuple(RecordSlip(SlipKind.UNIT, quantity, dimension="mass") for quantity, has in declared if has)
    carried = weights.payload_kg / float(weights.mass.sum()) if weights.is_complete else 0.0
    if carried > _USUALLY_CARRIED:
        asked = (RecordSlip(SlipKind.UNIT, _PAYLOAD_KG, factor=_NEWTON, dimension="mass"),)
        sizes = ("", carried, None, _USUALLY_CARRIED, "1")
        return RelationTest(WEIGHTS, RelationState.ATTENTION, "heavy-payload", *sizes, asked, hidden=unseen)
    share, link = _farthest_behind(weights)
    if share > _BEHIND:
        sizes = (link, share, None, _BEHIND, "1")
        return RelationTest(WEIGHTS, RelationState.ATTENTION, "centre-behind", *sizes, hidden=unseen)
    return RelationTest(WEIGHTS, RelationState.OK, "agrees", "", 0.0, None, 0.0, "1", hidden=unseen)


def _farthest_behind(weights: Weights) -> tuple[float, str]:
    """Return the distance of a long link's centre of mass behind its joint, over its length, and the link: (0, empty)
    without one. So it looks where centres are declared in the frame at the end of a row."""
    if weights.ends is None:
        return 0.0, ""
    length = np.sqrt(np.sum(weights.ends**2, axis=1))
    long = (length > _LONG * weights.reach) & (weights.mass > 0.0)
    share = -np.sum(weights.com * weights.ends, axis=1) / np.where(long, length, 1.0) ** 2
    share = np.where(long, share, 0.0)
    worst = int(share.argmax())
    return float(share[worst]), weights.links[worst] if share[worst] > 0.0 else ""


def _slips(weights: Weights) -> Iterator[RecordSlip]:
    volume = weights.reach**3
    if weights.mass.sum() > _STEEL * volume:
        yield RecordSlip(SlipKind.UNIT, _MASSES, factor=_GRAMS, dimension="mass")
    most = _PAYLOAD * volume
    if weights.is_complete:
        most = min(most, _MOST_CARRIED * float(weights.mass.sum()))
    if weights.payload_kg > most:
        yield RecordSlip(SlipKind.UNIT, _PAYLOAD_KG, factor=_GRAMS, dimension="mass")
    distance = np.sqrt(np.sum(weights.com**2, axis=1))
    distance = distance[distance > 0.0]
    yield from _of_centres("centres of mass of links", distance, weights.reach, _NEAREST * weights.reach, _FEWEST)
    payload = np.sqrt(np.sum(np.atleast_2d(weights.payload_com) ** 2, axis=1))
    yield from _of_centres("payload_com_mm", payload[payload > 0.0], weights.reach, _NEAREST_PAYLOAD, 1)


def _of_centres(quantity: str, distance: Array, reach: float, nearest: float, fewest: int) -> Iterator[RecordSlip]:
    if len(distance) and distance.max() > _FARTHEST * reach:
        yield RecordSlip(SlipKind.UNIT, quantity, factor=_MILLI)
    elif len(distance) >= fewest and distance.max() < nearest:
        yield RecordSlip(SlipKind.UNIT, quantity, factor=1.0 / _MILLI)
