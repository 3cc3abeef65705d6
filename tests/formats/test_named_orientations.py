"""Columns of an orientation are recognised by names of several makers and languages."""

from __future__ import annotations

import numpy as np
import pytest

from truing.formats.named_columns import pose_columns

PLACES = ("X [mm]", "Y [mm]", "Z [mm]")


def _quaternions() -> np.ndarray:
    drawn = np.random.default_rng(1).standard_normal((9, 4))
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


def test_four_numbered_columns_of_unit_length_are_a_quaternion_whose_real_part_is_to_be_confirmed() -> None:
    names = (*PLACES, "q1", "q2", "q3", "q4")
    places = np.random.default_rng(2).uniform(0.0, 900.0, (9, 3))
    found = pose_columns(names, np.column_stack([places, _quaternions()]))
    assert found is not None
    assert [found.mapping["columns"][name] for name in ("qw", "qx", "qy", "qz")] == ["q1", "q2", "q3", "q4"]
    assert any("q1" in note and "q4" in note for note in found.notes)
    assert pose_columns(names, np.column_stack([places, 2.0 * _quaternions()])) is None  # joints, or anything else


@pytest.mark.parametrize("words", [("Roulis", "Tangage", "Lacet"), ("Rollwinkel", "Nickwinkel", "Gierwinkel")])
def test_roll_pitch_and_yaw_are_recognised_in_other_languages(words: tuple[str, str, str]) -> None:
    names = (*PLACES, *(f"{word} [deg]" for word in words))
    found = pose_columns(names, np.random.default_rng(3).uniform(-80.0, 80.0, (9, 6)))
    assert found is not None
    assert [found.mapping["columns"][f"euler_{letter}_deg"] for letter in "abc"] == list(names[3:])
