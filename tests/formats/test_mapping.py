"""Every key of a file mapping, with its effect on the table."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.formats.reading import read, written
from tests.sentences import assert_says, says
from tests.tolerance import assert_close
from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import RawTable
from truing.formats.read import read_table
from truing.formats.source import CampaignFiles
from truing.schemas.campaign import read_campaign
from truing.schemas.faults import CampaignFaults

XYZ = {"x_mm": 1, "y_mm": 2, "z_mm": 3}
BASE = {"header": False, "columns": XYZ, "constants": {"body": "base", "target": "T"}}


def test_row_number_as_pose_starts_where_the_entry_says(tmp_path):
    written(tmp_path, "a.txt", "1 2 3\n4 5 6\n")
    written(tmp_path, "b.txt", "7 8 9\n")
    found = read(tmp_path, entries=[
        {"path": "a.txt", **BASE, "number_rows": {"pose": 1}},
        {"path": "b.txt", **BASE, "number_rows": {"pose": 5}},
    ])  # fmt: skip
    assert found.columns["pose"] == [1, 2, 5]
    assert found.columns["x_mm"] == [1.0, 4.0, 7.0]


def test_an_offset_shifts_the_readings_of_one_file(tmp_path):
    written(tmp_path, "a.txt", "ID\tx\ty\tz\n1 \t-2,701.5\t1\t2\n3 \t5\t6\t7\n")
    entry = {"path": "a.txt", "format": "tracker", "constants": {"body": "M1", "target": "T"}, "offset": {"pose": 2}}
    found = read(tmp_path, entries=entry)
    assert found.columns["pose"] == [3, 5]
    assert found.columns["x_mm"] == [-2701.5, 5.0]


def test_names_of_files_give_pose_body_and_target(tmp_path):
    for pose in (2, 10, 1):
        written(tmp_path, f"day1/run_{pose}_M1_upper.txt", f"{pose} 0 0\n")
    entry = {"path": "day*/run_*.txt", "header": False, "columns": XYZ,
             "from_name": r"run_(?P<pose>\d+)_(?P<body>M\d)_(?P<target>\w+)\.txt"}  # fmt: skip
    found = read(tmp_path, entries=entry)
    assert found.columns["pose"] == [1, 2, 10]
    assert set(found.columns["body"]) == {"M1"}
    assert set(found.columns["target"]) == {"upper"}


def test_the_path_of_a_file_where_the_expression_holds_a_slash(tmp_path):
    written(tmp_path, "arm/7.txt", "1 2 3\n")
    entry = {"path": "*/*.txt", "header": False, "columns": XYZ, "from_name": r"(?P<body>\w+)/(?P<pose>\d+)\.txt",
             "constants": {"target": "T"}}  # fmt: skip
    assert read(tmp_path, entries=entry).rows[0] | {"body": "arm", "pose": 7} == read(tmp_path, entries=entry).rows[0]


def test_a_mistyped_column_of_the_mapping_is_named_also_where_the_file_has_the_right_one(tmp_path):
    written(tmp_path, "a.csv", "pose,body,target,x_mm,y_mm,z_mm\n1,A,T,1,2,3\n")
    (fault,) = read(tmp_path, entries={"path": "a.csv", "columns": {"xx_mm": "x_mm"}}).faults
    assert (fault.column, fault.expected) == ("xx_mm", "a known column; did you mean x_mm?")


def test_a_name_that_does_not_fit_is_a_fault(tmp_path):
    written(tmp_path, "other.txt", "1 2 3\n")
    entry = {"path": "*.txt", **BASE, "from_name": r"pose(?P<pose>\d+)"}
    (fault,) = read(tmp_path, entries=entry).faults
    assert (fault.file, fault.value) == ("other.txt", "other.txt")


WIDE = "pose,B1_X,B1_Y,B1_Z,P2_X,P2_Y,P2_Z\n1,1,2,3,4,5,6\n2,0,0,0,7,8,9\n"


def test_wide_rows_become_a_row_per_target(tmp_path):
    written(tmp_path, "w.csv", WIDE)
    entry = {"path": "w.csv", "wide": "{target}_{axis}", "constants": {"body": "b"}, "missing": ["0 0 0"]}
    found = read(tmp_path, entries=entry)
    assert [(r["pose"], r["target"], r["x_mm"]) for r in found.rows] == [(1, "B1", 1.0), (1, "P2", 4.0), (2, "P2", 7.0)]
    assert found.records == [0, 0, 1]
    assert sum(found.left_out.values()) == 1


def test_more_columns_than_any_table_has_are_refused_at_once(tmp_path):
    written(tmp_path, "points.csv", ",".join(f"c{n}" for n in range(30_001)) + "\n1\n")
    assert [fault.value for fault in read(tmp_path).faults] == ["30001 columns"]


def test_wide_rows_that_are_all_cut_short_are_faults(tmp_path):
    written(tmp_path, "w.csv", "pose,A_x,A_y,A_z\n1,2,3\n2,3,4\n")
    found = read(tmp_path, entries={"path": "w.csv", "wide": "{target}_{axis}", "constants": {"body": "b"}})
    assert [(fault.row, fault.value) for fault in found.faults] == [(2, "3 columns"), (3, "3 columns")]


def test_wide_names_may_hold_the_body_too(tmp_path):
    written(tmp_path, "w.csv", "pose;arm.1.x;arm.1.y;arm.1.z;leg.1.x;leg.1.y;leg.1.z\n1;1;2;3;4;5;6\n")
    found = read(tmp_path, entries={"path": "w.csv", "wide": "{body}.{target}.{axis}"})
    assert [(r["body"], r["target"], r["z_mm"]) for r in found.rows] == [("arm", "1", 3.0), ("leg", "1", 6.0)]


def test_wide_columns_without_header_have_names_in_the_mapping(tmp_path):
    written(tmp_path, "w.txt", "0.1 0.2 0.3 0.4 0.5 0.6\n")
    entry = {"path": "w.txt", "header": False, "names": ["x1", "y1", "z1", "x2", "y2", "z2"], "unit": "m",
             "wide": "{axis}{target}", "constants": {"body": "b"}, "number_rows": {"pose": 1}}  # fmt: skip
    found = read(tmp_path, entries=entry)
    assert found.columns["target"] == ["1", "2"]
    assert_close(found.columns["x_mm"], [100.0, 400.0], atol=1e-12)


def test_a_fault_in_a_wide_row_names_its_own_column_and_line(tmp_path):
    written(tmp_path, "w.csv", "pose,B1_x,B1_y,B1_z\n1,1,2,3\n2,1,oops,3\n")
    (fault,) = read(tmp_path, entries={"path": "w.csv", "wide": "{target}_{axis}", "constants": {"body": "b"}}).faults
    assert (fault.row, fault.value) == (3, "oops")


def test_cells_with_several_numbers(tmp_path):
    text = ',markers\n0,"[[-1.5   2.25 1.5]\n [-3.5  1.5 1e-3]]"\n1,"[[1 2 3]\n [4 5 6]]"\n'
    written(tmp_path, "m.csv", text)
    entry = {"path": "m.csv", "arrays": {"markers": ["r_x", "r_y", "r_z", "l_x", "l_y", "l_z"]},
             "wide": "{target}_{axis}", "columns": {"pose": 1}, "unit": "m", "constants": {"body": "h"}}  # fmt: skip
    found = read(tmp_path, entries=entry)
    assert found.faults == ()
    assert found.columns["target"] == ["r", "l", "r", "l"]
    assert_close(found.columns["z_mm"], [1500.0, 1.0, 3000.0, 6000.0], atol=1e-9)
    written(tmp_path, "m.csv", text.replace("4 5 6", "4 5"))
    (fault,) = read(tmp_path, entries=entry).faults
    assert fault.row == 4
    assert_says(fault.expected, "6 numbers", "cell")


def test_split_takes_names_apart_and_leaves_out_what_it_does_not_fit(tmp_path):
    written(tmp_path, "p.csv", "pose,label,x_mm,y_mm,z_mm\n1,ArmL1,1,2,3\n1,Sternum,1,2,3\n1,ArmR2,1,2,3\n")
    entry = {"path": "p.csv", "split": {"label": r"(?P<body>Arm[LR])(?P<target>\d)"}}
    found = read(tmp_path, entries=entry)
    assert [(r["body"], r["target"]) for r in found.rows] == [("ArmL", "1"), ("ArmR", "2")]
    assert sum(found.left_out.values()) == 1
    assert found.records == [0, 2]


def test_a_column_may_be_split_into_itself(tmp_path):
    written(tmp_path, "p.csv", "pose,target,x_mm,y_mm,z_mm\n1,leg1_L2,1,2,3\n")
    found = read(tmp_path, entries={"path": "p.csv", "split": {"target": r"(?P<body>leg\d)_(?P<target>\w+)"}})
    assert [(r["body"], r["target"]) for r in found.rows] == [("leg1", "L2")]


def test_select_rename_and_join(tmp_path):
    text = "Feature,ID,x_mm,y_mm,z_mm\nm1_3,1,1,2,3\nm1_3_40,1,4,5,6\nscale,1,7,8,9\n"
    written(tmp_path, "p.csv", text)
    entry = {
        "path": "p.csv",
        "select": {"Feature": "m.*"},
        "split": {"Feature": r"(?:m|s)(?P<body>\d|cale)(?:_(?P<target>\d))?(?:_(?P<state>40))?"},
        "rename": {"state": {"": "90"}, "body": {r"(\d)": r"mirror\1"}},
        "join": {"pose": "{state}/{ID}"},
    }
    found = read(tmp_path, entries=entry)
    assert found.columns["pose"] == ["90/1", "40/1"]
    assert set(found.columns["body"]) == {"mirror1"}
    assert sum(found.left_out.values()) == 1


def test_columns_by_position_and_joined_names(tmp_path):
    written(tmp_path, "adj.txt", "01-0111 V1 -2.5 1.5 4\n01-0111 V2 1 2 3\n")
    entry = {"path": "adj.txt", "header": False, "names": ["panel", "v"], "join": {"target": "{panel} {v}"},
             "columns": {"x_mm": 3, "y_mm": 4, "z_mm": 5}, "constants": {"body": "M1"}}  # fmt: skip
    found = read(tmp_path, "targets", entry)
    assert found.columns["target"] == ["01-0111 V1", "01-0111 V2"]
    assert found.columns["z_mm"] == [4.0, 3.0]


def test_keep_lines_reads_the_lines_of_one_kind_in_a_log(tmp_path):
    log = "10:00 send\tget\n10:01 recv\tOK\tx\t1.5\ty\t2\tz\t3\n10:02 send\tget\n10:03 recv\tOK\tx\t4\ty\t5\tz\tbad\n"
    written(tmp_path, "log.txt", log)
    entry = {"path": "log.txt", "separator": "tab", "header": False, "keep_lines": "recv.*OK",
        "columns": {"x_mm": 4, "y_mm": 6, "z_mm": 8}, "number_rows": {"pose": 1},
        "constants": {"body": "b", "target": "T"}}  # fmt: skip
    found = read(tmp_path, entries=entry)
    (fault,) = found.faults
    assert (fault.row, fault.column, fault.value) == (4, "8", "bad")
    assert found.columns["pose"] == [1]


@pytest.mark.parametrize(
    ("missing", "kept"),
    [
        ([""], ["b", "c", "d", "e"]),
        (["-9999"], ["c", "d", "e"]),
        (["0 0 0"], ["b", "c", "e"]),
        (["NaN"], ["b", "d", "e"]),
    ],
)
def test_values_that_mean_missing(tmp_path, missing, kept):
    rows = {"a": ",1,2", "b": "-9999.0,1,2", "c": "nan,nan,nan", "d": "0,0.0,0", "e": "0,0,1"}
    rows = {
        name: row for name, row in rows.items() if name in kept or (missing != [""] and name != "a") or missing == [""]
    }
    if missing != ["NaN"]:
        rows["c"] = "3,3,3"
    text = "".join(f"1,b,{name},{row}\n" for name, row in rows.items())
    written(tmp_path, "p.csv", "pose,body,target,x_mm,y_mm,z_mm\n" + text)
    found = read(tmp_path, entries={"path": "p.csv", "missing": missing})
    assert found.faults == ()
    assert found.columns["target"] == kept
    assert sum(found.left_out.values()) == len(rows) - len(kept)


@given(st.data())
def test_nothing_is_lost_uncounted(tmp_path_factory, data):
    """Rows read and rows left out add up to the records of the file."""
    cell = st.sampled_from(["1", "2.5", "0", "-1"])
    names = st.sampled_from(["CODE1", "CODE22", "TARGET3", "x"])
    rows = data.draw(st.lists(st.tuples(names, cell, cell, cell), min_size=1, max_size=25))
    folder = tmp_path_factory.mktemp("count")
    written(folder, "p.csv", "".join(",".join(row) + "\n" for row in rows))
    entry = {"path": "p.csv", "format": "vstars", "constants": {"body": "b", "pose": 1}, "missing": ["0 0 0", "-1"],
             "select": {"target": r"CODE\d+"}}  # fmt: skip
    found = read(folder, entries=entry)
    assert len(found.records) + sum(found.left_out.values()) == len(rows)
    wanted = [i for i, (name, *xyz) in enumerate(rows)
              if name.startswith("CODE") and xyz != ["0", "0", "0"] and "-1" not in xyz]  # fmt: skip
    assert found.records == wanted


def test_units_of_single_columns_and_times_written_as_dates(tmp_path):
    header = "t,dx,dy,dz,rx,ry,rz,fx,fy,fz,mx,my,mz,spare,note"
    row = "20-Dec-2008 10:47:39.250,1,0,0,1,0,0,1,0,0,1,0,0,7,ok"
    written(tmp_path, "d.csv", f"{header}\n{row}\n{row.replace(':39', ':41')}\n")
    axes = {
        f"{kind}{a}_{u}": f"{kind}{a}"
        for kind, u in (("d", "mm"), ("r", "rad"), ("f", "n"), ("m", "nm"))
        for a in "xyz"
    }
    units = {name: {"mm": "in", "rad": "deg", "n": "kip", "nm": "kip in"}[name.split("_")[1]] for name in axes}
    entry = {"path": "d.csv", "columns": {"time_s": "t", **axes}, "units": units, "constants": {"run": 1},
             "number_rows": {"step": 1}, "time_format": "%d-%b-%Y %H:%M:%S.%f"}  # fmt: skip
    found = read(tmp_path, "displacement", entry)
    assert found.faults == ()
    first, second = found.rows
    assert_close(second["time_s"] - first["time_s"], 2.0, atol=1e-6)
    assert_close(first["dx_mm"], 25.4, atol=1e-12)
    assert_close(first["rx_rad"], 3.141592653589793 / 180.0, atol=1e-15)
    assert_close(first["fx_n"], 4448.2216152605, atol=1e-9)
    assert_close(first["mx_nm"], 112.98482902761671, atol=1e-11)
    assert first["spare"] == 7.0
    assert "note" not in first


def test_a_unit_of_all_is_that_of_points_alone(tmp_path):
    written(tmp_path, "c.csv", "pose,rho1_mm\n1,2\n")
    (fault,) = read(tmp_path, "configurations", {"path": "c.csv", "unit": "in"}).faults
    assert "units = {" in fault.expected


def test_numbers_may_be_renamed_too(tmp_path):
    written(tmp_path, "t.csv", "body,target,x_mm,y_mm,z_mm,leg\nplatform,P1,1,2,3,none\nplatform,P2,low,2,3,L4\n")
    entry = {"path": "t.csv", "rename": {"leg": {"none": "", "L(.)": r"\1"}, "x_mm": {"low": "-5"}}}
    found = read(tmp_path, "targets", entry)
    assert found.faults == ()
    assert found.columns["leg"] == [None, 4]
    assert found.columns["x_mm"] == [1.0, -5.0]


def test_covariates_that_are_numbers_are_carried_along(tmp_path):
    written(tmp_path, "configurations.csv", "pose,time_s,elevation_deg,operator,humidity\n1,0,45,Ann,40\n2,1,50,Ben,\n")
    found = read(tmp_path, "configurations")
    assert found.faults == ()
    assert found.columns["elevation_deg"] == [45.0, 50.0]
    assert found.columns["humidity"] == [40.0, None]
    assert "operator" not in found.columns


def test_a_nearly_known_column_is_suggested(tmp_path):
    written(tmp_path, "points.csv", "pose,body,target,x_mm,y_mm,z_mm,sigma_x\n1,b,T,1,2,3,0.1\n")
    (fault,) = read(tmp_path).faults
    assert_says(fault.expected, "did you mean", "sigma_x_mm")


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ({"columns": {"x_mm": "X"}}, "did you mean"),
        ({"units": {"x_mm": "furlong"}}, "a known unit"),
        ({"unit": "deg"}, "a unit of length"),
        ({"units": {"x": "mm"}}, "a column x"),
        ({"select": {"quality": "good"}}, "a column quality"),
        ({"rename": {"bodi": {"a": "b"}}}, "did you mean body"),
        ({"join": {"target": "{nr}-{body}"}}, "a column nr"),
        ({"join": {"target": "{target}-{body}"}}, "not made of itself"),
        ({"wide": "{target}:{axis}"}, "columns named like"),
        ({"arrays": {"cells": ["a"]}}, "a column cells"),
        ({"path": "nothing*.csv"}, "an existing file"),
    ],
)
def test_mappings_that_do_not_fit_their_file(tmp_path, entry, expected):
    written(tmp_path, "p.csv", "pose,body,target,Xx,y_mm,z_mm,x_mm\n1,b,T,1,2,3,4\n")
    faults = read(tmp_path, entries={"path": "p.csv", **entry}).faults
    assert any(expected in fault.expected for fault in faults), faults


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ({"from_name": "("}, "regular expression"),
        ({"from_name": r"\d+"}, "named groups"),
        ({"split": {"a": "b"}}, "named groups"),
        ({"join": {"a": "b"}}, "template"),
        ({"wide": "{target}"}, "wide needs"),
        ({"encoding": "klingon"}, "known encoding"),
        ({"seperator": ";"}, "did you mean separator"),
    ],
)
def test_mappings_that_cannot_be(entry, expected):
    document = {"campaign": {"name": "c", "kind": "photogrammetry"}, "files": {"points": {"path": "p", **entry}}}
    with pytest.raises(CampaignFaults, match=expected):
        read_campaign(document)


def test_poses_are_integers_or_text_as_asked(tmp_path):
    written(tmp_path, "points.csv", "pose,body,target,x_mm,y_mm,z_mm\n007,b,T,1,2,3\n")
    assert read(tmp_path).columns["pose"] == [7]
    assert read(tmp_path, poses_as_text=True).columns["pose"] == ["007"]
    written(tmp_path, "points.csv", "pose,body,target,x_mm,y_mm,z_mm\nA7,b,T,1,2,3\n8,b,T,1,2,3\n")
    assert read(tmp_path).columns["pose"] == ["A7", "8"]


def test_channels_side_by_side_are_a_row_each(tmp_path):
    written(tmp_path, "run_3.csv", "t,step,F,A1,A2,room\n0,0,0,1,2,20\n60,1,9,3,4,21\n")
    entry = {"path": "run_*.csv", "from_name": r"run_(?P<run>\d)", "columns": {"time_s": "t", "load": "F"},
             "constants": {"load_axis": "fz"}, "channels": {"dz": "A1", "dx": "A2"}}  # fmt: skip
    found = read(tmp_path, "interferometer", entry)
    assert found.faults == ()
    assert list(zip(found.columns["channel"], found.columns["reading"], strict=True)) == [
        ("dz", 1.0), ("dz", 3.0), ("dx", 2.0), ("dx", 4.0)]  # fmt: skip
    assert found.columns["room"] == [20.0, 21.0] * 2
    assert not {"A1", "A2"} & found.columns.keys()
    entry["channels"] = {"dz": "A1", "dx": "A9"}
    (fault,) = read(tmp_path, "interferometer", entry).faults
    assert "a column A9" in fault.expected


def test_channels_are_those_of_an_interferometer(tmp_path):
    written(tmp_path, "a.csv", "pose,target,x_mm,y_mm,z_mm\n1,T,1,2,3\n")
    faults = read(tmp_path, entries={"path": "a.csv", "channels": {"dz": "x_mm"}}).faults
    assert [says(fault.expected, "channels", "[files.interferometer] alone") for fault in faults] == [True]


@pytest.mark.parametrize(
    ("text", "hint"),
    [("T1,1.5,2.5,3.5\n", "header = false"), ("# made today\npose,x,y,z\n1,2,3,4\n", 'set comment = "#"')],
)
def test_a_head_without_names_is_reported(tmp_path, text, hint):
    written(tmp_path, "a.csv", text)
    assert all(hint in fault.expected for fault in read(tmp_path, entries={"path": "a.csv"}).faults)


def test_rows_that_a_split_leaves_out_are_left_out_where_poses_are_looked_for(tmp_path):
    """A look at single columns of a table reads what `split` and `select` go by."""
    written(tmp_path, "a.csv", "pose,label,x_mm,y_mm,z_mm\n1,A1,1,2,3\n2,none,1,2,3\n")
    shape = RawTable("points", ("pose",), partial=True)
    entry = {"path": "a.csv", "split": {"label": r"(?P<target>[A-Z]\d)"}}
    campaign = read_campaign({"campaign": {"name": "c", "kind": "photogrammetry"}, "files": {"points": entry}})
    batches = [batch for _, batch in read_table(CampaignFiles(tmp_path, campaign), shape, FaultLog())]
    assert [batch.columns["pose"].to_pylist() for batch in batches] == [[1]]


def test_a_pose_is_not_taken_for_what_sounds_like_it_and_a_date_asks_for_its_format(tmp_path):
    written(tmp_path, "a.csv", "used,target,x_mm,y_mm,z_mm\n1,T,1,2,3\n")
    (fault,) = read(tmp_path, entries={"path": "a.csv"}).faults
    assert "did you mean" not in fault.expected
    assert "from_name" in fault.expected
    written(tmp_path, "c.csv", "pose,time_s\n1,20-Dec-2008 10:47:39\n2,20-Dec-2008 10:48:00\n")
    faults = read(tmp_path, "configurations", {"path": "c.csv"}).faults
    assert ["time_format" in fault.expected for fault in faults] == [True, True]


def test_a_constant_number_does_not_follow_the_decimal_mark_of_the_file(tmp_path):
    written(tmp_path, "a.csv", "x;y;z\n1,5;2;3\n")
    columns = {"x_mm": "x", "y_mm": "y", "z_mm": "z"}
    constants = {"body": "base", "target": "T", "sigma_x_mm": 0.005}
    entry = {"path": "a.csv", "separator": ";", "decimal": ",", "columns": columns, "constants": constants}
    found = read(tmp_path, entries={**entry, "number_rows": {"pose": 1}})
    assert found.faults == ()
    assert (found.columns["x_mm"], found.columns["sigma_x_mm"]) == ([1.5], [0.005])


def test_runs_of_an_axis_as_columns_become_rows_with_run_and_direction(tmp_path):
    text = "Target;Run 1 +;Run 1 -;Run 2 +;Run 2 -\n0;0.1;0.5;0.2;0.6\n10,5;1,1;;1.2;1.6\n"
    written(tmp_path, "runs.csv", text.replace(".", ","))
    entry = {
        "path": "runs.csv", "separator": ";", "decimal": ",", "columns": {"target_mm": "Target"},
        "wide": "Run {cycle} {direction}", "wide_values": "deviation_um", "constants": {"run": "x"},
        "rename": {"direction": {r"\+": "forward", "-": "backward"}},
    }  # fmt: skip
    found = read(tmp_path, "positioning", entry)
    assert found.faults == ()
    rows = [(r["target_mm"], r["cycle"], r["direction"], r["deviation_um"]) for r in found.rows]
    first = [(0.0, 1, "forward", 0.1), (0.0, 1, "backward", 0.5), (0.0, 2, "forward", 0.2), (0.0, 2, "backward", 0.6)]
    assert rows == [*first, (10.5, 1, "forward", 1.1), (10.5, 2, "forward", 1.2), (10.5, 2, "backward", 1.6)]
    assert found.records == [0, 0, 0, 0, 1, 1, 1]


@pytest.mark.parametrize("keys", [{"wide_values": "deviation_um"}, {"wide": "{axis}", "wide_values": "deviation_um"}])
def test_numbers_of_wide_columns_need_a_template_without_axis(tmp_path, keys):
    written(tmp_path, "runs.csv", "Target,Run 1\n0,1\n")
    with pytest.raises(CampaignFaults) as caught:
        read(tmp_path, "positioning", {"path": "runs.csv", **keys})
    assert "wide without {axis}" in str(caught.value.faults[0])
