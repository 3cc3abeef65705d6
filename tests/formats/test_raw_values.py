"""Values of a raw column: arithmetic with units, coverage factors, rows that belong together."""

from __future__ import annotations

import numpy as np
import pytest

from tests.formats.reading import read, written
from tests.tolerance import assert_close
from truing.schemas.campaign import read_campaign
from truing.schemas.faults import CampaignFaults

POINT = {"path": "a.csv", "constants": {"pose": 1, "body": "b"}}


def test_a_column_is_scaled_shifted_and_wrapped_before_its_unit(tmp_path):
    written(tmp_path, "a.csv", "pose,A\n1,100\n2,-300\n3,90\n")
    rule = {"name": "A", "unit": "deg", "scale": -1, "offset": 90, "modulo": 360, "lowest": -180}
    found = read(tmp_path, "configurations", {"path": "a.csv", "columns": {"turn_rad": rule}})
    assert found.faults == ()
    assert_close(np.degrees(found.columns["turn_rad"]), [-10.0, 30.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("rule", [{"scale": 0}, {"lowest": 1.0}, {"modulo": -1.0}, {"factor": 2.0}])
def test_arithmetic_without_sense_is_refused(rule):
    files = {"points": {"path": "a.csv", "columns": {"x_mm": {"name": "A", **rule}}}}
    with pytest.raises(CampaignFaults):
        read_campaign({"campaign": {"name": "c", "kind": "photogrammetry"}, "files": files})


def test_values_that_mean_missing_are_those_of_the_file(tmp_path):
    written(tmp_path, "a.csv", "target,x_mm,y_mm,z_mm\nP,1,2,3\nQ,-999,2,3\n")
    rule = {"scale": 2.0, "offset": 1.0}
    found = read(tmp_path, entries={**POINT, "columns": {"x_mm": rule}, "missing": ["-999"]})
    assert found.faults == ()
    assert found.columns["x_mm"] == [3.0]


UNCERTAIN = ("UX", "U95", "U(95)", "u(x)", "2σ", "3 sigma", "MPE", "U_x [mm]", "dx (k=2)")


@pytest.mark.parametrize("raw", UNCERTAIN)
def test_an_expanded_uncertainty_is_no_standard_deviation(tmp_path, raw):
    written(tmp_path, "a.csv", f"target,x_mm,y_mm,z_mm,{raw}\nP,1,2,3,0.02\n")
    entry = {**POINT, "columns": {"sigma_x_mm": raw}}
    faults = read(tmp_path, entries=entry).faults
    if raw == "u(x)":  # a small u is a standard uncertainty
        assert faults == ()
        return
    (fault,) = faults
    assert fault.column == "sigma_x_mm"
    assert "coverage" in fault.expected
    found = read(tmp_path, entries={**entry, "coverage": 2})
    assert found.faults == ()
    assert_close(found.columns["sigma_x_mm"], [0.01], atol=1e-15)


@pytest.mark.parametrize("raw", ["std", "SD", "rms", "sigma_x", "1σ", "sx", "Unsicherheit"])
def test_a_standard_deviation_is_taken_as_it_is(tmp_path, raw):
    written(tmp_path, "a.csv", f"target,x_mm,y_mm,z_mm,{raw}\nP,1,2,3,0.02\n")
    found = read(tmp_path, entries={**POINT, "columns": {"sigma_x_mm": raw}})
    assert found.faults == ()
    assert found.columns["sigma_x_mm"] == [0.02]


def test_a_coverage_factor_of_one_column_wins(tmp_path):
    written(tmp_path, "a.csv", "target,x_mm,y_mm,z_mm,A,B\nP,1,2,3,0.06,0.02\n")
    columns = {"sigma_x_mm": {"name": "A", "coverage": 3}, "sigma_y_mm": "B"}
    found = read(tmp_path, entries={**POINT, "columns": columns, "coverage": 2})
    assert_close([found.columns["sigma_x_mm"], found.columns["sigma_y_mm"]], [[0.02], [0.01]], atol=1e-15)


def test_a_unit_in_the_heading_is_not_passed_over(tmp_path):
    written(tmp_path, "a.csv", "target,X [m],Y [m],Z [m]\nP,1,2,3\n")
    entry = {**POINT, "columns": {f"{a}_mm": f"{a.upper()} [m]" for a in "xyz"}}
    faults = read(tmp_path, entries=entry).faults
    assert [fault.column for fault in faults] == ["x_mm", "y_mm", "z_mm"]
    assert 'units = { x_mm = "m" }' in faults[0].expected
    assert read(tmp_path, entries={**entry, "unit": "m"}).columns["x_mm"] == [1000.0]
    assert read(tmp_path, entries={**entry, "unit": "mm"}).columns["x_mm"] == [1.0]  # who says so, is believed


def test_rows_of_a_pose_share_its_number(tmp_path):
    written(tmp_path, "a.csv", "x_mm,y_mm,z_mm\n" + "".join(f"{n},0,0\n" for n in range(6)))
    entry = {"path": "a.csv", "constants": {"body": "b"}, "rows_per_pose": 3, "number_rows": {"target": 1}}
    found = read(tmp_path, entries=entry)
    assert found.faults == ()
    assert found.columns["pose"] == [1, 1, 1, 2, 2, 2]
    assert found.columns["target"] == ["1", "2", "3"] * 2
    written(tmp_path, "a.csv", "x_mm,y_mm,z_mm\n" + "".join(f"{n},0,0\n" for n in range(7)))
    (fault,) = read(tmp_path, entries=entry).faults
    assert fault.value == "7 rows"


def test_rows_of_a_group_share_any_number(tmp_path):
    written(tmp_path, "a.csv", "time_s,reading\n" + "".join(f"{n},{n}\n" for n in range(6)))
    entry = {"path": "a.csv", "rows_per_group": {"run": 3}, "number_rows": {"step": 0, "run": 5}}
    found = read(tmp_path, "interferometer", {**entry, "constants": {"channel": "dz"}})
    assert found.faults == ()
    assert found.columns["run"] == [5, 5, 5, 6, 6, 6]
    assert found.columns["step"] == [0, 1, 2, 0, 1, 2]


def test_rows_of_a_configuration_are_side_by_side(tmp_path):
    written(tmp_path, "a.txt", "".join(f"{n} {10 * n}\n" for n in range(6)))
    entry = {"path": "a.txt", "header": False, "rows_per_pose": 3, "columns": {"first": 1, "last": 6}}
    found = read(tmp_path, "configurations", entry)
    assert found.faults == ()
    assert found.columns["pose"] == [1, 2]
    assert (found.columns["first"], found.columns["last"]) == ([0.0, 3.0], [20.0, 50.0])


@pytest.mark.parametrize(("rule", "angles"), [({"plus": 1}, [30.0, -5.0]), ({"minus": "A2"}, [10.0, 15.0])])
def test_a_joint_that_counts_from_a_fixed_direction_gets_the_reading_of_the_joint_before(tmp_path, rule, angles):
    written(tmp_path, "a.csv", "A2;A3;pose\n10,0;20,0;1\n-10,0;5,0;2\n")
    columns = {"A2_deg": "A2", "A3_deg": {"name": "A3", **rule}}
    found = read(tmp_path, "configurations", {"path": "a.csv", "separator": ";", "decimal": ",", "columns": columns})
    assert found.faults == ()
    assert found.columns["A2_deg"] == [10.0, -10.0]
    assert found.columns["A3_deg"] == angles


def test_a_column_to_be_added_has_to_be_in_the_file(tmp_path):
    written(tmp_path, "a.csv", "pose,A2,A3\n1,10,20\n")
    columns = {"A3_deg": {"name": "A3", "plus": "A9"}}
    (fault,) = read(tmp_path, "configurations", {"path": "a.csv", "columns": columns}).faults
    assert (fault.column, fault.value) == ("A3_deg", "A9")


def test_columns_without_a_name_are_no_covariates(tmp_path):
    written(tmp_path, "a.txt", "1 702.6 -3165.9 616.4 0.5 21.5\n2 555.6 -2741.5 613.1 0.7 21.6\n")
    columns = {"pose": 1, "J1_deg": 5, "temperature_c": 6}
    entry = {"path": "a.txt", "separator": "whitespace", "header": False, "columns": columns}
    found = read(tmp_path, "configurations", entry)
    assert found.faults == ()
    assert set(found.columns) == set(columns)
