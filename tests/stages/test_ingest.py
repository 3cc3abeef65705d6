"""The ingest stage: a good campaign becomes tables, a bad one is refused with all faults together."""

from __future__ import annotations

import gzip
import tomllib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.sentences import assert_says, says
from tests.tolerance import assert_close
from truing.formats.source import CampaignFiles
from truing.pipeline.campaign_folder import SettingsView
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.campaign import read_campaign
from truing.schemas.faults import CampaignFaults
from truing.stages import ingest

LEGS = """
[mechanism]
type = "ups"
legs = [
  { a_mm = [200.0, 0.0, 0.0], b_mm = [100.0, 0.0, 0.0], length_mm = 300.0 },
  { a_mm = [-100.0, 170.0, 0.0], b_mm = [-50.0, 85.0, 0.0], length_mm = 300.0 },
  { a_mm = [-100.0, -170.0, 0.0], b_mm = [-50.0, -85.0, 0.0], length_mm = 300.0 },
]
"""
CAMPAIGN = '[campaign]\nname = "c"\nkind = "photogrammetry"\n[noise]\npoint_mm = 0.005\n'
PLACES = {
    "base": np.array([[210.0, 5.0, 0.0], [-110.0, 180.0, 3.0], [-105.0, -175.0, 1.0], [20.0, 30.0, 15.0]]),
    "platform": np.array([[110.0, 0.0, 5.0], [-60.0, 90.0, 2.0], [-55.0, -90.0, 0.0], [10.0, 15.0, 20.0]]),
}
POSES = (1, 2, 3)


def point_rows(poses=POSES, scale=1.0, bodies=("base", "platform")):
    return [
        f"{pose},{body},{body[0].upper()}{i},{','.join(f'{scale * v + 10.0 * k:.4f}' for v in place)}"
        for k, pose in enumerate(poses)
        for body in bodies
        for i, place in enumerate(PLACES[body])
    ]


def survey_rows(scale=1.0):
    return [f"{body},{body[0].upper()}{i},{','.join(f'{scale * v:.4f}' for v in place)},"
            for body, places in PLACES.items() for i, place in enumerate(places)]  # fmt: skip


class Folder:
    """A campaign of base and platform in a folder, whose files a test may change."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.toml = CAMPAIGN + LEGS
        self.points = ["pose,body,target,x_mm,y_mm,z_mm", *point_rows()]
        self.targets: list[str] | None = ["body,target,x_mm,y_mm,z_mm,leg", *survey_rows()]
        self.configurations: list[str] | None = [
            "pose,role,time_s,rho1_mm,rho2_mm,rho3_mm,temperature_c",
            *(f"{pose},calibration,{60.0 * pose},{pose}.5,10,10,20.5" for pose in POSES),
        ]

    def run(self, write=True):
        for name in ("points", "targets", "configurations"):
            lines = getattr(self, name)
            if lines is not None and write:
                (self.path / f"{name}.csv").write_text("\n".join(lines) + "\n")
        campaign = read_campaign(tomllib.loads(self.toml))
        settings = SettingsView(campaign, ingest.DECLARATION.settings)
        outcome = ingest.run({}, settings, lambda done, total, what: None, CampaignFiles(self.path, campaign))
        return outcome, {
            name: content.read_all() if isinstance(content, pa.RecordBatchReader) else content
            for name, content in outcome.artifacts.items()
        }

    def faults(self):
        with pytest.raises(CampaignFaults) as caught:
            self.run()
        assert caught.value.faults
        return caught.value.faults


@pytest.fixture
def folder(tmp_path):
    return Folder(tmp_path)


def plain(table):
    """A table as its readers see it: dictionary columns as text."""
    columns = {
        name: table.column(name).cast(pa.string())
        if pa.types.is_dictionary(table.schema.field(name).type)
        else table.column(name)
        for name in table.column_names
    }
    return pa.table(columns)


def test_a_good_campaign_becomes_its_tables(folder):
    outcome, tables = folder.run()
    assert set(tables) == {"survey", "configurations", "observations", "exclusions"}
    for name, table in tables.items():
        assert ARTIFACTS[name].faults(plain(table)) == []
        assert table.column_names[: len(ARTIFACTS[name].columns)] == list(ARTIFACTS[name].columns)
    observations = tables["observations"]
    assert observations.column("pose").to_pylist() == [int(row.split(",")[0]) for row in point_rows()]
    assert observations.column("target").to_pylist() == [row.split(",")[2] for row in point_rows()]
    assert_close(observations.column("z_mm").to_pylist(), [float(r.split(",")[5]) for r in point_rows()], atol=0.0)
    assert set(observations.column("sigma_y_mm").to_pylist()) == {0.005}
    assert str(outcome.left_out) == "nothing"
    assert str(outcome.read) == "24 points of 3 poses from points.csv"
    assert str(outcome.figure) == "8 targets of 2 bodies (base, platform)"
    assert tables["configurations"].column("temperature_c").to_pylist() == [20.5] * 3
    assert tables["survey"].column("leg").null_count == 8


def test_only_declared_artifacts_are_left(folder):
    _, tables = folder.run()
    assert set(tables) <= {name.removesuffix("?") for name in ingest.DECLARATION.leaves}


def test_own_sigmas_win_and_gaps_in_them_take_the_declared_one(folder):
    folder.points[0] += ",sigma_x_mm,sigma_y_mm,sigma_z_mm"
    folder.points[1:] = [f"{row},0.01,,0.03" for row in folder.points[1:]]
    _, tables = folder.run()
    observations = tables["observations"]
    assert set(observations.column("sigma_x_mm").to_pylist()) == {0.01}
    assert set(observations.column("sigma_y_mm").to_pylist()) == {0.005}


def test_no_noise_anywhere_is_a_fault(folder):
    folder.toml = folder.toml.replace("[noise]\npoint_mm = 0.005\n", "")
    faults = folder.faults()
    assert {(fault.file, fault.column) for fault in faults} == {("campaign.toml", "noise.point_mm")}
    assert ["surveyed" in fault.expected for fault in faults] == [True, False]  # each table lacks its own


def test_rows_need_not_be_in_order_of_time(folder):
    folder.points[1:] = folder.points[:0:-1]
    folder.configurations[1:] = folder.configurations[:0:-1]
    _, tables = folder.run()
    assert tables["observations"].column("pose").to_pylist()[0] == 3
    assert tables["configurations"].column("pose").to_pylist() == [3, 2, 1]


def change(folder, table, row, old, new):
    lines = getattr(folder, table)
    assert old in lines[row - 1]
    lines[row - 1] = lines[row - 1].replace(old, new, 1)


@pytest.mark.parametrize(
    ("table", "row", "old", "new", "column", "value", "expected"),
    [
        ("points", 4, "-105.0000", "-105;0", "x_mm", "-105;0", "a number"),
        ("points", 4, "-105.0000", "inf", "x_mm", "inf", "a finite number"),
        ("points", 5, "B3", "B2", None, "pose 1, base, B2", "each pose, body and target once"),
        ("points", 5, "1,base", "9,base", "pose", "9", "a pose of configurations"),
        ("points", 5, "1,base", "x1,base", "pose", "x1", "a pose of configurations"),
        ("points", 5, "base", "Base", "body", "Base", "did you mean base"),
        ("configurations", 3, "120.0", "", "time_s", "", "a number in every row"),
        ("configurations", 3, "120.0", "60.0", "time_s", "60.0", "a time of its own"),
        ("configurations", 3, "2,cal", "1,cal", "pose", "1", "every pose once"),
        ("configurations", 3, "calibration", "practice", "role", "practice", "one of calibration, verification"),
        ("configurations", 3, "2.5", "", "rho1_mm", "", "a number in every row"),
        ("configurations", 3, "20.5", "-300", "temperature_c", "-300.0", "at least -273.15"),
        ("targets", 3, "B1", "B0", "target", "B0", "every body, target once"),
        ("targets", 3, "-110.0000,180.0000,3.0000,", "1,2,3,7", "leg", "7", "a leg from 1 to 3"),
        ("targets", 3, "-110.0000,180.0000,3.0000,", "1,2,3,2", "leg", "2", "only targets of the platform"),
        ("targets", 3, "-110.0000,180.0000,3.0000,", "1,2,3,1.5", "leg", "1.5", "a whole number"),
    ],
)
def test_a_fault_is_named_with_its_place(folder, table, row, old, new, column, value, expected):
    change(folder, table, row, old, new)
    faults = [fault for fault in folder.faults() if expected in fault.expected]
    assert len(faults) == 1, folder.faults()
    fault = faults[0]
    assert (fault.file, fault.column, fault.value) == (f"{table}.csv", column, value)
    assert fault.row == row


def test_every_fault_is_reported_at_once(folder):
    change(folder, "points", 4, "-105.0000", "zero")
    change(folder, "points", 5, "B3", "B1")
    change(folder, "configurations", 3, "120.0", "60.0")
    change(folder, "targets", 3, "180.0000", "nan")
    folder.toml = folder.toml.replace("[noise]", "[files.point]\npath='x'\n[noise]")
    faults = folder.faults()
    assert {fault.file for fault in faults} == {"points.csv", "configurations.csv", "targets.csv", "campaign.toml"}
    assert {fault.row for fault in faults if fault.file == "points.csv"} == {4, 5}
    assert any(says(fault.expected, "did you mean", "points") for fault in faults)


@pytest.mark.parametrize("body", ["base", "platform"])
def test_a_missing_body_is_a_fault_in_one_pose_and_in_all(folder, body):
    folder.points[1:] = [row for row in folder.points[1:] if not row.startswith(f"2,{body}")]
    assert any(fault.value == "pose 2 has none" for fault in folder.faults())
    folder.points[1:] = [row for row in folder.points[1:] if body not in row]
    assert any(f"points of body {body}" in fault.expected for fault in folder.faults())


@pytest.mark.parametrize("factor", [1000.0, 25.4, 1.0 / 25.4, 1e-3])
@pytest.mark.parametrize("table", ["points", "targets"])
def test_invalid_units_are_faults(folder, table, factor):
    if table == "points":
        folder.points[1:] = point_rows(scale=factor)
    else:
        folder.targets[1:] = survey_rows(scale=factor)
    assert any("unit right" in fault.expected for fault in folder.faults())


@pytest.mark.parametrize("factor", [1000.0, 25.4])
def test_invalid_units_in_points_and_survey_are_faults(folder, factor):
    folder.points[1:], folder.targets[1:] = point_rows(scale=factor), survey_rows(scale=factor)
    faults = folder.faults()
    assert {fault.file for fault in faults} == {"targets.csv"}
    assert all("[mechanism] legs" in fault.expected for fault in faults)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_gross_error_does_not_look_like_a_wrong_unit(folder, factor):
    change(folder, "points", 4, "-105.0000", f"{factor * 4000.0}")
    _, tables = folder.run()
    assert len(tables["observations"]) == 24


def test_a_survey_of_other_names_or_without_a_body(folder):
    folder.targets[1:] = [row.replace(",P", ",Q") for row in folder.targets[1:]]
    (fault,) = folder.faults()
    assert "(Q0, Q1, Q2" in fault.expected
    folder.targets[1:] = [row for row in survey_rows() if row.startswith("base")]
    (fault,) = folder.faults()
    assert fault.file == "targets.csv"
    assert_says(fault.expected, "targets", "body platform")


def test_a_standard_deviation_of_zero(folder):
    folder.points[0] += ",sigma_x_mm,sigma_y_mm,sigma_z_mm"
    folder.points[1:] = [f"{row},0.01,0.01,0.01" for row in folder.points[1:]]
    change(folder, "points", 6, ",0.01,0.01", ",0.0,0.01")
    (fault,) = folder.faults()
    assert (fault.row, fault.column, fault.value) == (6, "sigma_x_mm", "0.0")


def test_a_dense_surface_is_no_set_of_targets(folder):
    cloud = np.random.default_rng(2).uniform(-100.0, 100.0, (4000, 3))
    folder.points = ["pose,body,x_mm,y_mm,z_mm", *("1,base," + ",".join(f"{v:.3f}" for v in p) for p in cloud)]
    assert any("table scans" in fault.expected for fault in folder.faults())


def test_missing_files_and_columns(folder):
    folder.configurations = None
    (fault,) = folder.faults()
    assert fault.file == "configurations.csv"


def test_an_actuator_without_a_column(folder):
    folder.configurations[0] = folder.configurations[0].replace("rho3_mm", "rho_3_mm")
    assert any(fault.column == "rho3_mm" for fault in folder.faults())


def test_readings_without_times_and_roles_are_in_the_order_of_rows_and_all_fitted(folder):
    folder.configurations = ["pose,rho1_mm,rho2_mm,rho3_mm", *(f"{pose},{pose}.5,10,10" for pose in (3, 1, 2))]
    _, tables = folder.run()
    configurations = tables["configurations"]
    assert configurations.column("pose").to_pylist() == [3, 1, 2]
    assert configurations.column("role").to_pylist() == ["calibration"] * 3
    assert configurations.column("time_s").to_pylist() == [0.0, 1.0, 2.0]


def test_a_mistyped_column_of_times_is_a_fault(folder):
    folder.configurations[0] = folder.configurations[0].replace("time_s", "times_s")
    assert any(fault.column == "time_s" and "times_s" in fault.expected for fault in folder.faults())


def test_no_points_at_all(folder):
    folder.points = None
    assert any(fault.file == "points.csv" for fault in folder.faults())


def test_a_truncated_archive(folder):
    content = gzip.compress(("\n".join(folder.points) + "\n").encode() * 20)
    (folder.path / "p.csv.gz").write_bytes(content[:100])
    folder.toml += '[files.points]\npath = "p.csv.gz"\n'
    assert any("undamaged compressed file" in fault.expected for fault in folder.faults())


def test_many_unknown_poses_are_counted(folder):
    folder.configurations[1:] = folder.configurations[1:2]
    (fault,) = {f for f in folder.faults() if f.more}
    assert_says(fault.expected, "pose", "configurations")
    assert fault.more == 16 - 3


def without_mechanism(folder):
    folder.toml = CAMPAIGN + '[bodies]\nreference = "base"\n'
    folder.targets = folder.configurations = None


def test_without_configurations_poses_come_in_order_of_appearance(folder):
    without_mechanism(folder)
    folder.points[1:] = point_rows(poses=(7, 3, 5))
    _, tables = folder.run()
    configurations = tables["configurations"]
    assert configurations.column("pose").to_pylist() == [7, 3, 5]
    assert configurations.column("time_s").to_pylist() == [0.0, 1.0, 2.0]
    assert configurations.column("role").to_pylist() == ["calibration"] * 3
    assert "survey" not in tables


def test_units_of_points_do_not_hinder_the_look_at_their_poses(folder):
    without_mechanism(folder)
    folder.toml += '[files.points]\npath = "points.csv"\nunit = "m"\nunits = { z_mm = "in" }\n'
    _, tables = folder.run()
    assert tables["configurations"].column("pose").to_pylist() == list(POSES)
    assert_close(tables["observations"].column("z_mm").to_pylist()[3], 15.0 * 25.4, atol=1e-9)


def test_poses_are_text_where_any_is(folder):
    without_mechanism(folder)
    folder.points[1:] = [*point_rows(poses=("001",)), *point_rows(poses=("evening",))]
    _, tables = folder.run()
    assert tables["configurations"].column("pose").to_pylist() == ["001", "evening"]
    assert set(plain(tables["observations"]).column("pose").to_pylist()) == {"001", "evening"}


def test_the_reference_body_has_to_be_there(folder):
    without_mechanism(folder)
    folder.toml = folder.toml.replace('"base"', '"floor"')
    (fault,) = folder.faults()
    assert_says(fault.expected, "points", "body floor")


def test_drives_have_to_be_columns(folder):
    folder.toml = folder.toml.replace("kind =", 'drives = ["temperature"]\nkind =')
    (fault,) = folder.faults()
    assert_says(fault.expected, "did you mean", "temperature_c")


EDITS = st.tuples(
    st.sampled_from(["points", "targets", "configurations"]),
    st.floats(0.0, 1.0),
    st.sampled_from([b",", b'"', b"\n", b"\xff", b";", b"nan", b"\r\n", b"-", b"1e999", b"\0", b"cut", b"end"]),
)


@given(st.lists(EDITS, min_size=1, max_size=6))
def test_any_change_of_the_files_gives_tables_or_faults(tmp_path_factory, edits):
    folder = Folder(tmp_path_factory.mktemp("edited"))
    folder.run()
    for table, place, edit in edits:
        path = folder.path / f"{table}.csv"
        content = path.read_bytes()
        at = int(place * len(content))
        new = {b"cut": content[:at] + content[at + 9 :], b"end": content[:at]}.get(
            edit, content[:at] + edit + content[at:]
        )
        path.write_bytes(new)
    said: tuple = ()
    try:
        said = tuple(folder.run(write=False)[1]["observations"].column("pose"))
    except CampaignFaults as caught:
        said = caught.faults
    assert said


@given(st.permutations(range(1, 25)), st.integers(0, 23))
def test_observations_come_in_the_order_of_the_file(tmp_path_factory, order, dropped):
    folder = Folder(tmp_path_factory.mktemp("order"))
    rows = [folder.points[i] for i in order]
    folder.points[1:] = rows[: 24 - dropped % 3]
    _, tables = folder.run()
    observations = plain(tables["observations"])
    names = (observations.column(name).to_pylist() for name in ("pose", "body", "target"))
    found = [",".join(map(str, row)) for row in zip(*names, strict=True)]
    assert found == [",".join(row.split(",")[:3]) for row in folder.points[1:]]


def moved(rng):
    """Places of both bodies in three poses, each body moved by itself, with 5 um of noise; in mm."""
    from truing.estimation.rotation import exp_so3

    rng = np.random.default_rng(rng)
    for pose in POSES:
        for body, places in PLACES.items():
            rotation = exp_so3(rng.uniform(-2.0, 2.0, 3))
            for i, point in enumerate(places @ rotation.T + rng.uniform(-500.0, 500.0, 3)):
                yield pose, body, f"{body[0].upper()}{i}", point + rng.normal(0.0, 0.005, 3)


@pytest.mark.parametrize("bodies_known", [True, False])
def test_points_without_names_are_named_by_the_survey(folder, bodies_known):
    rows = list(moved(3))
    np.random.default_rng(1).shuffle(rows)
    names = [(pose, body, target) for pose, body, target, _ in rows]
    folder.points = [
        f"{pose},{body}," + ",".join(f"{v:.5f}" for v in point) if bodies_known
        else f"{pose}," + ",".join(f"{v:.5f}" for v in point)
        for pose, body, _, point in rows
    ]  # fmt: skip
    folder.points.insert(0, "pose,body,x_mm,y_mm,z_mm" if bodies_known else "pose,x_mm,y_mm,z_mm")
    _, tables = folder.run()
    observations = plain(tables["observations"])
    found = list(zip(*(observations.column(name).to_pylist() for name in ("pose", "body", "target")), strict=True))
    assert found == names


def test_points_that_fit_no_target_are_left_out_and_counted(folder):
    rows = list(moved(4))
    folder.points = ["pose,body,x_mm,y_mm,z_mm", *(f"{p},{b}," + ",".join(map(str, x)) for p, b, _, x in rows)]
    folder.points.append("2,base,900.0,900.0,900.0")
    _, tables = folder.run()
    assert len(tables["observations"]) == 24
    (excluded,) = tables["exclusions"].to_pylist()
    assert (excluded["subject"], excluded["rows"]) == ("pose 2", 1)


def test_ambiguous_names_are_refused_with_their_rivals(folder):
    square = np.array([[100.0, 0.0, 0.0], [0.0, 100.0, 0.0], [-100.0, 0.0, 0.0], [0.0, -100.0, 0.0]])
    rows = {"base": PLACES["base"], "platform": square}
    folder.targets[1:] = [
        f"{b},{b[0].upper()}{i},{','.join(map(str, p))}," for b, ps in rows.items() for i, p in enumerate(ps)
    ]
    folder.points = ["pose,body,x_mm,y_mm,z_mm"]
    folder.points += [f"{pose},{b}," + ",".join(map(str, p)) for pose in POSES for b, ps in rows.items() for p in ps]
    (fault,) = [fault for fault in folder.faults() if "can be named" in fault.expected]
    assert "platform" in fault.expected
    assert "ambiguous" in fault.value
    assert "rivals: " in fault.value


def test_points_without_names_need_a_survey(folder):
    folder.targets = None
    folder.points = ["pose,body,x_mm,y_mm,z_mm", "1,base,1,2,3"]
    assert any("targets.csv" in fault.expected for fault in folder.faults())
