"""Ring codes of photogrammetric targets: valid code words, and decoding of rings in a photograph.

A coded target is a dot of radius 1, a gap to radius 2, and n equal ring segments from radius 2 to 3. Segment k covers
the angles 2 pi k/n to 2 pi (k+1)/n, counted clockwise as seen from the front: in the image of an upright target from x
towards y, which points down. The word is read clockwise, the most significant bit first; a segment in the dot's colour
is a one. A rotation of the target rotates the word: all rotations are the same code, named by the smallest of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from truing.arrays import Array, Index, Mask

_ANY = "_any"
ROUND = 168  # samples around a ring: a whole number per segment for 8, 12 and 14 segments
# Share of a segment that is read: near its ends, neighbours contribute light.
_CORE = 0.6
# Levels are in units of the dot's contrast: 0 the ground, 1 the dot.
_UNCLEAR = 0.25  # distance of a segment's mean from its bit, at most
_ROUGH = 0.22  # rms of the cores of segments about the word that was read
_STRAY = 0.035  # mean square of all samples about the word, minus the part due to the blur of edges
_EDGE_SQUARE = 0.234  # residual of a blurred edge: the integral of Phi(-|t|)^2 over t
_SOMETHING = 0.6  # without a sample lighter than this there is no ring
# Test for an object that hides part of a ring: an object is rarely as light as the ground. Limits for the difference
# between the middles of unset segments, without light from set neighbours, if it and the measure of _UNCLEAR together
# exceed _DOUBTFUL (a shadow over clear segments does not); and the share of a segment that counts as its middle.
_UNEVEN, _DOUBTFUL, _MIDDLE = 0.1, 0.3, 0.4
# Visible slivers of a hidden segment near the rims of the ring: how much lighter than the ground three samples may be;
# and the distance in samples from edges between segments.
_LEFT_OVER, _NEAR_EDGE = 0.2, 4
_APART = 0.003  # relative excess of the mean square by which another number of segments must fit worse


@dataclass(frozen=True)
class RingCode:
    """The codes of a ring with some number of segments: words (W,), each the smallest of its rotations, and their
    numbers (W,).

    Vendors number differently: `RingCode.of_table` accepts another table than that of `ring_code`. The family name
    distinguishes codes with equal numbers of segments.
    """

    bits: int
    words: tuple[int, ...]
    numbers: tuple[int, ...]
    family: str

    @classmethod
    def of_table(cls, bits: int, table: Mapping[int, int], family: str) -> RingCode:
        """Return the codes of a table from word (any of its rotations) to number; ValueError if words or rotations
        clash."""
        words = [smallest_turn(word, bits) for word in table]
        if len(set(words)) != len(words):
            raise ValueError(
                f"code words of {bits} bits: found two that are rotations of each other, expected different codes"
            )
        return cls(bits, tuple(words), tuple(table.values()), family)


def smallest_turn(word: int, bits: int) -> int:
    """Return the smallest rotation of a word of some bits; ValueError if the word has more bits."""
    if not 0 <= word < 1 << bits:
        raise ValueError(f"code word: found {word}, expected 0 to {2**bits - 1} ({bits} bits)")
    return min(_rotations_of_word(word, bits))


def _rotations_of_word(word: int, bits: int) -> list[int]:
    """Return a word of some bits rotated by each number of segments."""
    mask = (1 << bits) - 1
    return [(word << k | word >> (bits - k)) & mask for k in range(bits)]


def ring_code(bits: int) -> RingCode:
    """Return the 8, 12 or 14 bit codes of industrial photogrammetry, numbered from 1 by ascending word.

    A word has an even number of ones, a pair of opposite segments that both are ones, and a zero: 13, 147 and 516
    words. DE 197 33 466 A1 (1997).
    """
    if bits not in (8, 12, 14):
        raise ValueError(f"bits: found {bits}, expected 8, 12 or 14")
    half = bits // 2
    word = np.arange(1, (1 << bits) - 1)
    turns = np.stack([(word << k | word >> (bits - k)) & ((1 << bits) - 1) for k in range(bits)])
    even = np.bitwise_count(word) % 2 == 0
    opposite = word & word >> half & ((1 << half) - 1) != 0
    words = word[even & opposite & (word == turns.min(0))].tolist()
    return RingCode(bits, tuple(words), tuple(range(1, len(words) + 1)), f"ring{bits}")


def any_word(bits: int) -> RingCode:
    """Return the codes of rings with any word except the empty one, as printed by free programs.

    The number is the smallest value of the ring when read clockwise, the least significant bit first.
    """
    words = (word for word in range(1, 1 << bits) if smallest_turn(word, bits) == word)
    return RingCode.of_table(bits, {_mirrored(word, bits): word for word in words}, f"ring{bits}{_ANY}")


@cache
def family_of_rings(name: str) -> RingCode:
    """Return a family by its name: `ring12` as published, `ring12_any` with all words; ValueError for other names."""
    bits = name.removeprefix("ring").removesuffix(_ANY)
    if not bits.isdecimal():
        raise ValueError(f"family: found {name}, expected a family of ring codes")
    return any_word(int(bits)) if name.endswith(_ANY) else ring_code(int(bits))


def _mirrored(word: int, bits: int) -> int:
    return int(format(word, f"0{bits}b")[::-1], 2)


@dataclass(frozen=True)
class RingReading:
    """Decoded rings: family (N,) and number (N,), -1 without a code; confidence (N,) from 0 to 1; ring (N, ROUND) of
    the word, 0 or 1 at every sample.

    unreadable (N,): something other than a code is there; ambiguous (N,): unreadable because the ring is a code of two
    families.
    """

    family: Index
    number: Index
    confidence: Array
    ring: Array
    unreadable: Mask
    ambiguous: Mask


def read_rings(levels: Array, codes: tuple[RingCode, ...], soft: Array | None = None) -> RingReading:
    """Return the decoded rings from levels (N, ROUND) sampled clockwise at radius 2.5.

    Levels are in units of the dot's contrast; soft (N,): blur of edges between segments, in samples. Every number of
    segments is fitted at every phase, and the best one is read. A ring is unreadable if another number of segments also
    gives a code, if a segment is undecided, or if the word is no code. So is one with edges off the segments' ends, or
    unset segments that differ as if partly hidden. A uniformly dark ring is no ring.
    """
    n = len(levels)
    if not codes or not n:
        none = np.full(n, -1)
        return RingReading(none, none, np.zeros(n), np.zeros((n, ROUND)), np.zeros(n, bool), np.zeros(n, bool))
    there = (levels > _SOMETHING).any(1)
    fits = [_fit(levels, code.bits) for code in codes]
    numbers = np.stack([_code_numbers(code, fit.word) for code, fit in zip(codes, fits, strict=True)])  # (families, N)
    left = np.stack([fit.left for fit in fits])
    # families that explain the ring almost as well as the best one, with a valid code
    meant = (left < left.min(0) + _APART) & (numbers >= 0)
    best = np.where(meant, left, np.inf).argmin(0)
    bits = np.array([code.bits for code in codes])
    rivals = (meant & (bits[:, None] != bits[best])).any(0)
    each = np.arange(n)
    names = ("ring", "off", "rough", "uneven")
    ring, off, rough, uneven = (np.stack([getattr(fit, name) for fit in fits])[best, each] for name in names)
    edges = np.count_nonzero(ring != np.roll(ring, 1, axis=1), axis=1)
    soft = np.zeros(n) if soft is None else soft
    blurred = _EDGE_SQUARE * edges * soft / ROUND
    uneven = uneven - _light_of_neighbours(ROUND / bits[best], soft)
    even = (uneven < _UNEVEN) | (off + uneven < _DOUBTFUL)
    stray = left[best, each] - np.minimum(blurred, 0.15)
    clear = there & meant.any(0) & (stray < _STRAY) & (off < _UNCLEAR) & (rough < _ROUGH) & even
    read = clear & ~rivals
    confidence = np.where(read, (1 - 2 * off) * (1 - rough), 0.0)
    return RingReading(
        np.where(read, best, -1),
        np.where(read, numbers[best, each], -1),
        confidence,
        ring * read[:, None],
        there & ~read,
        clear & rivals,
    )


def are_open(rims: Array, ring: Array) -> Mask:
    """Return the mask (N,) of rings whose unset parts, from ring (N, ROUND), are clear near the rims, by levels (N, R,
    ROUND).

    An object that hides a segment in the ground's colour usually leaves a sliver of it visible.
    """
    smooth = (np.roll(rims, 1, axis=-1) + rims + np.roll(rims, -1, axis=-1)) / 3
    turns = range(-_NEAR_EDGE, _NEAR_EDGE + 1)
    unset = np.all([np.roll(ring, k, axis=1) < 0.5 for k in turns], axis=0)
    return ~((smooth > _LEFT_OVER) & unset[:, None]).any((1, 2))


@dataclass(frozen=True)
class _Fit:
    """Fit of rings with some number of segments at the best phase: word (N,), the same as ring (N, ROUND), largest
    distance of a core's mean from its bit; rms of cores, mean square of all samples, and range of the middles of unset
    segments."""

    word: Index
    ring: Array
    off: Array
    rough: Array
    left: Array
    uneven: Array


def _light_of_neighbours(wide: Array, soft: Array) -> Array:
    """Return the mean light (N,) in the middle of an unset segment, `wide` samples wide, between two set ones."""
    from scipy.special import ndtr

    near, far = ((0.5 + side * _MIDDLE / 2) * wide / np.maximum(soft, 1e-6) for side in (-1, 1))
    first, last = (np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi) - z * ndtr(-z) for z in (near, far))
    return 2 * (first - last) * soft / (_MIDDLE * wide)


def _fit(levels: Array, bits: int) -> _Fit:
    """Return the best word with some number of bits for rings of levels (N, ROUND)."""
    wide = ROUND // bits
    skip = int(wide * (1 - _CORE) / 2)
    at = (np.arange(wide)[:, None, None] + np.arange(bits)[:, None] * wide + np.arange(wide)) % ROUND
    segments = levels[:, at]  # (N, phase, segment, sample)
    bit = segments[..., skip : wide - skip].mean(-1) > 0.5
    # edges count as well: at the right phase whole segments are even, not only their cores
    left = np.square(segments - bit[..., None]).mean((-1, -2))
    phase = left.argmin(1)
    each = np.arange(len(levels))
    bit = bit[each, phase]
    core = segments[each, phase][..., skip : wide - skip] - bit[..., None]
    ring = np.zeros_like(levels)
    ring[each[:, None, None], at[phase]] = bit[..., None]
    off = np.abs(core.mean(-1)).max(1)
    rough = np.sqrt(np.square(core).mean((-1, -2)))
    trim = round(wide * (_CORE - _MIDDLE) / 2)
    middle = core[..., trim : core.shape[-1] - trim].mean(-1)
    highest, lowest = np.where(bit, -np.inf, middle).max(1), np.where(bit, np.inf, middle).min(1)
    uneven = np.where(bit.all(1), 0.0, highest - lowest)
    return _Fit(bit @ (1 << np.arange(bits)[::-1]), ring, off, rough, left[each, phase], uneven)


def _code_numbers(code: RingCode, words: Index) -> Index:
    """Return the numbers (N,) of words (N,) in any rotation, -1 if a word is no code."""
    table = _numbers_of_rotations(code)
    return np.array([table.get(word, -1) for word in words.tolist()], np.int64)


@cache
def _numbers_of_rotations(code: RingCode) -> dict[int, int]:
    """Return the numbers of a code's words, by all rotations."""
    named = zip(code.words, code.numbers, strict=True)
    return {turn: number for word, number in named for turn in _rotations_of_word(word, code.bits)}
