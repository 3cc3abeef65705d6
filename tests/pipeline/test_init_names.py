"""`truing init` on names with poses and bodies: distances between targets decide, and doubtful cases are asked."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from tests.pipeline.test_init_exports import init, numbers, table
from truing.formats.raw_tables import CONFIGURATIONS, POINTS, POSES, SIGNALS, TARGETS
from truing.formats.times import time_format_of
from truing.pipeline.command_line import app

RNG = np.random.default_rng(2024)
SHAPES = {name: RNG.uniform(-300.0, 300.0, (4, 3)) for name in ("base", "plate")}
POSES_OF_PLATE = [(Rotation.from_rotvec(RNG.normal(0.0, 0.05, 3)), RNG.normal(0.0, 30.0, 3)) for _ in range(5)]
Row = tuple[int, str, int, np.ndarray]


def rows() -> list[Row]:
    """Pose, body, number of target, and place: the base rests, the plate moves, both with noise."""
    found = []
    for pose, (rotation, shift) in enumerate(POSES_OF_PLATE, 1):
        for body, shape in SHAPES.items():
            places = shape if body == "base" else rotation.apply(shape) + shift
            places = (places + RNG.normal(0.0, 0.01, places.shape)).round(4)
            found += [(pose, body, number, place) for number, place in enumerate(places, 1)]
    return found


def written(folder: Path, head: str, name: Callable[[int, str, int], str], own: list[Row]) -> None:
    lines = [head, *(f"{name(*row[:3])},{','.join(f'{x:.4f}' for x in row[3])}" for row in own)]
    (folder / "export.csv").write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize(
    ("head", "name", "target"),
    [
        ("Group,Target,X,Y,Z", lambda k, b, n: f"{b}_pose{k:02d},p{n}", "p{n}"),
        ("Group,Target,X,Y,Z", lambda k, b, n: f"Pose {k} {b},p{n}", "p{n}"),
        ("Group,Target,X,Y,Z", lambda k, b, n: f"{b} {k},p{n}", "p{n}"),
        ("Group,Target,X,Y,Z", lambda k, b, n: f"{b}_P{k:02d},p{n}", "p{n}"),
        ("Collection::Group::Point,X,Y,Z", lambda k, b, n: f"A::{b} {k}::p{n}", "p{n}"),
        ("Group,Point,X,Y,Z", lambda k, b, n: f"Pose_{k},{b}{n}", "{b}{n}"),
        ("Piece,Name,Meas X,Meas Y,Meas Z", lambda k, b, n: f"{k},{b}_{n}", "{b}_{n}"),
        ("Name,X,Y,Z", lambda k, b, n: f"P{k}_{b}{n}", "{b}{n}"),
        ("Name,X,Y,Z", lambda k, b, n: f"{b}{n}_M{k}", "{b}{n}"),
    ],
)
def test_names_with_poses_and_bodies_are_taken_apart(
    tmp_path: Path, head: str, name: Callable[[int, str, int], str], target: str
) -> None:
    own = rows()
    written(tmp_path, head, name, own)
    text, document = init(tmp_path)
    found = table(tmp_path, document, POINTS)
    columns = (found.table.column(name).to_pylist() for name in ("pose", "body", "target"))
    expected = [(str(k), b, target.format(b=b, n=n)) for k, b, n, _ in own]
    assert [(str(k), b, t) for k, b, t in zip(*columns, strict=True)] == expected
    np.testing.assert_array_equal(numbers(found, "x_mm", "y_mm", "z_mm"), [place for *_, place in own])
    assert "# check:" in (tmp_path / "campaign.toml").read_text()
    assert "pose" in text


def test_bodies_next_to_readings_of_legs_are_base_and_platform(tmp_path: Path) -> None:
    written(tmp_path, "Group,Target,X,Y,Z", lambda k, b, n: f"{b.upper()}_P{k:02d},p{n}", rows())
    readings = [",".join([str(k), *(f"{10.0 + leg + 0.1 * k}" for leg in range(6))]) for k in range(1, 6)]
    (tmp_path / "log.csv").write_text(
        "\n".join(["Pose,L1 [mm],L2 [mm],L3 [mm],L4 [mm],L5 [mm],L6 [mm]", *readings, ""])
    )
    _, document = init(tmp_path)
    bodies = table(tmp_path, document, POINTS).table.column("body").to_pylist()
    assert bodies == ["base" if body == "base" else "platform" for _, body, *_ in rows()]
    assert "PLATE is taken for platform" in (tmp_path / "campaign.toml").read_text()


def test_bodies_without_readings_of_legs_keep_their_names(tmp_path: Path) -> None:
    written(tmp_path, "Group,Target,X,Y,Z", lambda k, b, n: f"{b.upper()}_P{k:02d},p{n}", rows())
    _, document = init(tmp_path)
    assert set(table(tmp_path, document, POINTS).table.column("body").to_pylist()) == {"BASE", "PLATE"}


def test_numbered_bodies_of_other_shapes_stay_bodies(tmp_path: Path) -> None:
    own = [(0, f"leg{i}", n, RNG.uniform(-100.0, 100.0, 3).round(4)) for i in (1, 2, 3) for n in (1, 2, 3, 4)]
    written(tmp_path, "Group,Target,X,Y,Z", lambda _, b, n: f"{b},p{n}", own)
    _, document = init(tmp_path)
    assert set(table(tmp_path, document, TARGETS).table.column("body").to_pylist()) == {"leg1", "leg2", "leg3"}


def test_numbered_groups_of_one_shape_are_asked(tmp_path: Path) -> None:
    """Legs of one drawing and poses of one leg look alike: both readings are one answer away."""
    own = [(0, f"leg{k}", n, place) for k, body, n, place in rows() if body == "plate"]
    written(tmp_path, "Group,Target,X,Y,Z", lambda _, b, n: f"{b},p{n}", own)
    _, document = init(tmp_path)
    assert document["files"].keys() == {"targets"}
    (tmp_path / "campaign.toml").unlink()
    assert CliRunner().invoke(app, ["init", str(tmp_path), "--answer", "numbers=poses"]).exit_code == 0
    assert "files.points" in (tmp_path / "campaign.toml").read_text()


def test_words_of_targets_that_move_together_are_no_bodies(tmp_path: Path) -> None:
    own = [(k, b, n, place) for k, b, n, place in rows() if b == "plate"]
    written(tmp_path, "Pose,Name,X,Y,Z", lambda k, _, n: f"{k},{'A' if n < 3 else 'P'}{n}", own)
    _, document = init(tmp_path)
    assert "split" not in document["files"]["points"]


LOADS = np.concatenate([np.zeros((1, 6)), np.kron(np.eye(6), [[50.0], [-50.0], [0.0]])])
SIGNALS_V = LOADS @ RNG.normal(0.0, 1e-5, (6, 6))


@pytest.mark.parametrize(("unit", "factor"), [("mVDC", 1.0), ("V", 1e3), ("mV/V", 1.0)])
def test_columns_in_volts_next_to_loads_are_signals(tmp_path: Path, unit: str, factor: float) -> None:
    head = ["Time (s)", *(f"F{a} (N)" for a in "xyz"), *(f"M{a} (Nm)" for a in "xyz")]
    head += [f"{100 + k} ({unit})" for k in range(1, 7)] + ["Excitation (V)"]
    data = np.column_stack([np.arange(len(LOADS)), LOADS, SIGNALS_V, np.full(len(LOADS), 5.0)])
    text = "\n".join([",".join(head), *(",".join(map(repr, map(float, row))) for row in data)])
    (tmp_path / "log.csv").write_text(text + "\n")
    _, document = init(tmp_path)
    found = table(tmp_path, document, SIGNALS)
    np.testing.assert_allclose(numbers(found, "fx_n", "fz_n", "mz_nm"), LOADS[:, [0, 2, 5]])
    volts = numbers(found, *(f"v{k}_mv" for k in range(1, 7)))
    np.testing.assert_allclose(volts, factor * SIGNALS_V, rtol=1e-12, atol=1e-15)
    (tmp_path / "campaign.toml").unlink()
    assert CliRunner().invoke(app, ["init", str(tmp_path), "--answer", "loads=shown"]).exit_code == 0
    assert "shown_fx_n" in (tmp_path / "campaign.toml").read_text()


@pytest.mark.parametrize("is_side_by_side", [False, True])
def test_poses_of_several_bodies_keep_their_bodies(tmp_path: Path, is_side_by_side: bool) -> None:
    turned = [rotation.as_quat() for rotation, _ in POSES_OF_PLATE]
    bodies = {"frame": [(np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, 0.0, 1.0]))] * len(turned)}
    bodies["head"] = [(shift, q) for (_, shift), q in zip(POSES_OF_PLATE, turned, strict=True)]
    parts = [("Rotation", a) for a in "XYZW"] + [("Position", a) for a in "XYZ"]
    lines = []
    for k in range(len(turned)):
        cells = {body: ",".join(map(repr, map(float, [*own[k][1], *own[k][0]]))) for body, own in bodies.items()}
        lines += [f"{k},{','.join(cells.values())}"] if is_side_by_side else [f"{k},{b},{c}" for b, c in cells.items()]
    if is_side_by_side:
        head = ["Frame", *(f"Rigid Body.{body}.{part}.{axis}" for body in bodies for part, axis in parts)]
    else:
        head = ["Frame", "Model", "QX", "QY", "QZ", "QW", "TX", "TY", "TZ"]
    (tmp_path / "take.csv").write_text("\n".join([",".join(head), *lines]) + "\n")
    _, document = init(tmp_path)
    found = table(tmp_path, document, POSES)
    names = zip(*(found.table.column(column).to_pylist() for column in ("pose", "body")), strict=True)
    read = {(b, int(k)): row for (k, b), row in zip(names, numbers(found, "x_mm", "qw", "qz"), strict=True)}
    assert len(read) == 2 * len(turned)
    for (body, k), row in read.items():
        place, quaternion = bodies[body][k]
        np.testing.assert_allclose(row, [place[0], quaternion[3], quaternion[2]])


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 2, 0)])  # poses first, poses last
def test_stacks_of_matlab_are_bodies_and_other_variables_readings(tmp_path: Path, order: tuple[int, ...]) -> None:
    places = {b: np.array([place for _, body, _, place in rows() if body == b]).reshape(-1, 4, 3) for b in SHAPES}
    count = len(POSES_OF_PLATE)
    content: dict[str, Any] = {body: np.transpose(own, order) for body, own in places.items()}
    content |= {"rho": RNG.normal(10.0, 1.0, (count, 6)), "T": RNG.normal(20.0, 0.1, (1, count)), "fs": 1.0}
    savemat(tmp_path / "run.mat", content)
    _, document = init(tmp_path)
    found = table(tmp_path, document, POINTS)
    for body, own in places.items():
        is_own = np.array(found.table.column("body").to_pylist()) == body
        np.testing.assert_allclose(numbers(found, "x_mm", "y_mm", "z_mm")[is_own], own.reshape(-1, 3))
    read = table(tmp_path, document, CONFIGURATIONS)
    np.testing.assert_allclose(numbers(read, *(f"rho{k}_mm" for k in range(1, 7))), content["rho"])
    assert "time_s" not in read.table.column_names  # T does not increase


@pytest.mark.parametrize(
    "text", ["2026-03-04 10:00:05", "04.03.2026 10:00:05.250", "3/14/2026 10:00:05 PM", "10:00:05"]
)
def test_the_format_of_a_time_reads_it(text: str) -> None:
    found = time_format_of([text, text])
    assert found is not None
    assert time_format_of([text, "soon"]) is None
    assert bool(found.doubt) == (text == "10:00:05")  # a time without a date


@pytest.mark.parametrize(("words", "coverage"), [("(1s)", None), ("(2s)", 2.0), ("1 sigma", None)])
def test_multiples_of_sigma_behind_the_name_of_an_uncertainty_are_its_factor(
    tmp_path: Path, words: str, coverage: float | None
) -> None:
    head = ",".join(["Id", *(f"{a} (mm)" for a in "XYZ"), *(f"U{a} {words} (mm)" for a in "xyz")])
    (tmp_path / "points.csv").write_text(f"{head}\n1,1,2,3,4,5,6\n")
    _, document = init(tmp_path)
    (entry,) = document["files"].values()
    assert [entry["columns"][f"sigma_{a}_mm"] for a in "xyz"] == [f"U{a} {words} (mm)" for a in "xyz"]
    assert entry.get("coverage") == (None if coverage is None else pytest.approx(coverage, rel=0.05))


def test_precisions_of_coordinates_are_sigmas(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text("Id,X (mm),Y (mm),Z (mm),X Precision,Y Precision,Z Precision\n1,1,2,3,4,5,6\n")
    _, document = init(tmp_path)
    (entry,) = document["files"].values()
    assert [entry["columns"][f"sigma_{a}_mm"] for a in "xyz"] == ["X Precision", "Y Precision", "Z Precision"]
