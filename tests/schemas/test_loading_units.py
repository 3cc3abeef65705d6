"""[loading.units]: positions of the two units, and invalid arms."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from tests.sentences import assert_says
from truing.schemas.sections import Loading


def loading(**units: list[float]) -> Loading:
    return Loading.model_validate({"units": {load: {"arm_mm": arm} for load, arm in units.items()}})


def test_arms_of_loading_units_are_the_declared_ones():
    assert loading(fz=[550, 0, 20], mx=[0, 600, 0]).units.arms_mm == {"fz": (550, 0, 20), "mx": (0, 600, 0)}
    assert Loading().units.arms_mm == {}


@pytest.mark.parametrize(
    ("units", "expected"),
    [
        ({"fz": [0, 0, 300]}, ("arm_mm of fz", "1 mm across z", "not 0")),
        ({"fz": [0.55, 0, 0]}, ("arm_mm of fz", "1 mm across z", "not 0.55")),
        ({"mx": [10, 600, 0]}, ("arm_mm of mx perpendicular to x", "10 mm along it")),
        ({"mx": [600, 0, 0]}, ("arm_mm of mx", "across x", "not 0")),
    ],
)
def test_an_arm_that_gives_no_couple_is_refused(units, expected):
    with pytest.raises(ValidationError) as caught:
        loading(**units)
    assert_says(str(caught.value), *expected)
