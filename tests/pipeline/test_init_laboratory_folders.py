"""`truing init` on folders of laboratories: labels exchanged, a flange next to the base, grad, a continuous log."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from tests.pipeline.test_init_exports import URDF, init, numbers, table
from tests.tolerance import assert_close
from truing import exp_so3
from truing.formats.grad_units import is_grad
from truing.formats.raw_tables import CONFIGURATIONS, POINTS, POSES

RNG = np.random.default_rng(2311)
PLACES = RNG.uniform(-900.0, 900.0, (12, 3)).round(3)
JOINTS = RNG.uniform(-1.0, 1.0, (12, 3)).round(6)
DH = ["joint,a [mm],alpha [deg],d [mm],theta [deg]", "1,0,90,120,0", "2,-600,0,0,0", "3,-500,0,0,0"]


def test_bodies_have_the_words_of_names_even_if_labels_are_exchanged_once(tmp_path: Path) -> None:
    base, plate = RNG.uniform(-400.0, 400.0, (2, 5, 3))
    for pose in range(1, 9):
        R, shift = exp_so3(RNG.normal(0.0, 0.1, 3)), np.add(RNG.normal(0.0, 20.0, 3), [0.0, 0.0, 600.0])
        names = [f"plat_P{k:02d}" for k in range(1, 6)]
        if pose == 4:
            names[0], names[3] = names[3], names[0]
        rows = [*zip([f"base_B{k:02d}" for k in range(1, 6)], base, strict=True)]
        rows += [*zip(names, plate @ R.T + shift, strict=True)]
        text = "".join(f"{name}\t{x:.4f}\t{y:.4f}\t{z:.4f}\n" for name, (x, y, z) in rows)
        (tmp_path / f"Messung_{pose:02d}.txt").write_text(text)
    _, document = init(tmp_path)
    found = table(tmp_path, document, POINTS).table
    pairs = set(zip(found.column("body").to_pylist(), found.column("target").to_pylist(), strict=True))
    assert {body for body, _ in pairs} == {"base", "plat"}
    assert {target[0] for body, target in pairs if body == "plat"} == {"P"}
    assert {target[0] for body, target in pairs if body == "base"} == {"B"}


def test_a_flange_next_to_the_base_is_the_tip_of_a_chain(tmp_path: Path) -> None:
    heads = ["Objects", "100", ",,Base_Global,,,,,,Flange_Global,,,,,", "Frame,Sub Frame" + ",RX,RY,RZ,TX,TY,TZ" * 2]
    heads.append("," + ",rad,rad,rad,mm,mm,mm" * 2)
    angles = RNG.uniform(-1.0, 1.0, (12, 3)).round(6)
    rows = [
        ",".join(map(str, [k, 0, 0.1, 0.2, 0.3, 3000, 10, 20, *angle, *place]))
        for k, (angle, place) in enumerate(zip(angles, PLACES, strict=True), 1)
    ]
    (tmp_path / "Trial.csv").write_text("\n".join([*heads, *rows]) + "\n")
    (tmp_path / "DH.csv").write_text("\n".join(DH) + "\n")
    log = [",".join(map(str, [k, *row])) for k, row in enumerate(np.rad2deg(JOINTS).round(4), 1)]
    (tmp_path / "joints.csv").write_text("\n".join(["pose,J1,J2,J3", *log]) + "\n")
    _, document = init(tmp_path)
    assert document["measurement"] == {"frame": "campaign"}
    found = table(tmp_path, document, POSES)
    bodies = np.array(found.table.column("body").to_pylist())
    assert set(bodies) == {"base", "tip"}
    places = numbers(found, "x_mm", "y_mm", "z_mm")
    assert_close(places[bodies == "tip"], PLACES, atol=0.0, what="places of the tip")


@pytest.mark.parametrize(
    ("heads", "last", "factor"),
    [
        (("Angle consigne (grad)", "Lecture Hz (grad)"), 350.0, 0.9),
        (("Soll [Grad]", "Ablesung [Grad]"), 350.0, 1.0),
        (("Soll [Grad]", "Ablesung [Grad]"), 400.0, 0.9),  # beyond a turn in degrees
        (("command [grad]", "measured [grad]"), 350.0, 0.9),
    ],
)
def test_grad_is_asked_and_read_by_language_and_numbers(
    tmp_path: Path, heads: tuple[str, str], last: float, factor: float
) -> None:
    commands = np.linspace(0.0, last, 15)
    rows = [f"{a:.4f};{a + 0.004 * np.sin(a):.5f}".replace(".", ",") for a in commands]
    (tmp_path / "table.csv").write_text("\n".join([";".join(heads), *rows]) + "\n", encoding="cp1252")
    reported, document = init(tmp_path)
    assert "unit_of_angle" in reported
    found = numbers(table(tmp_path, document, CONFIGURATIONS), "command_deg")
    assert_close(found[:, 0], factor * commands, atol=1e-4, what="commands, deg")


def test_grad_is_a_unit_at_the_end_of_a_name() -> None:
    assert all(map(is_grad, ("Angle (grad)", "Winkel [Grad]", "angle_grad", "Winkel / Grad", "gisement [grades]")))
    assert not any(map(is_grad, ("Angle [deg]", "gradient", "grad", "Grade of steel")))


def bag(folder: Path, at: list[float], *, moving: bool = False) -> None:
    """Write a robot's log of 5 rows per second that stands still for two seconds in each of 12 poses, and a list of
    places measured at times (s after its begin) in a zone one hour ahead."""
    (folder / "arm.urdf").write_text(URDF)
    begin = datetime(2026, 11, 27, 8, 0, 0, tzinfo=UTC).timestamp()
    rows = [row for k in range(12) for row in ([JOINTS[k]] * 10 + [JOINTS[k] + 0.1 * j for j in range(1, 4)])]
    rows = [row + 0.01 * k * moving for k, row in enumerate(rows)]
    lines = [f"{begin + 0.2 * k:.3f}," + ",".join(f"{angle:.6f}" for angle in row) for k, row in enumerate(rows)]
    (folder / "bag.csv").write_text("\n".join(["time,pan,lift,twist", *lines]) + "\n")
    clock = [datetime.fromtimestamp(begin + 3600.0 + t, UTC).strftime("%d.%m.%Y %H:%M:%S") for t in at]
    cells = [
        ";".join(map(str, (k, c, *p))).replace(".", ",") for k, (c, p) in enumerate(zip(clock, PLACES, strict=True), 1)
    ]
    cells = [cell.replace(",11,2026", ".11.2026") for cell in cells]
    (folder / "places.csv").write_text("\n".join(["Nr.;Zeit;X (mm);Y (mm);Z (mm)", *cells]) + "\n")


def test_rows_of_a_continuous_log_at_the_times_of_places_are_their_poses(tmp_path: Path) -> None:
    bag(tmp_path, [2.6 * k + 1.0 for k in range(12)])
    _, document = init(tmp_path)
    log = table(tmp_path, document, CONFIGURATIONS)
    assert log.table.column("pose").to_pylist() == list(range(1, 13))
    assert_close(numbers(log, "pan_rad", "lift_rad", "twist_rad"), JOINTS, atol=0.0, what="joints")
    points = table(tmp_path, document, POINTS)
    assert set(points.table.column("body").to_pylist()) == {"hand"}
    assert_close(numbers(points, "x_mm", "y_mm", "z_mm"), PLACES, atol=0.0, what="places")


def test_a_log_that_moves_at_the_times_of_places_is_not_joined(tmp_path: Path) -> None:
    bag(tmp_path, [2.6 * k + 1.0 for k in range(12)], moving=True)
    _, document = init(tmp_path)
    assert "select" not in document["files"]["configurations"]


def test_a_word_before_numbers_in_a_list_of_blanks_is_no_coordinate(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(URDF)
    log = ["pan,lift,twist", *(",".join(map(str, row)) for row in JOINTS)]
    (tmp_path / "log.csv").write_text("\n".join(log) + "\n")
    rows = [f"point {k} {x} {y} {z}" for k, (x, y, z) in enumerate(PLACES, 1)]
    (tmp_path / "list.txt").write_text("\n".join(["# Units: Millimeters", *rows]) + "\n")
    _, document = init(tmp_path)
    assert_close(numbers(table(tmp_path, document, POINTS), "x_mm", "y_mm", "z_mm"), PLACES, atol=0.0, what="places")


def test_theoretical_and_real_positions_are_command_and_encoder(tmp_path: Path) -> None:
    x = np.arange(0.0, 0.4, 0.02)
    rows = [f"{5 * k},{a:.6e},{a + 1e-8:.8e},{a * 1.00001:.8e}" for k, a in enumerate(x)]
    head = "time [s],M10 theoretical position [m],ML1 real position [m],interferometer [m]"
    (tmp_path / "trace.csv").write_text("\n".join([head, *rows]) + "\n")
    _, document = init(tmp_path)
    found = numbers(table(tmp_path, document, CONFIGURATIONS), "command_mm", "motor_mm", "measured_mm")
    assert_close(found, 1e3 * np.transpose([x, x + 1e-8, 1.00001 * x]), atol=1e-5, what="positions, mm")


def test_names_with_blanks_in_a_list_that_blanks_separate_are_read(tmp_path: Path) -> None:
    base, plate = RNG.uniform(-400.0, 400.0, (2, 4, 3)).round(3)
    lines = ["// Units: Millimeters"]
    for pose in range(1, 5):
        R = exp_so3([0.0, 0.0, 0.05 * pose])
        for body, places in (("Base plate", base), ("Moving plate", plate @ R.T)):
            lines += [f"A::{body} pose {pose}::Pt {k}  {x:.4f} {y:.4f} {z:.4f}" for k, (x, y, z) in enumerate(places)]
    (tmp_path / "list.txt").write_text("\n".join(lines) + "\n")
    _, document = init(tmp_path)
    found = table(tmp_path, document, POINTS)
    assert set(found.table.column("body").to_pylist()) == {"Base plate", "Moving plate"}
    assert set(found.table.column("target").to_pylist()) == {f"Pt {k}" for k in range(4)}
    first = numbers(found, "x_mm", "y_mm", "z_mm")[:4]
    assert_close(first, base, atol=1e-9, what="places of the base")
    assert found.table.column("pose").to_pylist() == [k for k in range(1, 5) for _ in range(8)]


def test_groups_of_one_target_are_its_poses(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(URDF)
    log = [",".join(map(str, (k, *row))) for k, row in enumerate(JOINTS, 1)]
    (tmp_path / "log.csv").write_text("\n".join(["pose,pan,lift,twist", *log]) + "\n")
    rows = [f"A::Pose {k}::T1 {x} {y} {z}" for k, (x, y, z) in enumerate(PLACES, 1)]
    (tmp_path / "list.txt").write_text("\n".join(rows) + "\n")
    _, document = init(tmp_path)
    found = table(tmp_path, document, POINTS)
    assert set(found.table.column("body").to_pylist()) == {"hand"}
    assert_close(numbers(found, "x_mm", "y_mm", "z_mm"), PLACES, atol=0.0, what="places")


def test_bodies_with_numbers_in_their_names_are_found(tmp_path: Path) -> None:
    base, leg = RNG.uniform(-400.0, 400.0, (2, 4, 3))
    for pose in range(1, 7):
        R = exp_so3(RNG.normal(0.0, 0.1, 3))
        rows = [*zip([f"base_B{k:02d}" for k in range(4)], base, strict=True)]
        rows += [*zip([f"leg1_L1{k:02d}" for k in range(4)], leg @ R.T, strict=True)]
        text = "".join(f"{name};{x:.4f};{y:.4f};{z:.4f}\n" for name, (x, y, z) in rows)
        (tmp_path / f"Stage {pose}.csv").write_text("Name;X [mm];Y [mm];Z [mm]\n" + text)
    _, document = init(tmp_path)
    found = table(tmp_path, document, POINTS)
    assert set(found.table.column("body").to_pylist()) == {"base", "leg1"}
