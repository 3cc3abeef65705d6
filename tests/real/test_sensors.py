"""Public measurements on force sensors and a loaded platform: known results, and errors in the data are named."""

from __future__ import annotations

import numpy as np
import pytest

from tests.real import sensor_facts
from tests.tolerance import assert_close
from truing.estimation.sensor.calibrate import UndeterminedCalibrationError
from truing.estimation.sensor.contenders import hold_out


@pytest.fixture(scope="module")
def six_axis(real_data):
    return sensor_facts.six_axis(real_data)


def test_a_six_axis_sensor_is_calibrated_to_the_stated_residuals(six_axis):
    first = six_axis["file 1"]
    assert_close(first["as_written"], [0.039, 0.042, 0.044, 0.017, 0.010, 0.008], atol=5.01e-4)
    assert_close(first["raw"][:3], [0.27, 0.11, 0.46], atol=5.01e-3)
    assert first["exchanged"] == []


@pytest.mark.parametrize("name", ["file 2", "file 3"])
def test_exchanged_rows_are_named_and_put_right(six_axis, name):
    """Rows 16 and 17, 3.924 N and 6.72 N: in Fy alone, for the moments next to them were written down right."""
    found = six_axis[name]
    assert found["exchanged"] == [(16, 17, ["Fy"])]
    assert found["as_written"][1] > 0.5
    assert found["put_right"][1] < 0.044
    assert found["worst"][1] == pytest.approx(2.8, abs=0.1)


def test_a_table_without_a_load_along_z_says_so(real_data):
    table = sensor_facts.six_axis_tables(real_data)["file 3"]
    with pytest.raises(UndeterminedCalibrationError, match="fz is zero in all rows"):
        sensor_facts.fit_calibration(table, sensor_facts.LINEAR)


def test_no_direction_of_loading_can_be_left_out_of_the_first_file(real_data):
    table = sensor_facts.six_axis_tables(real_data)["file 1"]
    with pytest.raises(UndeterminedCalibrationError, match=r"without case 1.*mx is zero"):
        hold_out(table, sensor_facts.LINEAR)


def test_the_published_errors_of_three_axis_cells_are_those_of_a_transposed_matrix(real_data):
    for cell, found in sensor_facts.three_axis(real_data).items():
        # the log prints estimates to 0.1 g, which moves a root mean square by less than that over sqrt(45)
        assert found["transposed"] == pytest.approx(found["published"], abs=0.01), cell
        assert found["rms"] < 0.5 * found["published"]


def test_a_pier_has_its_stiffness_and_loops(real_data):
    found = sensor_facts.pier(real_data)
    assert abs(found["stiffness"][0, 0] - 414) < found["sigma_by_loop"][0, 0] < 80
    assert found["sigma_by_loop"][0, 0] > 3 * found["sigma"][0, 0]  # steps of a loop are not independent
    assert np.all(found["r2"] - found["held_out_r2"] > 0)
    assert_close(found["held_out_r2"][[0, 1, 4, 5]], [0.98, 0.96, 0.98, 0.98], atol=0.02)
    assert found["weakest"] < 0.02  # one direction was driven: the six displacements hardly differ in five of six ways
    assert found["hysteresis"][0] == pytest.approx(0.06, abs=0.01)
    assert found["by_loop"][-1] > 3 * found["hysteresis"][0]  # it yields
    assert found["amplitude"][-1] > 70


def test_a_stewart_sensor_s_published_table_is_reproduced(real_data):
    found = sensor_facts.stewart(real_data)
    for axis, (_, mean, error) in sensor_facts.PUBLISHED.items():
        assert abs(found["table"][axis][0]) == pytest.approx(abs(mean), abs=0.1 if "M" in axis else 0.011)
        assert found["table"][axis][1] == pytest.approx(error, abs=0.11)
    assert_close(found["legs"]["Fx"], [-8.5, -8.8, 12.0, -3.4, -3.9, 13.7], atol=0.051)
    assert found["condition"] == pytest.approx(5.5, abs=0.05)


def test_forces_acted_46_and_60_mm_below_the_origin(real_data):
    found = sensor_facts.stewart(real_data)
    for axis, arm in (("Fx", -46.0), ("Fy", -60.0)):
        assert found["arm_mm"][axis][2] == pytest.approx(arm, abs=2 * found["sigma_mm"][axis][2])
        assert found["sigma_mm"][axis][2] < 1.5
    # and a moment about the force itself is no matter of where it passes
    assert abs(found["along_nmm"]["Fx"]) > 5 * found["along_sigma_nmm"]["Fx"]


def test_the_moments_applied_were_the_sensor_s_own_force_times_an_arm(real_data):
    """The sheet computes -2.63 x 40 N mm: the force is what this sensor read, so the moment is no standard."""
    found = sensor_facts.stewart(real_data)
    for axis, place in (("Mx", 1), ("My", 0)):
        assert found["fz_of_moments"][axis] == pytest.approx(2.63, abs=0.02)
        assert abs(found["arm_mm"][axis][place]) == pytest.approx(40.5, abs=1.5)


def test_beam_cells_leave_the_stated_residual_from_a_line(real_data):
    assert sensor_facts.beams(real_data)["CZL635"] == pytest.approx(11.5, abs=0.06)


def test_a_cell_under_repeated_load_creeps_far_beyond_its_noise(real_data):
    found = sensor_facts.repeated_load(real_data)
    assert found["seconds"] == pytest.approx(3433, abs=1)
    assert len(found["creep"]) == 7
    sizes = np.array([abs(one.value) for one in found["creep"]])
    assert np.all(sizes > [3 * one.limit for one in found["creep"]])
    assert 0.003 < float(np.median(sizes)) < 0.006
    assert 0.005 < float(np.ptp(found["zeros"])) < 0.01
