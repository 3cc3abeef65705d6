"""Columns of joints with letters as names are recognised by their unit: an orientation has three angles."""

from __future__ import annotations

import numpy as np
import pytest

from truing.formats.named_joints import SlideName, configurations_of_joints, joint_columns

PLACES = ("X [m]", "Y [m]", "Z [m]")
LETTERS = ("S [rad]", "L [rad]", "U [rad]", "R [rad]", "B [rad]", "T [rad]")


def found(*names: str) -> tuple[str, ...] | None:
    joints = joint_columns(names, [["0.1"] * len(names)], np.full((1, len(names)), 0.1))
    return None if joints is None else joints.raw


def test_a_run_of_angles_next_to_a_place_is_joints_in_its_order() -> None:
    joints = joint_columns((*LETTERS, *PLACES), [["0.1"] * 9], np.full((1, 9), 0.1))
    assert joints is not None
    assert joints.columns() == {f"joint{k}_rad": name for k, name in enumerate(LETTERS, 1)}
    assert not joints.is_guess


@pytest.mark.parametrize(
    "names",
    [
        ("A [deg]", "B [deg]", "C [deg]", *PLACES),  # an orientation
        (*LETTERS, *PLACES, "A [rad]", "B [rad]", "C [rad]"),  # which of the runs are joints?
        ("S velocity [rad]", "L velocity [rad]", "U velocity [rad]", "R velocity [rad]"),
        ("S", "L", "U", "R"),  # no unit says that these are angles
    ],
)
def test_other_angles_are_no_joints(names: tuple[str, ...]) -> None:
    assert found(*names) is None


def test_the_six_letters_of_yaskawa_are_joints_without_a_unit_and_t_is_no_time() -> None:
    names = ("R", "pose", "S", "L", "U", "B", "T")
    cells = [[str(0.1 * row + 0.5 * column) for column in range(7)] for row in range(9)]
    read = configurations_of_joints(names, cells, np.array(cells, float), {"pose": "pose", "time_s": "T"}, ())
    assert read is not None
    letters = dict(zip("SLURBT", range(1, 7), strict=True))
    assert read.mapping["columns"] == {f"joint{k}_rad": letter for letter, k in letters.items()}
    assert read.doubts  # the unit is a guess


def test_a_length_z_takes_the_number_that_the_joints_of_a_scara_robot_lack() -> None:
    assert found("time", "J1 [deg]", "J2 [deg]", "Z [mm]", "J4 [deg]") == ("J1 [deg]", "J2 [deg]", "Z [mm]", "J4 [deg]")
    assert found("J1 [deg]", "J2 [deg]", "J3 [deg]", "Z [mm]") == ("J1 [deg]", "J2 [deg]", "J3 [deg]")
    assert found("J1", "J2", "Z [mm]", "J4") is None, "no unit says that these are angles"


@pytest.mark.parametrize("word", ["Articulation", "Gelenk", "Axe", "Articulación", "Achse"])
def test_numbered_joints_are_recognised_in_other_languages(word: str) -> None:
    names = [f"{word} {number} (deg)" for number in range(1, 7)]
    assert found("Pose", *names, "X (mm)", "Y (mm)", "Z (mm)") == tuple(names)


def _of_robot(names: tuple[str, ...], joints: tuple[str, ...]) -> tuple[str, ...] | None:
    read = joint_columns(names, [["0.1"] * len(names)], np.full((1, len(names)), 0.1), joints)
    return None if read is None else read.raw


def test_an_external_axis_is_the_slide_of_the_robot_wherever_its_column_stands() -> None:
    turning = tuple(f"A{number} [deg]" for number in range(1, 7))
    arm = tuple(f"a{number}" for number in range(11, 17))
    names = (*turning, "E1 [mm]", "X [mm]", "Y [mm]", "Z [mm]")
    assert _of_robot(names, (SlideName("rail"), *arm)) == ("E1 [mm]", *turning)
    assert _of_robot(names, (*arm, SlideName("tool"))) == (*turning, "E1 [mm]")
    assert _of_robot(names, ("table", *arm)) is None  # a joint that turns is not read in mm
    assert _of_robot(names, (SlideName("rail"), SlideName("lift"), *arm)) is None
