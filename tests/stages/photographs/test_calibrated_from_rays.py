"""Calibrations of a photographed machine: deviations from the truth agree with the stated uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from numpy.typing import NDArray

from tests.blind.generator.campaign import Campaign
from tests.blind.generator.schedule import random_moves
from tests.photographs.machine import copied, moved, stated_covariance
from tests.photographs.rays import Shooting, exact_campaign
from tests.stages.line import settings_of
from truing.calibration.calibration_input import CalibrationData
from truing.calibration.estimation_problem import Case, cases
from truing.calibration.fits import MachineCalibration, maximum_likelihood
from truing.estimation.rotation import exp_so3, log_so3
from truing.pipeline.in_memory import call_stage
from truing.simulation.mechanisms.structures.catalogue import structures
from truing.stages.common.calibration_data import assemble

Array = NDArray[np.float64]
Tables = dict[str, pa.Table]

POSES, DRAWS = 16, 7


def test_pose_and_shifts_scatter_together_as_handed_on(drawn: Tables) -> None:
    """Twelve numbers of a pose, measured again and again."""
    rows = drawn["poses"].to_pandas().query("default and body == 'platform'").set_index("pose")
    shifts = drawn["deformation"].to_pandas().pivot(index="pose", columns="leg", values="delta_bz_um").loc[rows.index]
    turned = exp_so3(rows[[f"r{a}_rad" for a in "xyz"]].to_numpy())
    theta = log_so3(turned @ turned[0].T)
    found = np.hstack([rows[[f"p{a}_mm" for a in "xyz"]] * 1e-3, theta, shifts * 1e-6])
    off = found - found.mean(0)
    names = [f"platform {n}" for n in ("px", "py", "pz", "rx", "ry", "rz")] + [f"shift {leg}" for leg in range(1, 7)]
    stated = _matrix(drawn["shift_covariances"].to_pandas().query("pose == 1"), names)
    stated[:6, :6] = [[rows[f"cov_{min(i, j)}_{max(i, j)}"].iloc[0] for j in range(6)] for i in range(6)]
    stated[:6, :6] -= _matrix(drawn["survey_covariances"].to_pandas(), names)[:6, :6]  # the same each time
    squares = np.einsum("bi,ij,bj->b", off, np.linalg.inv(stated), off)
    assert abs(squares.mean() / 12 - 1.0) < 4.0 * np.sqrt(2 / (12 * len(off)))


def test_poses_of_every_method_scatter_by_their_sigmas(drawn: Tables) -> None:
    """Errors of the survey are equal in all draws, though part of the stated variance: up to a third of it."""
    rows = drawn["poses"].to_pandas().query("body == 'platform'")
    assert set(rows["method"]) == {"umeyama", "haralick", "maximum_likelihood"}
    for _, found in rows.groupby("method"):
        turned = exp_so3(found[[f"r{a}_rad" for a in "xyz"]].to_numpy())
        off = np.hstack([found[[f"p{a}_mm" for a in "xyz"]] * 1e-3, log_so3(turned @ turned[0].T)])
        stated = found[[f"cov_{i}_{i}" for i in range(6)]].mean().to_numpy()
        ratio = off.var(axis=0, ddof=1) / stated
        assert np.abs(ratio - 1.0).max() < 4.0 * np.sqrt(2 / len(off))


def _matrix(given: pd.DataFrame, names: list[str]) -> Array:
    place, matrix = {name: n for n, name in enumerate(names)}, np.full((len(names), len(names)), np.nan)
    one, other = (given[name].map(place).to_numpy() for name in ("measured_number", "other_number"))
    matrix[one, other] = matrix[other, one] = given["joint_covariance"]
    return matrix


@dataclass(frozen=True)
class PointErrors:
    """Of one pose: names and places (n, 3) in mm of its points, root (3n, 3n) of the covariance of what is its own, and
    effects (3n, K) of what all poses share."""

    names: list[str]
    places: Array
    root: Array
    effects: Array


@pytest.fixture(scope="module")
def calibrated(adjusted: Any) -> list[tuple[Array, MachineCalibration]]:
    """Calibrations with the whole deformation of machines drawn from their tolerances, and how far they are off; points
    with errors drawn from the covariance that an adjustment of rays stated, what poses share drawn once for all."""
    _, folder, tables = adjusted
    poses = tables["configurations"].column("pose").to_pylist()
    correlation, errors = _errors(tables, poses)
    again = copied(tables, [poses[n % len(poses)] for n in range(POSES)])
    every = [errors[n % len(poses)] for n in range(POSES)]
    return [_calibrated(again, every, correlation, folder, np.random.default_rng([7, k])) for k in range(DRAWS)]


def _errors(tables: Tables, poses: list[int]) -> tuple[Array, list[PointErrors]]:
    """Correlations (K, K) of what all poses share, and what points of each pose have by it and besides."""
    effects, reported = (tables[name].to_pandas() for name in ("point_sensitivities", "camera_correlations"))
    parameters = effects["parameter"].unique().tolist()
    correlation = np.eye(len(parameters))
    one, other = ([parameters.index(p) for p in reported[name]] for name in ("parameter", "other_parameter"))
    correlation[one, other] = correlation[other, one] = reported["correlation"]
    found = []
    for pose in poses:
        names, places, whole = stated_covariance(tables, pose)
        own = effects[effects["pose"] == pose].pivot(index="point", columns="parameter").loc[names]
        by = np.stack([own[f"effect_{a}_mm"][parameters].to_numpy() for a in "xyz"], 1).reshape(-1, len(parameters))
        values, vectors = np.linalg.eigh(whole - by @ correlation @ by.T)
        found.append(PointErrors(names, places, vectors * np.sqrt(np.maximum(values, 0.0)), by))
    return correlation, found


def _calibrated(
    tables: Tables, errors: list[PointErrors], correlation: Array, folder: Path, rng: np.random.Generator
) -> tuple[Array, MachineCalibration]:
    moves, settings = random_moves(POSES, 0, np.random.default_rng(11)), settings_of(folder)
    campaign = exact_campaign(Shooting().layout, moves, [], rng)
    common = rng.multivariate_normal(np.zeros(len(correlation)), correlation, method="eigh")
    measured = _measured(campaign, tables, errors, common, rng)
    for stage in ("pose", "deformation"):
        measured |= call_stage(stage, measured, settings).artifacts  # type: ignore[arg-type]
    gathered = assemble(measured, settings)
    (case,) = [case for case in cases(gathered, structures(gathered.machine)[:1]) if case.deformation == "matrix"]
    fit = maximum_likelihood(gathered, gathered.measured, case, np.ones(POSES, bool))
    assert fit.status == "ok"
    return fit.values - _truth(campaign, gathered, case, fit), fit


def _measured(
    campaign: Campaign, tables: Tables, errors: list[PointErrors], common: Array, rng: np.random.Generator
) -> Tables:
    """Tables of the campaign, its points in the frames of the poses that were adjusted and off as those may be."""
    place = {f"{b}/{n}": k for k, (b, n) in enumerate(zip(campaign.marks.body, campaign.marks.name, strict=True))}
    seen, places = tables["observations"].to_pandas(), []
    for number, own in enumerate(errors):
        points = seen["point"][seen["pose"] == number + 1]
        at = [own.names.index(point) for point in points]
        off = own.root @ rng.normal(size=len(own.root)) + own.effects @ common
        true = campaign.record.points[number][[place[point] for point in points]]
        places.append(_brought(true, own.places[at]) + off.reshape(-1, 3)[at])
    survey, configurations = tables["survey"].to_pandas(), tables["configurations"].to_pandas()
    rows = [place[f"{b}/{t}"] for b, t in zip(survey["body"], survey["target"], strict=True)]
    survey[["x_mm", "y_mm", "z_mm"]] = campaign.surveyed[rows]
    configurations[[f"rho{leg}_mm" for leg in range(1, 7)]] = campaign.readings
    made = {"survey": survey, "configurations": configurations}
    return moved(tables, np.concatenate(places)) | {
        name: pa.Table.from_pandas(frame, tables[name].schema, preserve_index=False) for name, frame in made.items()
    }


def _brought(true: Array, found: Array) -> Array:
    """True points in the frame of those found."""
    u, _, vt = np.linalg.svd((found - found.mean(0)).T @ (true - true.mean(0)))
    return np.asarray((true - true.mean(0)) @ (u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt).T + found.mean(0))


def _truth(campaign: Campaign, gathered: CalibrationData, case: Case, fit: MachineCalibration) -> Array:
    built, legs = campaign.truth.built, gathered.machine.legs
    a, b, length = built.a * 1e-3, built.b * 1e-3, built.length * 1e-3
    true = replace(case.nominal, legs=replace(legs, a=a, b=b, u=built.u, l=length), deformation=np.zeros((6, 6)))
    return fit.parameters.values(true)


def test_errors_of_the_deformation_agree_with_their_covariance(
    calibrated: list[tuple[Array, MachineCalibration]],
) -> None:
    _as_stated(calibrated, lambda name: name.startswith("K"))


def test_errors_of_all_parameters_agree_with_their_covariance(calibrated: Any) -> None:
    _as_stated(calibrated, lambda name: True)


def test_errors_common_to_all_poses_do_not_average_out_in_a_calibration(calibrated: Any) -> None:
    """The combinations of numbers that are determined best, in units of their tolerances, would be 1.3 times as far."""
    squares = []
    for off, fit in calibrated:
        known = np.where(np.isfinite(fit.tolerance), fit.tolerance, 0.1)
        values, vectors = np.linalg.eigh(fit.declared / np.outer(known, known))
        squares.append((vectors[:, :12].T @ (off / known)) ** 2 / values[:12])
    assert abs(np.mean(squares) - 1.0) < 4.0 * np.sqrt(2 / np.size(squares))


def test_closings_are_off_as_noise_lets_expect(calibrated: Any) -> None:
    """With shifts taken as sums of independent errors, a fifth less."""
    squares, freedom = (sum(getattr(fit, name) for _, fit in calibrated) for name in ("chi_square", "freedom"))
    assert abs(squares / freedom - 1.0) < 4.0 * np.sqrt(2 / freedom)


def _as_stated(calibrated: list[tuple[Array, MachineCalibration]], chosen: Any) -> None:
    squares, count = 0.0, 0
    for off, fit in calibrated:
        own = np.flatnonzero([chosen(entry.name) for entry in fit.parameters.entries])
        squares += off[own] @ np.linalg.solve(fit.declared[np.ix_(own, own)], off[own])
        count += len(own)
    assert abs(squares / count - 1.0) < 4.0 * np.sqrt(2 / count)
