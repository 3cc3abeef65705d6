"""Loads on an elastic hexapod and stiffness along the motion by command line, against the least strain energy."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from tests.ignored_causes import search_only
from tests.second_hand import photogrammetry
from tests.second_hand.command import figure, run
from tests.second_hand.elastic_hexapod import GRAVITY, Elastic, Hexapod, design
from tests.second_hand.photogrammetry import Seen, vector
from tests.tolerance import assert_between

POSES, HELD_OUT, TRAVEL, OFF = 24, 6, 1.0e-3, 0.1e-3  # m
CENTRE = np.array([0.02, -0.03, 0.10])  # of the payload, m


def _made(drawing: Hexapod) -> Hexapod:
    rng = np.random.default_rng(7)
    a, b = (joints + rng.normal(0, OFF, joints.shape) for joints in (drawing.a, drawing.b))
    return replace(drawing, a=a, b=b, length=drawing.length + rng.normal(0, OFF, 6))


@cache
def _truth() -> tuple[Seen, dict[str, np.ndarray]]:
    rng, machine, count = np.random.default_rng(8), _made(design()), POSES + HELD_OUT
    readings = machine.reading + TRAVEL * rng.uniform(-1, 1, (count, 6))
    load = rng.uniform(-1, 1, (count, 6)) * [200.0, 200.0, 500.0, 20.0, 20.0, 20.0]
    payload = rng.uniform(0, 30, count)
    elastic = Elastic(machine)
    held = [
        elastic.pose(reading, one, GRAVITY * mass, CENTRE)
        for reading, one, mass in zip(readings, load, payload, strict=True)
    ]
    roles = ["calibration"] * POSES + ["verification"] * HELD_OUT
    names = ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")
    columns = {**dict(zip(names, load.T, strict=True)), "payload_kg": payload}
    return Seen(np.stack([p for p, _ in held]), np.stack([R for _, R in held]), readings, roles), columns


def _campaign(folder: Path) -> Path:
    drawing, (seen, columns) = design(), _truth()
    legs = "".join(
        f"  {{ a_mm = {vector(a)}, b_mm = {vector(b)}, length_mm = {1e3 * length:.9f}, rho0_mm = {1e3 * rho:.6f}, "
        f"flexure_length_mm = 10.0 }},\n"
        for a, b, length, rho in zip(drawing.a, drawing.b, drawing.length, drawing.reading, strict=True)
    )
    mechanism = f'type = "ups"\nstiffness_along_motion = true\npayload_com_mm = {vector(CENTRE)}\nlegs = [\n{legs}]\n'
    sections = (
        f"[mechanism.tolerance]\na_mm = {1e3 * OFF}\nb_mm = {1e3 * OFF}\nlength_mm = {1e3 * OFF}\n"
        "[mechanism.flexure]\ndiameter_mm = 2.0\nyoungs_gpa = 114.0\npoisson = 0.34\n"
        "[mechanism.leg_tube]\ndiameter_mm = 12.0\nyoungs_gpa = 150.0\npoisson = 0.30\n"
        "[measurement]\nup = [0.0, 0.0, 1.0]\n"
    )
    return photogrammetry.write(folder, seen, mechanism, sections, np.random.default_rng(9), columns=columns)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, pd.DataFrame]:
    place = tmp_path_factory.mktemp("loaded")
    return run(search_only(_campaign(place / "c")), "calibrate", place / "run")


def test_only_legs_whose_stiffness_follows_the_motion_leave_noise(found: dict[str, pd.DataFrame]) -> None:
    """Chi square of the loaded machine: of noise along the motion, of second order at the reference, of loads without
    stiffness."""
    chi = {model: figure(found, model, "chi_square") for model in ("ups", "stiffness", "stiffness-along")}
    freedom = figure(found, "stiffness-along", "freedom")
    low, high = (float(chi2.ppf(q, freedom)) for q in (1e-3, 1 - 1e-3))
    assert_between(chi["stiffness-along"], low, high, what="along the motion")
    assert chi["stiffness"] > float(chi2.ppf(1 - 1e-5, freedom))
    assert chi["ups"] > 20 * freedom
    assert figure(found, "stiffness-along", "chosen") == 1.0


def test_the_platform_gives_way_to_its_loads_as_the_least_energy_says(found: dict[str, pd.DataFrame]) -> None:
    elastic, (seen, columns) = Elastic(design()), _truth()
    *wrench, payload = columns.values()
    moved = []
    for reading, load, mass in zip(seen.readings, np.stack(wrench, 1), payload, strict=True):
        free, held = elastic.pose(reading, 0 * load, 0.0, CENTRE), elastic.pose(reading, load, GRAVITY * mass, CENTRE)
        moved.append(1e6 * (held[0] - free[0]))
    shift = np.array(moved)
    # A leg 1 mm longer is softer by 0.13 %, and the load turns with it by as much: no more than that separates them.
    for name, own in (("load_shift_rms", shift), ("load_shift_varying", shift - shift.mean(0))):
        reported = figure(found, "stiffness", name, estimator="nominal")
        assert reported == pytest.approx(np.sqrt(np.mean(np.sum(own**2, 1))), rel=3e-3)


def test_the_machine_is_recovered_within_its_uncertainty(found: dict[str, pd.DataFrame]) -> None:
    made = _made(design())
    places = {
        f"{name}_{axis}": joints[:, k]
        for name, joints in (("a", made.a), ("b", made.b))
        for k, axis in enumerate("xyz")
    }
    true = {**places, "l": made.length}
    rows = found["calibration"].query("model == 'stiffness-along' and deformation == 'none'")
    off = [(row.identified - 1e3 * true[row.parameter][int(row.leg) - 1]) / row.sigma for row in rows.itertuples()]
    assert len(off) == 42
    # Errors of 42 numbers correlate: about 24 are determined; four standard deviations of their mean square: 1.15.
    assert_between(float(np.mean(np.square(off))), 0.35, 2.15, what="squares")
    errors = found["accuracy"].query("model == 'stiffness-along' and deformation == 'none' and role == 'verification'")
    noise = figure(found, "stiffness-along", "position_noise_verification")
    assert len(errors) == HELD_OUT
    # 18 components: the root of their mean square scatters by 17 %.
    rms = float(np.sqrt(np.mean(errors["position_error_um"] ** 2)))
    assert_between(rms / noise, 0.4, 1.6, what="held out over noise")
