"""The words of ring codes, by number."""

from __future__ import annotations

from functools import cache


@cache
def ring_words(bits: int) -> tuple[int, ...]:
    """Words with an even number of ones, neither none nor all, that no rotation makes smaller, in ascending order;
    code number n stands for the n-th.
    """
    return tuple(
        word for word in range(1, 2**bits - 1) if word.bit_count() % 2 == 0 and word == _smallest_rotation(word, bits)
    )


def _smallest_rotation(word: int, bits: int) -> int:
    full = 2**bits - 1
    return min(((word << k) | (word >> (bits - k))) & full for k in range(bits))


def segments(bits: int, number: int) -> tuple[bool, ...]:
    """Which of the ring's segments have the dot's colour, clockwise as seen from the front."""
    word = ring_words(bits)[number - 1]
    return tuple(bool(word >> k & 1) for k in range(bits))
