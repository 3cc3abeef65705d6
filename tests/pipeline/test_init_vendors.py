"""`truing init` on exports of vendors' programs: nominal next to measured values, units, encoders, bridges."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.pipeline.test_init_exports import URDF, init, numbers, table
from tests.tolerance import assert_close
from truing.formats.raw_tables import CONFIGURATIONS, POINTS, SIGNALS

RNG = np.random.default_rng(23)
TARGETS = [f"{body}{number}" for body in ("base", "plate") for number in range(1, 5)]
AT_REST = RNG.uniform(-300.0, 300.0, (len(TARGETS), 3)).round(3)


def places(pose: int) -> np.ndarray:
    """Places of the targets, mm: the plate moves along z."""
    return (
        AT_REST + np.array([[0.0, 0.0, 7.0 * pose if name.startswith("plate") else 0.0] for name in TARGETS])
    ).round(3)


@pytest.mark.parametrize("head", ["Meas {}", "{} Meas", "Actual {}", "{} Ist"])
def test_measured_coordinates_are_read_next_to_nominal_ones(tmp_path: Path, head: str) -> None:
    names = ["Name", *"XYZ", *(head.format(axis) for axis in "XYZ"), *(f"Dev {axis}" for axis in "XYZ")]
    for pose in range(3):
        rows = [
            "\t".join([name, *(f"{value:.3f}" for value in (*rest, *at, *(at - rest)))])
            for name, rest, at in zip(TARGETS, AT_REST, places(pose), strict=True)
        ]
        (tmp_path / f"Piece {pose}.txt").write_text("\n".join(["\t".join(names), *rows]) + "\n")
    _, document = init(tmp_path)
    found = table(tmp_path, document, POINTS)
    expected = np.concatenate([places(pose) for pose in range(3)])
    assert_close(numbers(found, "x_mm", "y_mm", "z_mm"), expected, atol=1e-9, what="places")
    assert set(found.table.column("body").to_pylist()) == {"base", "plate"}


def test_markers_alone_have_no_kind_in_their_bodies(tmp_path: Path) -> None:
    marks = [f"{name[:-1]}:{name}" for name in TARGETS]
    rows = [["Format Version", "1.23", "Length Units", "Millimeters"], []]
    rows += [["", "Type", *["Marker"] * 24], ["", "Name", *(m for m in marks for _ in "xyz")]]
    rows += [["", "ID", *(f"{number:032d}" for number in range(24))], ["", "", *["Position"] * 24]]
    rows += [["Frame", "Time (Seconds)", *"XYZ" * 8]]
    rows += [[str(pose), str(pose / 120), *map(str, places(pose).ravel())] for pose in range(4)]
    (tmp_path / "Take.csv").write_text("\n".join(",".join(row) for row in rows) + "\n")
    _, document = init(tmp_path)
    found = table(tmp_path, document, POINTS)
    assert set(found.table.column("body").to_pylist()) == {"base", "plate"}
    assert_close(numbers(found, "x_mm", "y_mm", "z_mm")[:8], places(0), atol=1e-9, what="places")


def test_a_mark_of_arc_seconds_opens_no_quotation_and_degrees_are_a_rotary_axis(tmp_path: Path) -> None:
    at = [float(angle) for angle in (0, 30, 60, 90, 60, 30, 0)]
    rows = [f"1\t{'+' if k < 3 else '-'}\t{a:.4f}\t{a + 1e-3:.6f}\t3,60".replace(".", ",") for k, a in enumerate(at)]
    head = 'Lauf\tRichtung\tSollposition [°]\tIstposition [°]\tAbweichung ["]'
    (tmp_path / "C.txt").write_text("\n".join(["Rundtisch", "", head, *rows]) + "\n", encoding="latin-1")
    _, document = init(tmp_path)
    found = table(tmp_path, document, CONFIGURATIONS)
    assert_close(numbers(found, "command_deg", "measured_deg"), np.column_stack([at, np.add(at, 1e-3)]), atol=1e-9)
    assert not [name for name in found.table.column_names if name.startswith("Abweichung")], "computed from the others"


def test_two_encoders_without_a_command_are_compared_and_microseconds_are_seconds(tmp_path: Path) -> None:
    rows = [f"{k};{k * 100_000};{5.0 * k:.7f};{5.0 * k + 1e-3:.7f}" for k in range(9)]
    head = "Trigger counter;Timestamp [us];Axis 1 Position [deg];Axis 2 Position [deg]"
    (tmp_path / "log.csv").write_text("\n".join([head, *rows]) + "\n")
    _, document = init(tmp_path)
    found = table(tmp_path, document, CONFIGURATIONS)
    expected = np.column_stack([0.1 * np.arange(9), 5.0 * np.arange(9), 5.0 * np.arange(9) + 1e-3])
    assert_close(numbers(found, "time_s", "command_deg", "measured_deg"), expected, atol=1e-9)


def test_one_component_next_to_bridges_is_a_load(tmp_path: Path) -> None:
    values = RNG.normal(size=(5, 6)).round(6)
    head = ["\t".join(["Kraft Fx", *(f"Kanal {k}" for k in range(1, 7))]), "\t".join(["N", *["mV/V"] * 6])]
    rows = ["\t".join([str(100.0 * k), *map(str, row)]).replace(".", ",") for k, row in enumerate(values)]
    (tmp_path / "fx.asc").write_text("\n".join([*head, *rows]) + "\n")
    _, document = init(tmp_path)
    found = table(tmp_path, document, SIGNALS)
    assert_close(numbers(found, "fx_n"), 100.0 * np.arange(5.0)[:, None], atol=1e-9)
    assert_close(numbers(found, *(f"v{k}_mv" for k in range(1, 7))), values, atol=1e-9)


@pytest.mark.parametrize(("factor", "unit"), [(1e-3, "m"), (1.0, "mm")])
def test_targets_next_to_the_joints_of_a_described_robot_are_on_its_last_link(
    tmp_path: Path, factor: float, unit: str
) -> None:
    (tmp_path / "arm.urdf").write_text(URDF)
    joints = RNG.uniform(-1.5, 1.5, (6, 3)).round(6)
    log = [
        ",".join(["Pose", "pan", "lift", "twist"]),
        *(f"{k}," + ",".join(map(str, row)) for k, row in enumerate(joints)),
    ]
    (tmp_path / "joints.csv").write_text("\n".join(log) + "\n")
    at = RNG.uniform(500.0, 2000.0, (6, 3)).round(3)
    rows = [f"{k},T1," + ",".join(f"{value * factor:.6f}" for value in row) for k, row in enumerate(at)]
    (tmp_path / "tracker.csv").write_text("\n".join(["Pose,Target,X,Y,Z", *rows]) + "\n")
    _, document = init(tmp_path)
    assert document["files"]["points"].get("unit", "mm") == unit
    found = table(tmp_path, document, POINTS)
    assert set(found.table.column("body").to_pylist()) == {"hand"}
    assert_close(numbers(found, "x_mm", "y_mm", "z_mm"), at, atol=1e-9, what="places")


@pytest.mark.parametrize(("head", "factor"), [("2-Sigma", 2.0), ("3 Sigma", 3.0)])
def test_a_trackers_multiples_of_sigma_are_divided(tmp_path: Path, head: str, factor: float) -> None:
    names = ["Pose", "Body", "Target", *(f"{axis} [m]" for axis in "XYZ"), *(f"{head} {axis}" for axis in "XYZ")]
    row = ["1", "base", "P1", "1.5", "2.5", "0.5", "0.00003", "0.00003", "0.00003"]
    (tmp_path / "p.csv").write_text(",".join(names) + "\n" + ",".join(row) + "\n" + ",".join(row).replace("P1", "P2"))
    _, document = init(tmp_path)
    found = table(tmp_path, document, POINTS)
    assert_close(numbers(found, "sigma_x_mm"), np.full((2, 1), 0.03 / factor), atol=1e-12)


@pytest.mark.parametrize("head", ["T [°C]", "Temp [C]", "Temperatur [°C]"])
def test_a_letter_with_degrees_celsius_is_a_temperature(tmp_path: Path, head: str) -> None:
    names = ["Pose", "Zeit", *(f"rho{k} [mm]" for k in range(1, 7)), head]
    rows = [",".join([str(k), str(60 * k), *["10.5"] * 6, f"{20 + k / 10:.1f}"]) for k in range(3)]
    (tmp_path / "log.csv").write_text("\n".join([",".join(names), *rows]) + "\n", encoding="utf-8")
    _, document = init(tmp_path)
    found = table(tmp_path, document, CONFIGURATIONS)
    assert_close(numbers(found, "temperature_c", "time_s"), [[20.0, 0.0], [20.1, 60.0], [20.2, 120.0]], atol=1e-9)


def test_targets_lost_in_some_poses_and_gross_errors_leave_bodies_apart(tmp_path: Path) -> None:
    """Markers without words: each fifth is hidden once, and one is off by 50 mm once."""
    for pose in range(20):
        at = places(pose) + RNG.normal(0.0, 5e-3, (8, 3)) + (np.eye(8)[3] * 50.0)[:, None] * (pose == 4)
        rows = [
            f"target {k + 1},,,,,,,," + ",".join(f"{value / 1e3:.8f}" for value in row)
            for k, row in enumerate(at)
            if (pose + k) % 20
        ]
        head = (
            '# CoordinateSystem: LOCAL_CS["Local Coordinates (m)"]\n#Label,X/Easting,Y/Northing,Z/Altitude,Error_(m),'
        )
        head += "X_error,Y_error,Z_error,X_est,Y_est,Z_est"
        (tmp_path / f"markers_pose{pose}.txt").write_text("\n".join([head, *rows]) + "\n")
    _, document = init(tmp_path)
    found = table(tmp_path, document, POINTS)
    body_of = dict(zip(found.table.column("target").to_pylist(), found.table.column("body").to_pylist(), strict=True))
    assert [body_of[f"target {k}"] for k in range(1, 9)] == ["body1"] * 4 + ["body2"] * 4
    assert "no unit is given" not in (tmp_path / "campaign.toml").read_text(encoding="utf-8")
