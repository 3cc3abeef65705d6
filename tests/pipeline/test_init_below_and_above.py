"""`truing init` on exports with lines above and below the table, or with heads that are no plain names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.pipeline.test_init_exports import URDF, init, numbers, table
from tests.tolerance import assert_close
from truing.formats.raw_tables import CONFIGURATIONS, POINTS, POSITIONING
from truing.formats.sniff import sniff_file
from truing.formats.times import time_format_of

RNG = np.random.default_rng(43)


def _write(path: Path, lines: list[str], encoding: str = "utf-8") -> None:
    path.write_text("\n".join([*lines, ""]), encoding=encoding)


@pytest.mark.parametrize("targets", [5, 90])
def test_runs_headed_by_arrows_are_read_without_the_lines_around_them(tmp_path: Path, targets: int) -> None:
    off = RNG.uniform(-9.0, 9.0, (targets, 4)).round(2)
    rows = [
        f"{k + 1};{100.0 * k:.3f};".replace(".", ",") + ";".join(f"{v:.2f}".replace(".", ",") for v in row)
        for k, row in enumerate(off)
    ]
    above = ["Renishaw plc;CARTO Explore;4.9", "Titel;Portal X", "Einheit;µm", "Läufe;2 bidirektional", ""]
    below = ["", "Auswertung nach ISO 230-2:2014", "M;;6,2", "Ende der Datei"]
    _write(tmp_path / "X.csv", [*above, "Nr.;Sollposition (mm);1 ↑;1 ↓;2 ↑;2 ↓", *rows, *below], "utf-8-sig")
    _, document = init(tmp_path)
    found = table(tmp_path, document, POSITIONING)
    assert_close(numbers(found, "deviation_um")[:, 0], off.ravel(), atol=1e-9, what="deviations")
    assert found.table.column("direction").to_pylist()[:2] == ["forward", "backward"]
    assert_close(numbers(found, "target_mm")[::4, 0], 100.0 * np.arange(targets), atol=1e-9, what="targets")


def test_a_row_with_fewer_cells_within_a_table_is_not_taken_for_a_line_below(tmp_path: Path) -> None:
    rows = [f"{k};{k * 1.5};{k * 2.5};{k * 3.5}" for k in range(1, 12)]
    _write(tmp_path / "points.csv", ["target;x;y;z", *rows[:8], "9;1.5", *rows[9:]])
    assert "keep_lines" not in sniff_file(tmp_path / "points.csv").mapping


@pytest.mark.parametrize("head", ["", "P"])
def test_a_last_row_that_was_cut_off_is_not_left_out(tmp_path: Path, head: str) -> None:
    rows = [f"{head}{k};{k * 1.5};{k * 2.5};{k * 3.5}" for k in range(1, 12)]
    _write(tmp_path / "points.csv", ["target;x;y;z", *rows, f"{head}12;18.0;3"])
    assert "keep_lines" not in sniff_file(tmp_path / "points.csv").mapping


@pytest.mark.parametrize("unit", ["mm", "in"])
def test_one_unit_behind_the_names_of_three_axes_holds_for_all(tmp_path: Path, unit: str) -> None:
    places = RNG.uniform(-900.0, 900.0, (6, 3)).round(4)
    rows = [f"A::Calib::P{k}  " + "  ".join(map(str, row)) for k, row in enumerate(places)]
    head = ["SpatialAnalyzer 2024.1  Point export", f"Collection::Group::Point  X  Y  Z  ({unit})", ""]
    _write(tmp_path / "SA.txt", [*head, *rows])
    _, document = init(tmp_path)
    (entry,) = document["files"].values()
    (shape,) = (name for name in document["files"])
    assert shape in ("targets", "points")
    assert entry.get("unit", "mm") == unit
    assert "units" not in entry


def test_places_in_one_group_are_poses_next_to_a_log_of_as_many(tmp_path: Path) -> None:
    joints, places = RNG.uniform(-90.0, 90.0, (8, 6)).round(3), RNG.uniform(-900.0, 900.0, (8, 3)).round(4)
    targets = [
        f"CONST jointtarget jp{10 * k}:=[[{','.join(map(str, row))}],[9E9,9E9]];" for k, row in enumerate(joints)
    ]
    _write(tmp_path / "Calib.mod", ["MODULE Calib", *targets, "ENDMODULE"])
    rows = [f"A::Calib::jp{10 * k}  " + "  ".join(map(str, row)) for k, row in enumerate(places)]
    _write(tmp_path / "SA.txt", ["Collection::Group::Point  X  Y  Z  (mm)", *rows])
    _, document = init(tmp_path)
    found = table(tmp_path, document, POINTS)
    assert [int(pose) for pose in found.table.column("pose").to_pylist()] == [10 * k for k in range(8)]
    assert_close(numbers(found, "x_mm", "y_mm", "z_mm"), places, atol=1e-9, what="places")


def test_an_index_in_brackets_is_no_unit_of_a_joint(tmp_path: Path) -> None:
    joints = RNG.uniform(-1.0, 1.0, (5, 3)).round(6)
    (tmp_path / "arm.urdf").write_text(URDF)
    head = ["header.stamp.sec", *(f"name[{k}]" for k in range(3)), *(f"position[{k}]" for k in range(3))]
    rows = [",".join([str(1770800000 + k), "pan", "lift", "twist", *map(str, row)]) for k, row in enumerate(joints)]
    _write(tmp_path / "joint_states.csv", [",".join(head), *rows])
    _, document = init(tmp_path)
    found = table(tmp_path, document, CONFIGURATIONS)
    assert_close(numbers(found, "pan_rad", "lift_rad", "twist_rad"), joints, atol=1e-9, what="joints")


def test_joints_without_columns_are_named_and_not_the_description_that_is_there(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(URDF)
    head = ";".join([*(f"J{k} [deg]" for k in range(1, 6)), "X [mm]", "Y [mm]", "Z [mm]"])
    rows = [";".join(map(str, row)) for row in RNG.uniform(-80.0, 80.0, (12, 8)).round(3)]
    _write(tmp_path / "log.csv", [head, *rows])
    printed, _ = init(tmp_path)
    said = " ".join(printed.split())
    assert "pan, lift, twist of arm.urdf" in said
    assert "put its URDF into the folder" not in said


def test_x_of_an_autocollimator_is_the_deviation_of_a_rotary_axis(tmp_path: Path) -> None:
    off = RNG.uniform(-2.0, 2.0, 12).round(2)
    rows = [f"{30 * k}.0;{x};{RNG.uniform(3.0, 4.0):.2f}" for k, x in enumerate(off)]
    _write(tmp_path / "axis.csv", ["Position [deg];X [arcsec];Y [arcsec]", *rows])
    _, document = init(tmp_path)
    found = table(tmp_path, document, CONFIGURATIONS)
    assert_close(numbers(found, "deviation_deg")[:, 0], off / 3600.0, atol=1e-9, what="deviations")
    assert found.table.column_names.count("Y [arcsec]") == 0


@pytest.mark.parametrize(
    ("head", "cell", "word"),
    [
        ("Angle (deg);Deviation (um)", "{};{}.5", "ball bar"),
        ("/PROG  CALIB\n/POS", "P[{}]{{\n   GP1:\n\tX = {}.5 mm,\tY = 0.0 mm\n}};", "FANUC"),
    ],
)
def test_unread_files_are_reported_with_the_reason(tmp_path: Path, head: str, cell: str, word: str) -> None:
    _write(tmp_path / "one.csv", [head, *(cell.format(k, 3 * k) for k in range(12))])
    printed, _ = init(tmp_path)
    assert word in printed


@pytest.mark.parametrize(
    "text",
    [
        "Hexapod, 32 epochs photographed, one file each, all in frames of their own.\nWe ask, with 15 targets, why.\n",
        "Four-joint arm. Poses of the object on the flange\nwere exported at 16 stops of the same arm.\n",
    ],
)
def test_notes_with_commas_and_numbers_are_text_without_a_table(tmp_path: Path, text: str) -> None:
    (tmp_path / "memo.txt").write_text(text)
    assert sniff_file(tmp_path / "memo.txt").known


def test_named_places_with_several_words_are_a_table(tmp_path: Path) -> None:
    rows = [f"Bolzen links oben am Rahmen {k};{k}.5;{k}.25;{k}.75" for k in range(6)]
    _write(tmp_path / "points.csv", ["Name;X;Y;Z", *rows])
    guess = sniff_file(tmp_path / "points.csv")
    assert (guess.table, guess.known) == ("targets", False)


@pytest.mark.parametrize(
    ("cell", "form"),
    [("2026-01-20T08:30:00Z", "%Y-%m-%dT%H:%M:%S%z"), ("2026-03-12 09:14:03.120+01:00", "%Y-%m-%d %H:%M:%S.%f%z")],
)
def test_times_with_a_zone_have_a_format(cell: str, form: str) -> None:
    found = time_format_of([cell])
    assert found is not None
    assert (found.form, found.doubt) == (form, "")


def test_times_of_different_zones_count_from_the_same_moment(tmp_path: Path) -> None:
    clocks = ["2026-03-12T09:00:00+01:00", "2026-03-12T08:00:10Z", "2026-03-12T03:00:25-05:00"]
    rows = [f"{clock},0.1,0.2,0.{k}" for k, clock in enumerate(clocks)]
    _write(tmp_path / "log.csv", ["timestamp,joint1,joint2,joint3", *rows])
    _, document = init(tmp_path)
    time = numbers(table(tmp_path, document, CONFIGURATIONS), "time_s")[:, 0]
    assert np.diff(time).tolist() == [10.0, 15.0]


def test_a_survey_of_the_points_on_the_last_link_is_of_this_link(tmp_path: Path) -> None:
    joints = RNG.uniform(-1.0, 1.0, (5, 3)).round(6)
    (tmp_path / "arm.urdf").write_text(URDF)
    _write(tmp_path / "log.csv", ["pan,lift,twist", *(",".join(map(str, row)) for row in joints)])
    survey = RNG.uniform(-50.0, 50.0, (3, 3)).round(4)
    head = "Name\tX\tY\tZ"
    _write(tmp_path / "survey.txt", [head, *(f"T{k}\t{x}\t{y}\t{z}" for k, (x, y, z) in enumerate(survey))])
    rows = [f"Pos{p}_T{k}\t{x + p:.4f}\t{y:.4f}\t{z:.4f}" for p in range(5) for k, (x, y, z) in enumerate(survey)]
    _write(tmp_path / "tracker.txt", [head, *rows])
    _, document = init(tmp_path)
    bodies = [document["files"][name]["constants"]["body"] for name in ("points", "targets")]
    assert bodies == ["hand", "hand"]
