"""Ring codes: the set of valid codes, and decoding to the right code or none."""

from __future__ import annotations

import numpy as np
import pytest

from truing.estimation.image_targets.ring_codes import (
    ROUND,
    RingCode,
    family_of_rings,
    read_rings,
    ring_code,
    smallest_turn,
)


def ring(word, bits, turn=0, samples=ROUND):
    """Levels round the ring of a word, clockwise from the most significant bit, turned by so many samples."""
    digits = [int(digit) for digit in format(word, f"0{bits}b")]
    return np.roll(np.repeat(digits, samples // bits), turn).astype(float)


@pytest.mark.parametrize(("bits", "count"), [(8, 13), (12, 147), (14, 516)])
def test_the_family_has_as_many_codes_as_industrial_ones(bits, count):
    code = ring_code(bits)
    assert len(code.words) == count
    assert code.numbers == tuple(range(1, count + 1))
    assert list(code.words) == sorted(code.words)
    for word in code.words:
        turns = {int(format(word, f"0{bits}b")[k:] + format(word, f"0{bits}b")[:k], 2) for k in range(bits)}
        assert min(turns) == word
        assert format(word, "b").count("1") % 2 == 0
        assert any(format(turn, f"0{bits}b")[0] == format(turn, f"0{bits}b")[bits // 2] == "1" for turn in turns)


def test_one_wrong_segment_never_makes_another_code():
    for bits in (8, 12, 14):
        words = set(ring_code(bits).words)
        changed = {smallest_turn(word ^ 1 << k, bits) for word in words for k in range(bits)}
        assert not words & changed


def test_invalid_words_and_tables_are_refused():
    with pytest.raises(ValueError, match="8, 12 or 14"):
        ring_code(10)
    with pytest.raises(ValueError, match="expected 0 to 255"):
        smallest_turn(256, 8)
    with pytest.raises(ValueError, match="rotations of each other"):
        RingCode.of_table(8, {0b0001_0001: 1, 0b0010_0010: 2}, "ring8")


@pytest.mark.parametrize("bits", [8, 12, 14])
def test_every_code_is_read_at_any_turn(bits):
    rng = np.random.default_rng(bits)
    code = ring_code(bits)
    levels = np.stack([ring(word, bits, rng.integers(ROUND)) for word in code.words])
    reading = read_rings(levels + 0.05 * rng.normal(size=levels.shape), (code,))
    assert tuple(reading.number) == code.numbers
    assert (reading.confidence > 0.7).all()
    assert np.array_equal(reading.ring.sum(1), levels.sum(1))


def test_a_table_of_a_vendor_names_its_own_numbers():
    table = RingCode.of_table(8, {0b1100_0000: 501, 0b0001_0001: 7}, "ours")
    levels = np.stack([ring(0b0000_1100, 8, 5), ring(0b0001_0001, 8, 100), ring(0b0000_0111, 8)])
    reading = read_rings(levels, (table,))
    assert reading.number.tolist() == [501, 7, -1]
    assert reading.unreadable.tolist() == [False, False, True]


def test_a_ring_code_of_two_families_is_not_read():
    codes = ring_code(8), ring_code(12)
    half = ring(0b0000_1111, 8)  # half a ring is a word of either
    quarter = ring(0b0001_0001, 8)
    reading = read_rings(np.stack([half, quarter]), codes)
    assert reading.unreadable[0]
    assert codes[1].words  # and 12 bits cannot say an eighth
    assert reading.family.tolist() == [-1, 0]


def test_a_ring_that_is_not_there_is_none_and_a_doubtful_segment_makes_it_unreadable():
    code = ring_code(12)
    faint = ring(code.words[40], 12)
    faint[faint > 0] = np.where(np.arange(int(faint.sum())) < ROUND // 12, 0.55, 1.0)
    reading = read_rings(np.stack([np.full(ROUND, 0.1), faint]), (code,))
    assert reading.unreadable.tolist() == [False, True]
    assert reading.number.tolist() == [-1, -1]


def test_random_levels_are_practically_never_read():
    rng = np.random.default_rng(0)
    coarse = rng.uniform(0, 1, (1500, 14)).repeat(ROUND // 14, axis=1)
    harsh = (rng.uniform(0, 1, (1500, 21)) > 0.5).repeat(ROUND // 21, axis=1).astype(float)
    for levels in (coarse, harsh):
        reading = read_rings(levels, (ring_code(8), ring_code(12)))
        assert (reading.number >= 0).mean() < 2e-3


def test_every_word_is_a_code_where_any_may_occur():
    code = family_of_rings("ring8_any")
    assert len(code.words) == 35  # necklaces of eight beads in two colours, but the empty one
    assert len(family_of_rings("ring12_any").words) == 351
    # a single segment is 1 wherever a ring begins; 1011 and its mirror image are two codes
    assert code.numbers[code.words.index(1)] == 1
    one, other = (code.numbers[code.words.index(smallest_turn(word, 8))] for word in (0b1011, 0b1101))
    assert sorted((one, other)) == [0b1011, 0b1101]
    assert one == 0b1101
    assert family_of_rings("ring12").numbers == ring_code(12).numbers
    with pytest.raises(ValueError, match="family: found rings"):
        family_of_rings("rings")
