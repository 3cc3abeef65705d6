"""Code words of ring codes by number, after patent DE 197 33 466 A1."""

from __future__ import annotations

from functools import cache


@cache
def ring_words(bits: int) -> tuple[int, ...]:
    """Words that no rotation makes smaller, with an even number of ones and a pair of opposite ones, not all ones, in
    ascending order; code number n stands for the n-th.
    """
    return tuple(word for word in range(1, 2**bits - 1) if _is_one(word, bits))


def _is_one(word: int, bits: int) -> bool:
    if word.bit_count() % 2 or not word & (word >> bits // 2):
        return False
    turned = (((word << k) | (word >> (bits - k))) & (2**bits - 1) for k in range(1, bits))
    return all(word <= other for other in turned)


def segments(bits: int, number: int) -> tuple[bool, ...]:
    """Mask of the ring's segments in the colour of the dot, clockwise seen from the front, highest bit first."""
    word = ring_words(bits)[number - 1]
    return tuple(bool(word >> (bits - 1 - k) & 1) for k in range(bits))
