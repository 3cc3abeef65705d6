"""`truing init` on tables of nominal geometry: rows of Denavit and Hartenberg, masses, and legs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from tests.pipeline.test_init_exports import init, table
from truing.formats.raw_tables import POINTS, TARGETS
from truing.pipeline.command_line import app

RNG = np.random.default_rng(41)
ROWS = [(150.0, -90.0, 450.0, 0.0), (600.0, 0.0, 0.0, -90.0), (115.0, 90.0, 20.0, 0.0)]  # a, alpha, d, theta
KEYS = ("a_mm", "alpha_deg", "d_mm", "theta_deg")
MASSES = [(95.0, [-80.0, 60.0, 10.0]), (62.0, [-310.0, 0.0, 90.0]), (41.0, [-35.0, -20.0, 45.0])]
PLACES = RNG.uniform(-900.0, 900.0, (8, 3)).round(3)


def log(folder: Path, head: str = "A1 [deg],A2 [deg],A3 [deg]") -> None:
    angles = RNG.uniform(-90.0, 90.0, (len(PLACES), head.count(",") + 1)).round(3)
    lines = [head, *(",".join(map(str, row)) for row in angles)]
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    places = [f"P{k},{x},{y},{z}" for k, (x, y, z) in enumerate(PLACES, 1)]
    (folder / "laser.csv").write_text("\n".join(["Name,X [mm],Y [mm],Z [mm]", *places]) + "\n")


def dh(document: dict[str, Any]) -> list[tuple[float, ...]]:
    assert document["mechanism"]["type"] == "chain"
    return [tuple(row[key] for key in KEYS) for row in document["mechanism"]["dh"]]


def test_a_german_workbook_gives_rows_of_a_chain_and_masses_of_its_links(tmp_path: Path) -> None:
    log(tmp_path)
    book = openpyxl.Workbook()
    first = book.active
    assert first is not None
    first.append(["Roboter, Denavit-Hartenberg (klassisch)"])
    first.append([])
    first.append(["Achse", "theta0 [deg]", "d [mm]", "a [mm]", "alpha [deg]", "min [deg]", "max [deg]"])
    for number, (a, alpha, d, theta) in enumerate(ROWS, 1):
        first.append([number, theta, d, a, alpha, -170, 170])
    masses = book.create_sheet("Massen")
    masses.append(["Glied", "Masse [kg]", "sx [mm]", "sy [mm]", "sz [mm]"])
    for number, (mass, centre) in enumerate(MASSES, 1):
        masses.append([number, mass, *centre])
    masses.append(["Werkzeug (an Glied 3)", 12.4, 15.0, 0.0, 85.0])
    book.save(tmp_path / "robot.xlsx")
    reported, document = init(tmp_path)
    assert dh(document) == ROWS
    found = document["mechanism"]
    assert [row["mass_kg"] for row in found["dh"]] == [mass for mass, _ in MASSES]
    for row, (a, alpha, d, _), (_, centre) in zip(found["dh"], ROWS, MASSES, strict=True):
        behind = np.array([a, 0.0, d]) + Rotation.from_euler("x", alpha, degrees=True).apply(centre)
        np.testing.assert_allclose(row["com_mm"], behind, atol=1e-5)
    assert (found["payload_kg"], found["payload_com_mm"]) == (12.4, [15.0, 0.0, 85.0])
    assert {row.get("convention", "standard") for row in found["dh"]} == {"standard"}
    assert "needed: a description" not in reported


def test_masses_of_another_number_of_links_are_left_out_and_named(tmp_path: Path) -> None:
    log(tmp_path)
    lines = [f"{k},{theta},{d},{a},{alpha}" for k, (a, alpha, d, theta) in enumerate(ROWS, 1)]
    (tmp_path / "dh_craig.csv").write_text("\n".join(["joint,theta_offset_deg,d_mm,a_mm,alpha_deg", *lines]) + "\n")
    rows = [f"{k},{mass},{','.join(map(str, centre))}" for k, (mass, centre) in enumerate(MASSES[:2], 1)]
    (tmp_path / "masses.csv").write_text("\n".join(["link,mass [kg],x [mm],y [mm],z [mm]", *rows]) + "\n")
    _, document = init(tmp_path)
    assert dh(document) == ROWS
    assert {row["convention"] for row in document["mechanism"]["dh"]} == {"modified"}
    assert not any("mass_kg" in row for row in document["mechanism"]["dh"])
    text = (tmp_path / "campaign.toml").read_text()
    assert "masses.csv: masses of links" in text[text.index("# Not read") :]


def test_variables_in_a_table_distinguish_slides_and_shifts(tmp_path: Path) -> None:
    log(tmp_path, "J1_deg,J2_deg,J3_mm,J4_deg")
    lines = ["i,alpha_i-1 (rad),a_i-1 (m),theta_i (deg),d_i (m)"]
    lines += ["1,0,0,J1,0.38", "2,0,0.325,J2 - 90,0", "3,3.141592653589793,0.275,0,J3", "4,0,0,J4,0.06"]
    (tmp_path / "scara.csv").write_text("\n".join(lines) + "\n")
    _, document = init(tmp_path)
    assert dh(document) == [(0, 0, 380, 0), (325, 0, 0, -90), (275, 180, 0, 0), (0, 0, 60, 0)]
    rows = document["mechanism"]["dh"]
    assert [row.get("kind", "revolute") for row in rows] == ["revolute", "revolute", "prismatic", "revolute"]
    assert {row["convention"] for row in rows} == {"modified"}  # i-1
    assert "# joint_mm = " in (tmp_path / "campaign.toml").read_text()


@pytest.mark.parametrize("answer", ["standard", "modified"])
def test_a_convention_that_no_word_gives_is_asked(tmp_path: Path, answer: str) -> None:
    log(tmp_path)
    lines = [f"{k},{theta},{d},{a},{alpha}" for k, (a, alpha, d, theta) in enumerate(ROWS, 1)]
    (tmp_path / "robot.csv").write_text("\n".join(["joint,theta_deg,d_mm,a_mm,alpha_deg", *lines]) + "\n")
    done = CliRunner().invoke(app, ["init", str(tmp_path)])
    assert "convention=..." in done.stdout
    text = (tmp_path / "campaign.toml").read_text()
    assert text.index("# check: ") < text.index("[mechanism]")
    (tmp_path / "campaign.toml").unlink()
    done = CliRunner().invoke(app, ["init", str(tmp_path), "--answer", f"convention={answer}"])
    assert done.exit_code == 0, done.stderr
    text = (tmp_path / "campaign.toml").read_text()
    assert ('convention = "modified"' in text) == (answer == "modified")
    assert "by Craig" not in text


LEGS = RNG.uniform(-400.0, 400.0, (6, 6)).round(3)
LENGTHS = RNG.uniform(500.0, 600.0, 6).round(4)


def geometry(folder: Path, *, with_lengths: bool) -> None:
    head = "joint base_x base_y base_z plat_x plat_y plat_z" + (" leg_home" if with_lengths else "")
    rows = [[k, *leg, *([length] if with_lengths else [])] for k, (leg, length) in enumerate(zip(LEGS, LENGTHS), 1)]  # noqa: B905
    lines = ["Hexapod, drawing 7 (all mm)", head, *(" ".join(map(str, row)) for row in rows)]
    (folder / "geometry.txt").write_text("\n".join(lines) + "\n")


def hexapod(folder: Path) -> None:
    """Files of points, one for each pose, next to strokes of the legs; the platform moves along z."""
    names = [f"{body}_{number}" for body in ("base", "platform") for number in range(1, 5)]
    rest = RNG.uniform(-300.0, 300.0, (len(names), 3)).round(3)
    for pose in range(1, 7):
        at = rest + np.array([[0.0, 0.0, 9.0 * pose * name.startswith("p")] for name in names])
        rows = [f"{name},{x:.3f},{y:.3f},{z:.3f}" for name, (x, y, z) in zip(names, at, strict=True)]
        (folder / f"pose_{pose:02d}.csv").write_text("\n".join(["Name,X (mm),Y (mm),Z (mm)", *rows]) + "\n")
    strokes = RNG.uniform(-50.0, 50.0, (6, 6)).round(3)
    lines = [",".join(map(str, (pose, *row))) for pose, row in enumerate(strokes, 1)]
    head = ",".join(["pose", *(f"leg{leg}_mm" for leg in range(1, 7))])
    (folder / "strokes.csv").write_text("\n".join([head, *lines]) + "\n")


def test_a_drawing_of_legs_is_no_measurement_but_their_geometry(tmp_path: Path) -> None:
    hexapod(tmp_path)
    geometry(tmp_path, with_lengths=True)
    _, document = init(tmp_path)
    legs = document["mechanism"]["legs"]
    assert document["mechanism"]["type"] == "ups"
    assert [[*leg["a_mm"], *leg["b_mm"]] for leg in legs] == LEGS.tolist()
    assert [leg["length_mm"] for leg in legs] == LENGTHS.tolist()
    assert document["files"]["points"]["path"] == "pose_*.csv"


def test_a_drawing_without_lengths_is_left_out_with_the_reason(tmp_path: Path) -> None:
    hexapod(tmp_path)
    geometry(tmp_path, with_lengths=False)
    _, document = init(tmp_path)
    assert "mechanism" not in document
    text = (tmp_path / "campaign.toml").read_text()
    assert "geometry.txt: looks like the nominal geometry" in text[text.index("# Not read") :]


@pytest.mark.parametrize("odd", ["", "77\t1\t2\t3\n"])
def test_words_that_are_bodies_of_points_are_those_of_the_survey(tmp_path: Path, odd: str) -> None:
    """Unless a name of the survey has no such word."""
    hexapod(tmp_path)
    names = [f"{body}_{number}" for body in ("base", "platform") for number in range(1, 5)]
    rows = [f"{name}\t{k}\t{2 * k}\t{k * k}\n" for k, name in enumerate(names)]
    (tmp_path / "survey.txt").write_text("Survey, each body in its own frame\nTarget\tX\tY\tZ\n" + "".join(rows) + odd)
    reported, document = init(tmp_path)
    if odd:
        assert "survey.txt, Name of the rigid body" in reported
        return
    found = table(tmp_path, document, TARGETS).table
    assert found.column("body").to_pylist() == ["base"] * 4 + ["platform"] * 4
    assert found.column("target").to_pylist() == names
    done = tmp_path / "campaign.toml"
    done.unlink()
    CliRunner().invoke(app, ["init", str(tmp_path), "--answer", "words=names"])
    assert "(?P<body>" not in done.read_text()


def test_a_file_for_each_pose_is_read_before_a_single_file_of_points(tmp_path: Path) -> None:
    hexapod(tmp_path)
    (tmp_path / "a_check.csv").write_text("left_x,left_y,left_z,right_x,right_y,right_z\n" + "1,2,3,4,5,6\n" * 3)
    _, document = init(tmp_path)
    assert [entry["path"] for entry in document["files"]["points"]] == ["pose_*.csv"]
    assert set(table(tmp_path, document, POINTS).table.column("body").to_pylist()) == {"base", "platform"}
    assert "a_check.csv" in (tmp_path / "campaign.toml").read_text()


def test_rows_numbered_as_a_robot_names_its_axes_are_in_order(tmp_path: Path) -> None:
    log(tmp_path)
    rows = [f"A{number},{theta},{d},{a},{alpha}" for number, (a, alpha, d, theta) in enumerate(ROWS, 1)]
    (tmp_path / "dh.csv").write_text("\n".join(["joint,theta_deg,d_mm,a_mm,alpha_deg", *rows]) + "\n")
    assert dh(init(tmp_path)[1]) == ROWS


def test_rows_in_another_order_are_no_table_of_a_chain(tmp_path: Path) -> None:
    log(tmp_path)
    rows = [f"A{number},{theta},{d},{a},{alpha}" for number, (a, alpha, d, theta) in zip((1, 3, 2), ROWS, strict=True)]
    (tmp_path / "dh.csv").write_text("\n".join(["joint,theta_deg,d_mm,a_mm,alpha_deg", *rows]) + "\n")
    assert "dh" not in init(tmp_path)[1].get("mechanism", {})


def test_bodies_of_motion_capture_are_those_of_the_legs_next_to_them(tmp_path: Path) -> None:
    """Both bodies of one file are read, whatever its length."""
    legs = RNG.uniform(-900.0, 900.0, (6, 7)).round(3)
    head = "Leg,BaseX,BaseY,BaseZ,PlatX,PlatY,PlatZ,Length0"
    lines = [",".join(map(str, (number, *leg))) for number, leg in enumerate(np.abs(legs), 1)]
    (tmp_path / "geometry.csv").write_text("\n".join([head, *lines]) + "\n")
    parts = [f"{kind}.{axis}" for kind, axes in (("Rotation", "XYZW"), ("Position", "XYZ")) for axis in axes]
    names = ["Frame", *(f"{body}.{part}" for body in ("Base", "Top plate") for part in parts)]
    rows = [
        [k, *(number for _ in range(2) for number in (*Rotation.random(random_state=k).as_quat(), *PLACES[k]))]
        for k in range(len(PLACES))
    ]
    text = "\n".join([",".join(names), *(",".join(map(str, row)) for row in rows)]) + "\n"
    (tmp_path / "take.csv").write_text(text)
    _, document = init(tmp_path)
    assert document["mechanism"]["legs"][2]["b_mm"] == np.abs(legs[2, 3:6]).tolist()
    assert {entry["constants"]["body"] for entry in document["files"]["poses"]} == {"base", "platform"}
