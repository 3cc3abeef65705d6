"""Campaigns with noise declared in columns only, or with identical points, pass all stages."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from truing.pipeline.command_line import app
from truing.pipeline.problems import ExitCode

SIGMAS = ("sigma_x_mm", "sigma_y_mm", "sigma_z_mm")


def write(path: Path, rows: Sequence[Mapping[str, object]]) -> None:
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(rows)


def campaign(
    folder: Path, targets: int = 4, poses: int = 8, sigma: float | None = None, survey: bool = True, noise: bool = True
) -> Path:
    """A base whose points are the same in all poses, and a dish that rises with a drive next to it."""
    rng = np.random.default_rng(1)
    bodies = {"base": rng.uniform(-300, 300, (targets, 3)), "dish": rng.uniform(-300, 300, (targets, 3))}
    reported = {} if sigma is None else dict.fromkeys(SIGMAS, sigma)

    def at(pose: int, body: str, point: np.ndarray) -> np.ndarray:
        return point if body == "base" else point + np.array([0.0, 0.0, 0.1 * pose]) + rng.normal(0.0, 0.005, 3)

    def row(pose: int, body: str, k: int, point: np.ndarray) -> dict[str, object]:
        places = zip(("x_mm", "y_mm", "z_mm"), at(pose, body, point).round(6), strict=True)
        return {"pose": pose, "body": body, "target": f"T{k}", **dict(places), **reported}

    folder.mkdir()
    every = [(body, k, point) for body, points in bodies.items() for k, point in enumerate(points)]
    write(folder / "points.csv", [row(pose, *one) for pose in range(poses) for one in every])
    roles = [{"pose": p, "role": "calibration", "time_s": 60 * p, "elevation_deg": 10 * p} for p in range(poses)]
    write(folder / "configurations.csv", roles)
    if survey:
        columns = ("body", "target", "x_mm", "y_mm", "z_mm")
        write(folder / "targets.csv", [dict(zip(columns, (b, f"T{k}", *x), strict=True)) for b, k, x in every])
    text = '[campaign]\nname = "b"\nkind = "photogrammetry"\ndrives = ["elevation_deg"]\n[bodies]\nreference = "base"\n'
    (folder / "campaign.toml").write_text(text + ("[noise]\npoint_mm = 0.005\n" if noise else ""))
    return folder


def run(folder: Path, out: Path) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["run", str(folder), "--out", str(out)])
    assert "Traceback" not in done.output
    assert "Warning" not in done.output
    return done.exit_code, done.output


@pytest.mark.parametrize("targets", [1, 2, 3, 4])
def test_an_exact_body_next_to_another(targets: int, tmp_path: Path) -> None:
    code, said = run(campaign(tmp_path / "c", targets), tmp_path / "run")
    assert code == (ExitCode.DONE if targets > 2 else ExitCode.FAILED_CHECK), said


@pytest.mark.parametrize(("targets", "poses"), [(3, 8), (4, 1), (4, 2)])
def test_sigma_columns_in_every_row_and_no_noise_declared(targets: int, poses: int, tmp_path: Path) -> None:
    folder = campaign(tmp_path / "c", targets, poses, sigma=0.005, survey=False, noise=False)
    code, said = run(folder, tmp_path / "run")
    assert code == ExitCode.DONE, said


@pytest.mark.parametrize("command", ["check", "run"])
def test_a_survey_of_which_nothing_says_how_good_it_is(command: str, tmp_path: Path) -> None:
    folder = campaign(tmp_path / "c", sigma=0.005, noise=False)
    out = ["--out", str(tmp_path / "run")] if command == "run" else []
    done = CliRunner().invoke(app, [command, str(folder), *out])
    assert done.exit_code == ExitCode.UNUSABLE_CAMPAIGN, done.output
    (line,) = done.stderr.splitlines()
    assert "noise.point_mm: expected a standard deviation of surveyed targets" in line
    write(folder / "targets.csv", [{**row, **dict.fromkeys(SIGMAS, 0.005)} for row in read(folder / "targets.csv")])
    done = CliRunner().invoke(app, ["check", str(folder)])
    assert done.exit_code == ExitCode.DONE, done.output


def read(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("sigma", [0.0, 5e-324, 1e-300, 1e-12, 1e9])
def test_standard_deviations_that_no_instrument_has_are_faults(sigma: float, tmp_path: Path) -> None:
    folder = campaign(tmp_path / "c", sigma=sigma)
    done = CliRunner().invoke(app, ["check", str(folder)])
    assert done.exit_code == ExitCode.UNUSABLE_CAMPAIGN, done.output
    assert "points.csv, row 2, column sigma_x_mm" in done.stderr
    assert "expected a standard deviation above 0, from 1e-09 to 1e+06 mm" in done.stderr
