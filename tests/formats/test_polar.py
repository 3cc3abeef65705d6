"""Directions and distances are distinguished from coordinates by their names, for any instrument."""

from __future__ import annotations

import pytest

from truing.formats.sniff_cells import is_polar


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (("Name", "Az (deg)", "El (deg)", "Range (mm)"), True),
        (("Point", "Azimuth", "Zenith", "Distance [m]"), True),
        (("id", "Hz [gon]", "V [gon]", "SD [m]"), True),
        (("Name", "X", "Y", "Z", "Az", "El", "R"), False),
        (("Name", "Az", "Range"), False),
    ],
)
def test_an_angle_around_one_up_and_a_distance_are_polar(names: tuple[str, ...], expected: bool) -> None:
    assert is_polar(names) == expected
