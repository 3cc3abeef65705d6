"""The definitions are consistent: all columns are used, names agree with units, the page shows the enforced bounds."""

from __future__ import annotations

import typing
from pathlib import Path

import pyarrow as pa
import pytest

from tests.faults import assert_fault
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.campaign import Mechanism, read_campaign
from truing.schemas.column import Column
from truing.schemas.columns import COLUMNS, by_name, find_column
from truing.schemas.faults import CampaignFaults, Fault
from truing.schemas.mechanism import NoMechanism
from truing.schemas.pages import artifacts_page, campaign_page

TABLES = [artifact for artifact in ARTIFACTS.values() if artifact.is_table]
SUFFIXES = {"_mm": "mm", "_um": "um", "_rad": "rad", "_s": "s", "_c": "degC", "_n": "N", "_nm": "N m"}
SUFFIXES |= {"_mv": "mV", "_hpa": "hPa", "_pct": "%"}


def test_every_column_is_used_by_some_table():
    used = {name for artifact in TABLES for name in (*artifact.columns, *artifact.optional, *artifact.families)}
    assert used == set(COLUMNS)


@pytest.mark.parametrize("column", COLUMNS.values(), ids=lambda column: column.name)
def test_name_and_unit_agree(column):
    name = column.name if not column.family else column.family.split("]")[-1].removeprefix("\\d*")
    promised = next((unit for suffix, unit in SUFFIXES.items() if name.endswith(suffix)), None)
    assert promised in (None, column.unit)
    assert column.meaning


@pytest.mark.parametrize("artifact", TABLES, ids=lambda artifact: artifact.name)
def test_an_empty_table_of_every_artifact_keeps_its_schema(artifact):
    for identifier in ("int64", "string"):
        assert not artifact.faults(artifact.empty(identifier))


@pytest.mark.parametrize("beside", [[], [None], [float("nan")], [0.0, 2.0]], ids=["alone", "null", "nan", "good"])
def test_a_value_below_its_bound_is_found_next_to_any_others(beside):
    for parts in ([[*beside, -1.5]], [[-1.5], beside], [beside, [], [-1.5, 1.0]]):
        values = pa.chunked_array(parts, pa.float64())
        faults = list(ARTIFACTS["observations"].column_faults("sigma_x_mm", values))
        assert "at least 0" in assert_fault(faults, column="sigma_x_mm", value="-1.5").expected
        good = pa.chunked_array([part for part in parts if part is beside], pa.float64())
        assert not any(
            "at least" in fault.expected for fault in ARTIFACTS["observations"].column_faults("sigma_x_mm", good)
        )


def test_departures_are_named():
    table = pa.table(
        {"pose": [1, 2], "leg": [0, 2], "delta_rho_mm": [0.1, float("inf")], "sigma_um": [1.0, None], "more": [1, 2]}
    )
    faults = ARTIFACTS["deformation"].faults(table)
    assert any("a column delta_bz_um" in fault.expected for fault in faults)
    assert "at least 1" in assert_fault(faults, column="leg", value="0").expected
    assert "finite numbers" in assert_fault(faults, column="delta_rho_mm", value="inf").expected
    assert_fault(faults, column="sigma_um", value="empty")
    assert "no such column" in assert_fault(faults, column="more", value=None).expected


def test_text_is_held_to_its_choices():
    artifact = ARTIFACTS["configurations"]
    table = pa.table({"pose": [1], "role": ["calibratoin"], "time_s": [0.0], "rho1_mm": [10.0], "humidity": [40.0]})
    (fault,) = artifact.faults(table)
    assert (fault.file, fault.column, fault.value) == ("configurations.parquet", "role", "calibratoin")
    assert (fault.row, fault.expected) == (None, "one of calibration, verification, reference")


def test_numbered_columns_are_found_by_their_family():
    assert find_column("rho12_mm") is COLUMNS["rho"]
    assert find_column("rho0_mm") is None


def test_page_is_what_is_enforced():
    page = Path(__file__).resolve().parents[2] / "docs" / "artifacts.md"
    assert page.read_text(encoding="utf-8") == artifacts_page(), "run `python -m schemas`"


def test_the_page_of_settings_is_what_is_checked():
    page = Path(__file__).resolve().parents[2] / "docs" / "reference" / "campaign-toml.md"
    assert page.read_text(encoding="utf-8") == campaign_page(), "run `python -m schemas`"
    rows = [line.split(" | ") for line in campaign_page().splitlines() if line.startswith("| `")]
    assert [row for row in rows if len(row) != 5 or row[-1].strip(" |") == ""] == []


def test_the_page_of_settings_has_every_kind_of_mechanism():
    union = typing.get_args(typing.get_args(Mechanism)[0])
    models = [typing.get_args(one)[0] for one in union]
    page = campaign_page()
    sections = [part.split("\n## ")[0] for part in page.split("\n## `[mechanism]`")[1:]]
    for model in models:
        if model is not NoMechanism:
            assert sum(all(f"| `{key}` |" in part for key in model.model_fields) for part in sections) == 1, model


def sensor(*elements):
    legs = [{"B_mm": [1.0, 2.0, 3.0], "b_mm": [1.0, 2.0, 3.0]}] * 6
    return {"type": "6-upur", "height_mm": 300.0, "legs": legs, "elements": list(elements)}


ROD = {"diameter_mm": 2.0, "youngs_gpa": 114.0, "poisson": 0.34}
LEG = {"a_mm": [1.0, 2.0, 3.0], "b_mm": [1.0, 2.0, 3.0], "length_mm": 500.0}


@pytest.mark.parametrize(
    ("section", "expected"),
    [
        ({"nois": {}}, "key nois: expected a known key; did you mean noise?"),
        ({"noise": {"point_m": 1}}, "key noise.point_m: expected a known key; did you mean point_mm?"),
        ({"noise": {"point_mm": float("nan")}}, "key noise.point_mm: found 'nan'; expected a finite number"),
        ({"mechanism": {"type": "6-pus", "legs": [LEG] * 5}}, "expected six legs for a 6-pus, not 5"),
        ({"mechanism": {"type": "ups", "legs": [LEG] * 2}}, "expected at least three legs for a ups, not 2"),
        ({"mechanism": {"type": "ups", "legs": [{**LEG, "u": [0, 0, 2]}] * 3}}, "u: a vector of unit length"),
        ({"mechanism": {"tolerance": {"a_mm": 1}}}, 'expected type = "6-pus", "6-upur" or "chain" in [mechanism]'),
        (
            {"mechanism": sensor({"kind": "rigid"}, {"kind": "cylinder", "length_mm": 2})},
            "elements.2: expected diameter_mm",
        ),
        (
            {"mechanism": sensor({"kind": "rigid", "soft": "s1"})},
            "elements.1: expected length_mm for kind rigid, not soft",
        ),
        ({"mechanism": sensor({"kind": "compliance", "matrix": [[1.0]]})}, "expected a matrix of 6 x 6 numbers"),
        (
            {"interferometer": {"dead_path_mm": {"rx": 1.0}}},
            "dead_path_mm.rx: expected a known key, one of: dx, dy, dz",
        ),
        (
            {"mechanism": {"type": "ups", "legs": [LEG] * 3, "flexure": {**ROD, "youngs_gpa": 114e9}}},
            "flexure.youngs_gpa: found '114000000000.0'; expected at most 2000; did you mean 114 (1.14e+11 in Pa)?",
        ),
        (
            {"mechanism": {"type": "ups", "legs": [LEG] * 3, "flexure": {**ROD, "youngs_gpa": 114e3}}},
            "expected at most 2000; did you mean 114 (114000 in MPa)?",
        ),
        (
            {"mechanism": {"type": "ups", "legs": [LEG] * 3, "leg_tube": {**ROD, "diameter_mm": 0.012}}},
            "leg_tube.diameter_mm of at least 1/2000 of its length, 500 mm; did you mean 12 (0.012 in m)?",
        ),
        (
            {"mechanism": sensor({"kind": "cylinder", "length_mm": 100.0, **ROD, "diameter_mm": 0.024})},
            "cylinder.diameter_mm of at least 1/2000 of its length, 100 mm; did you mean 24 (0.024 in m)?",
        ),
        ({"files": {"points": {"path": "x", "seperator": ";"}}}, "did you mean separator?"),
        ({"exclude": [{"target": "P1", "by": "me"}]}, "key exclude.1.reason: expected this key to be present"),
        ({"format": 2}, "key format: found '2'; expected 1"),
        (
            {"measurement": {"up": [0, 0, 0], "frame": "campaign"}},
            "key measurement.up: expected a direction, such as [0, 0, 1]",
        ),
        ({"measurement": {"up": [0, 0, 1]}}, '[bodies] reference, or frame = "campaign", with [measurement] up'),
    ],
)
def test_faults_of_campaign_toml_are_named(section, expected):
    document = {"campaign": {"name": "c", "kind": "photogrammetry"}, **section}
    with pytest.raises(CampaignFaults) as caught:
        read_campaign(document)
    assert any(expected in str(fault) for fault in caught.value.faults), [str(f) for f in caught.value.faults]


def test_all_faults_come_at_once():
    with pytest.raises(CampaignFaults) as caught:
        read_campaign({"campaign": {"nam": "x"}, "nois": {}, "noise": {"point_mm": -1}})
    assert len(caught.value.faults) == 5


def test_every_fault_of_what_is_known_of_beams_and_material_comes_at_once():
    beams = {"dx": {"direction": [0.0, 1.0, 0.0], "arm_mm": [1.0, 2.0]}, "dy": {"direction": [0.0, -1.0, 0.0]}}
    beams |= {"rz": {"arm_mm": [1.0, 2.0, 3.0]}, "ry": {"direction": [0.0, 0.0, 0.0]}}
    material = {"dz": {"expansion_per_k": 11.5}, "rx": {}}
    spread = {"air_temp_c": 0.1, "index": -1.0}
    section = {"beams": beams, "material": material, "surroundings_sigma": spread}
    with pytest.raises(CampaignFaults) as caught:
        read_campaign({"campaign": {"name": "c", "kind": "interferometer"}, "interferometer": section})
    turned = "a direction within 30 degrees of the channel's own axis, pointing to increasing readings"
    facts = [
        ("beams.dx.arm_mm.3", None, "this key to be present"),
        ("beams.dy", None, turned),
        ("beams.ry", None, turned),
        ("beams.rz.arm_mm", None, "a known key, one of: direction, direction_sigma_rad"),
        ("material.dz.length_mm", None, "this key to be present"),
        ("material.dz.expansion_per_k", "11.5", "less than 0.001"),
        ("material.rx", None, "a known key, one of: dx, dy, dz, axis"),
        ("surroundings_sigma.index", "-1.0", "at least 0"),
        ("surroundings_sigma.air_temp_c", None, "a known key; did you mean air_temperature_c?"),
    ]
    assert caught.value.faults == tuple(
        Fault("campaign.toml", expected, column=f"interferometer.{key}", value=value) for key, value, expected in facts
    )


def test_a_fault_says_where_what_and_how_often():
    fault = Fault("points.csv", "a finite number in mm", row=17, column="x_mm", value="1,5", more=3)
    assert str(fault) == (
        "points.csv, row 17, column x_mm: found '1,5'; expected a finite number in mm (and 3 more like it)"
    )


def test_a_column_is_defined_once() -> None:
    assert by_name([Column("pose", "text", "a"), Column("body", "text", "b")]).keys() == {"pose", "body"}
    with pytest.raises(ValueError, match="the column pose is defined twice: a; b"):
        by_name([Column("pose", "text", "a"), Column("pose", "real", "b")])
