"""`truing init` on exports that belong together: by time, by parts of one list, by names with words, by axes."""

from __future__ import annotations

import tomllib
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.pipeline.test_init_exports import init, numbers, table
from tests.tolerance import assert_close
from truing.formats.raw_tables import CONFIGURATIONS, LOADS_APART, POINTS, POSES, SIGNALS, TARGETS
from truing.pipeline.command_line import app

RNG = np.random.default_rng(41)
START = datetime(2026, 3, 12, 9, 0, tzinfo=timezone(timedelta(hours=1)))


def _write(path: Path, lines: list[str], encoding: str = "utf-8") -> None:
    path.write_text("\n".join([*lines, ""]), encoding=encoding)


def _arm(folder: Path, shots: list[int], gaps_s: list[float], late_s: float) -> tuple[np.ndarray, np.ndarray]:
    """A log of as many rows as gaps, and poses of its rows ``shots``, whose clock is in UTC and later."""
    joints = RNG.uniform(-1.0, 1.0, (len(gaps_s), 4)).round(6)
    places = RNG.uniform(-900.0, 900.0, (len(gaps_s), 3)).round(3)
    times = [START + timedelta(seconds=float(gap)) for gap in np.cumsum(gaps_s)]
    rows = [",".join([one.isoformat(), *map(str, row)]) for one, row in zip(times, joints, strict=True)]
    _write(folder / "log.csv", ["timestamp,joint1,joint2,joint3,joint4", *rows])
    head, rows = "Name,X,Y,Z,Q0,Q1,Q2,Q3,Time", []
    for number, row in enumerate(shots):
        again = timedelta(seconds=late_s + 0.4 * shots[:number].count(row))
        clock = (times[row] + again).astimezone(UTC).strftime("%d.%m.%Y %H:%M:%S.%f")
        rows.append(",".join([f"S{number}", *map(str, places[row]), "1", "0", "0", "0", clock]))
    _write(folder / "poses.csv", [head, *rows])
    return joints, places


def test_poses_are_joined_to_a_log_of_fewer_rows_by_time(tmp_path: Path) -> None:
    gaps = RNG.uniform(9.0, 16.0, 12).round(3).tolist()
    shots = sorted([*range(12), 4, 9])
    _, places = _arm(tmp_path, shots, gaps, 1.7)
    _, document = init(tmp_path)
    found = table(tmp_path, document, POSES)
    poses = [int(pose) for pose in found.table.column("pose").to_pylist()]
    assert poses == list(range(1, 13))
    assert_close(numbers(found, "x_mm", "y_mm", "z_mm"), places, atol=1e-9, what="places")


@pytest.mark.parametrize("gaps", [[10.0] * 12, [10.0] * 6])
def test_rows_at_equal_intervals_are_not_joined_by_time(tmp_path: Path, gaps: list[float]) -> None:
    rows = len(gaps)
    _arm(tmp_path, list(range(rows)), gaps, 1.7)
    lines = (tmp_path / "poses.csv").read_text().splitlines()
    clock = (START + timedelta(seconds=10.0 * rows + 11.7)).astimezone(UTC).strftime("%d.%m.%Y %H:%M:%S.%f")
    _write(tmp_path / "poses.csv", [*lines, f"S99,1,2,3,1,0,0,0,{clock}"])
    printed, document = init(tmp_path)
    assert "rename" not in document["files"]["poses"]
    assert f"poses.csv has {rows + 1} rows, log.csv has {rows}" in printed


def _gantry(folder: Path, places: np.ndarray, files: int) -> None:
    lines = [f"N{number};" + ";".join(map(str, row)) for number, row in enumerate(places, 1)]
    _write(folder / "Istwerte.csv", ["Programm;;;", "Satz;X-Ist [mm];Y-Ist [mm];Z-Ist [mm]", *lines])
    for part, own in enumerate(np.array_split(np.arange(len(places)), files)):
        turn = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
        seen = (places[own] @ turn.T + RNG.uniform(-500.0, 500.0, 3)).round(4)
        rows = ["\t".join([f"pt {k + 1}", *map(str, row)]) for k, row in zip(own, seen, strict=True)]
        _write(folder / f"station{part + 1}.txt", ["Name\tX\tY\tZ", *rows])


@pytest.mark.parametrize("files", [1, 2])
def test_a_log_of_linear_axes_next_to_points_is_a_gantry(tmp_path: Path, files: int) -> None:
    places = RNG.uniform(0.0, 900.0, (20, 3)).round(3)
    _gantry(tmp_path, places, files)
    _, document = init(tmp_path)
    found, points = table(tmp_path, document, CONFIGURATIONS), table(tmp_path, document, POINTS)
    assert_close(numbers(found, "x_mm", "y_mm", "z_mm"), places, atol=1e-9, what="positions")
    assert [int(pose) for pose in points.table.column("pose").to_pylist()] == list(range(1, 21))
    assert [screw["kind"] for screw in document["mechanism"]["screws"]] == ["prismatic"] * 3
    assert document["measurement"]["frame"] == ("campaign" if files == 1 else "series")
    if files == 2:  # the instrument may have moved between both
        assert found.table.column("series").to_pylist() == ["1"] * 10 + ["2"] * 10


def test_every_key_holds_the_same_mechanism_and_frame(tmp_path: Path) -> None:
    _gantry(tmp_path, RNG.uniform(0.0, 900.0, (20, 3)).round(3), 2)
    _, document = init(tmp_path)
    (tmp_path / "campaign.toml").unlink()
    done = CliRunner().invoke(app, ["init", "--all", str(tmp_path)])
    assert done.exit_code == 0, done.stdout
    every_key = tomllib.loads((tmp_path / "campaign.toml").read_text(encoding="utf-8"))
    assert [every_key[key] for key in ("mechanism", "measurement")] == [document["mechanism"], document["measurement"]]


def test_positions_by_which_no_point_moves_are_no_gantry(tmp_path: Path) -> None:
    _gantry(tmp_path, RNG.uniform(0.0, 900.0, (20, 3)).round(3), 1)
    lines = (tmp_path / "Istwerte.csv").read_text().splitlines()
    _write(tmp_path / "Istwerte.csv", [*lines[:2], *lines[:1:-1]])
    _, document = init(tmp_path)
    assert "mechanism" not in document


def test_files_with_the_same_targets_are_poses(tmp_path: Path) -> None:
    places = RNG.uniform(0.0, 900.0, (2, 6, 3)).round(3)
    for pose, own in enumerate(places, 1):
        rows = ["\t".join([f"pt {k}", *map(str, row)]) for k, row in enumerate(own)]
        _write(tmp_path / f"Pose{pose}.txt", ["Name\tX\tY\tZ", *rows])
    _, document = init(tmp_path)
    assert "(?P<pose>" in document["files"]["points"]["from_name"]


def test_words_before_numbers_of_a_survey_name_the_groups_of_targets(tmp_path: Path) -> None:
    at_rest = RNG.uniform(-300.0, 300.0, (8, 3)).round(3)
    names = [*range(101, 105), *range(201, 205)]
    legs = RNG.uniform(100.0, 200.0, (6, 7)).round(3)
    head = "leg," + ",".join(f"{body}_{axis}_mm" for body in ("base", "platform") for axis in "xyz")
    geometry = [f"{k}," + ",".join(map(str, row)) for k, row in enumerate(legs, 1)]
    _write(tmp_path / "geometry.csv", [head + ",length_at_zero_mm", *geometry])
    words = ["B"] * 4 + ["P"] * 4
    survey = [f"{w}{n};" + ";".join(map(str, r)) for w, n, r in zip(words, names, at_rest, strict=True)]
    _write(tmp_path / "cmm.csv", ["Name;X;Y;Z", *survey])
    for pose in range(1, 5):
        moved = at_rest + np.array([[0.0, 0.0, 17.0 * pose if n > 200 else 0.0] for n in names])
        rows = [
            f"{n} " + " ".join(map("{:.4f}".format, r)) + " 0.01 0.01 0.01 5" for n, r in zip(names, moved, strict=True)
        ]
        _write(tmp_path / f"HEX_epoch{pose:02d}.obc", ["! pointno x[mm] y[mm] z[mm] sx sy sz rays", *rows])
    _, document = init(tmp_path)
    expected = ["base"] * 4 + ["platform"] * 4
    assert table(tmp_path, document, POINTS).table.column("body").to_pylist()[:8] == expected
    surveyed = table(tmp_path, document, TARGETS)
    assert surveyed.table.column("body").to_pylist() == expected
    assert [int(target) for target in surveyed.table.column("target").to_pylist()] == names
    assert len(document["mechanism"]["legs"]) == 6


def test_loads_with_a_zone_are_joined_to_bridges_below_formats_of_time(tmp_path: Path) -> None:
    loads = np.diag([100.0, 100.0, 200.0, 5000.0, 5000.0, 5000.0]).repeat(2, axis=0)
    volts = RNG.uniform(-1.0, 1.0, (12, 6)).round(6)
    times = [START + timedelta(seconds=60 * k) for k in range(12)]
    head = "Zeit (UTC);" + ";".join([*(f"F{a} [N]" for a in "xyz"), *(f"M{a} [Nmm]" for a in "xyz")])
    rows = [
        ";".join([one.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"), *map(str, row)])
        for one, row in zip(times, loads, strict=True)
    ]
    _write(tmp_path / "loads.csv", [head, *rows])
    above = ["catman", "Zeit\t" + "\t".join(f"K{k}" for k in range(1, 7)), "dd.mm.yyyy hh:mm:ss" + "\tmV/V" * 6]
    rows = [
        "\t".join([one.strftime("%d.%m.%Y %H:%M:%S"), *map(str, row)]) for one, row in zip(times, volts, strict=True)
    ]
    _write(tmp_path / "bridges.asc", [*above, *rows], "utf-16")
    _, document = init(tmp_path)
    assert document["files"]["loads"]["joined_by"] == "rows"
    signals = table(tmp_path, document, SIGNALS)
    assert_close(numbers(signals, *(f"v{k}_mv" for k in range(1, 7))), volts, atol=1e-12, what="signals")
    applied = table(tmp_path, document, LOADS_APART)
    assert_close(numbers(applied, "fx_n", "mz_nm"), loads[:, [0, 5]] * [1.0, 1e-3], atol=1e-9, what="loads")


def test_files_of_equally_many_rows_are_reported_where_none_is_read(tmp_path: Path) -> None:
    _write(tmp_path / "one.csv", ["gizmo,widget", *(f"{k},{k * k}" for k in range(9))])
    _write(tmp_path / "two.csv", ["colour,shade", *(f"{k},{-k}" for k in range(9))])
    printed, document = init(tmp_path)
    assert "files" not in document
    assert "one.csv and two.csv have 9 rows each" in printed
    assert "no page can be made without a table" in printed


def test_stages_of_a_log_are_the_poses_of_the_files_with_these_numbers(tmp_path: Path) -> None:
    for stage in range(3):
        rows = [f"T{k},{k}.5,{stage}.25,{k * k}.75" for k in range(5)]
        _write(tmp_path / f"Stage {stage}.csv", ["Name,X,Y,Z", *rows])
    legs = RNG.uniform(9.0, 11.0, (3, 6)).round(4)
    rows = [",".join(map(str, [stage, *row])) for stage, row in enumerate(legs)]
    _write(tmp_path / "actuators.csv", ["Stage," + ",".join(f"Leg {k} [mm]" for k in range(1, 7)), *rows])
    _, document = init(tmp_path)
    shapes = {"points": POINTS, "configurations": CONFIGURATIONS}
    poses = {name: table(tmp_path, document, shape).table.column("pose").to_pylist() for name, shape in shapes.items()}
    assert set(map(int, poses["points"])) == set(map(int, poses["configurations"])) == {0, 1, 2}
