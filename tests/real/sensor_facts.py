"""Figures of public measurements on force sensors and a loaded platform, computed from the published files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from truing.estimation.sensor.calibrate import fit_calibration
from truing.estimation.sensor.calibration import CalibrationModel
from truing.estimation.sensor.contenders import HeldOutPredictions, covariance_by_case, hold_out
from truing.estimation.sensor.eccentric_load import LineOfAction, line_of_action
from truing.estimation.sensor.error_classes import creep
from truing.estimation.sensor.exchanged_loads import RowExchange, exchanged_loads
from truing.estimation.sensor.load_table import LoadTable, load_table
from truing.estimation.sensor.loops import Loops, loops
from truing.simulation.bench.six_upur.geometry import joint_centres
from truing.simulation.bench.six_upur.influence import influence_matrix

FORCES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
LINEAR = CalibrationModel(zero="common")


def six_axis_tables(data: Path) -> dict[str, LoadTable]:
    """The three tables of a six-axis sensor under weights, N and N m; rows whose loads nobody wrote down are left out.

    A case is a direction of loading: ten steps, the first of them unloaded.
    """
    folder, found = data / "fareke-loadcells", {}
    for number, name in enumerate(("", "_1", "_2"), 1):
        raw = pd.read_csv(folder / f"six_axis_calibrationReadings{name}.csv").dropna(how="all")
        reported = raw.notna().all(axis=1).to_numpy()
        case = np.arange(len(raw)) // 10
        values = raw.to_numpy(float)[reported]
        found[f"file {number}"] = load_table(values[:, :6], values[:, 6:], case[reported]).named(FORCES)
    return found


def six_axis(data: Path) -> dict[str, dict[str, Any]]:
    """Residuals of the linear calibration with a zero, before and after exchanged rows are put right; rows from 1."""
    facts = {}
    for name, table in six_axis_tables(data).items():
        found = exchanged_loads(table)
        right = load_table(table.signals, _put_right(table.loads, found), table.case)
        facts[name] = {
            "rows": len(table.loads),
            "raw": _rms(table.loads - table.signals),
            "as_written": _rms(_left(table)),
            "put_right": _rms(_left(right)),
            "worst": (int(np.argmax(np.abs(_left(table)[:, 1]))) + 1, float(np.abs(_left(table)[:, 1]).max())),
            "exchanged": [(one.first + 1, one.second + 1, [FORCES[i] for i in one.components]) for one in found],
        }
    return facts


def _put_right(loads: NDArray, exchanges: list[RowExchange]) -> NDArray:
    right = loads.copy()
    for exchange in exchanges:
        rows, components = [exchange.first, exchange.second], list(exchange.components)
        right[np.ix_(rows, components)] = right[np.ix_(rows[::-1], components)]
    return right


def _left(table: LoadTable) -> NDArray:
    """Residuals of the calibration for the applied components (N, W); zero for the others."""
    applied = np.ptp(table.loads, axis=0) > 0
    part = load_table(table.signals, table.loads[:, applied], table.case)
    rest = np.zeros_like(table.loads)
    rest[:, applied] = fit_calibration(part, LINEAR).residuals
    return rest


def _rms(values: NDArray) -> NDArray:
    return np.sqrt(np.mean(values**2, 0))


def three_axis(data: Path) -> dict[int, dict[str, Any]]:
    """Three-axis cells: our residuals, gram, and the authors' own, and those of their matrix taken the wrong way."""
    facts = {}
    for cell in (1, 2, 3, 4):
        raw = pd.read_csv(data / "fareke-loadcells" / f"three_axis_cell{cell}.csv").to_numpy()[:15, :6].astype(float)
        loads, case = raw[:, :3], np.repeat(np.arange(3), 5)
        signals = raw[:, 3:] - raw[::5, 3:][case]  # from the unloaded reading of each orientation
        matrix = fit_calibration(load_table(signals, loads, case)).matrix
        log = (data / "fareke-loadcells" / f"three_axis_cell{cell}_log.md").read_text(encoding="utf-8")
        line = next(
            text for text in log.splitlines() if text.startswith("| Least Squares Method") and "Root Mean" in text
        )
        facts[cell] = {
            "rms": float(np.sqrt(np.mean((loads - signals @ matrix.T) ** 2))),
            "transposed": float(np.sqrt(np.mean((loads - signals @ matrix) ** 2))),
            "published": float(line.split("|")[3].split()[0]),
        }
    return facts


def beams(data: Path) -> dict[str, float]:
    """Largest residual, gram, of a line through each single-axis cell's readings under weights of both signs."""
    found = {}
    for name in ("CZL635", "degraw", "tal220"):
        raw = pd.read_csv(data / "fareke-loadcells" / f"beam_temp_{name}.csv").to_numpy(float)
        fit = fit_calibration(load_table(raw[:, 1:], raw[:, :1]), LINEAR)
        found[name] = float(np.abs(fit.residuals).max())
    return found


def repeated_load(data: Path) -> dict[str, Any]:
    """A beam cell loaded again and again for an hour: creep from 30 to 180 s of every long load, and its zeros.

    Shares of the cell's own step from unloaded to loaded.
    """
    raw = pd.read_csv(data / "fareke-loadcells" / "beam_loadingTest.csv.gz").to_numpy(float)
    time, reading = (raw[:, 1] - raw[0, 1]) / 1e3, raw[:, 3]
    order = np.flatnonzero(np.concatenate([[True], np.diff(time) > 0]))
    time, reading = time[order], reading[order]
    loaded = reading < 0.5 * (np.median(reading[:1000]) + np.percentile(reading, 5))
    step = float(abs(np.median(reading[loaded]) - np.median(reading[~loaded])))
    noise = float(np.median(np.abs(np.diff(reading))) / 0.6745 / np.sqrt(2))
    creeps, zeros = [], []
    edges = np.flatnonzero(np.diff(loaded)) + 1
    for part in np.split(np.arange(len(time)), edges):
        age = time[part] - time[part[0]]
        if loaded[part[0]] and age[-1] > 180.0:
            creeps.append(creep(age, reading[part], noise, step, 30.0, 180.0))
        if not loaded[part[0]] and age[-1] > 60.0:
            zeros.append(float(np.median(reading[part][age > 30.0])) / step)
    return {"creep": creeps, "zeros": np.array(zeros), "seconds": float(time[-1])}


def _lbcb(data: Path) -> tuple[NDArray, NDArray]:
    raw = pd.read_csv(data / "lbcb-pier" / "lbcb_readings.csv.gz")
    axes = [f"{axis}_{kind}" for kind in ("displacement", "rotation") for axis in "xyz"]
    forces = [f"{axis}_{kind}" for kind in ("force", "moment") for axis in "xyz"]
    return raw[axes].to_numpy(), raw[forces].to_numpy()


def pier(data: Path) -> dict[str, Any]:
    """Facts of the log of the pier, inch and kip."""
    return pier_of(*_lbcb(data))


def pier_of(moved: NDArray, force: NDArray) -> dict[str, Any]:
    """Stiffness before the pier was first moved by 0.3 in, whole loops held out, and loops per axis; inch and kip.

    weakest: share of the displacements' spread along their weakest combination, all in units of their own spread.
    """
    whole: Loops = loops(moved[:, 0], force, 0.0, least=0.02)
    step = np.arange(len(moved))
    large = np.flatnonzero(np.abs(moved[:, 0]) > 0.3)
    small = (step > large[0]) & (step < large[1])  # the first reading, far off, was taken before the test
    loop = np.searchsorted(whole.step, step)
    table = load_table(moved[small], force[small], loop[small]).named(("x", "y", "z", "rx", "ry", "rz"))
    predictions: HeldOutPredictions = hold_out(table, LINEAR)
    spread = force[small].std(0)
    scaled = (moved[small] - moved[small].mean(0)) / moved[small].std(0)
    gentle = whole.amplitude[:, 0] < 15.0
    few = Loops(whole.step[gentle], whole.gap[gentle], whole.amplitude[gentle])
    return {
        "steps": int(small.sum()),
        "stiffness": predictions.fit.matrix,
        "sigma": predictions.fit.sigma,
        "sigma_by_loop": covariance_by_case(table, LINEAR).sigma,
        "weakest": float(np.linalg.svd(scaled, compute_uv=False)[-1] / np.sqrt(small.sum())),
        "r2": 1.0 - np.mean(predictions.fit.residuals**2, 0) / spread**2,
        "held_out_r2": 1.0 - predictions.rms**2 / spread**2,
        "loops": len(whole.step),
        "gentle": len(few.step),
        "hysteresis": few.mean,
        "hysteresis_sigma": few.sigma,
        "by_loop": whole.share[:, 0],
        "amplitude": whole.amplitude[:, 0],
    }


def stewart_runs(data: Path) -> dict[str, NDArray]:
    """Six runs under constant load, wrench (N, 6) in N and N m about the centre of the platform."""
    folder = data / "sps01-stewart-force"
    return {
        axis: pd.read_csv(folder / f"{axis}_measurement.csv").iloc[:, 1:7].to_numpy() * [1, 1, 1, 1e-3, 1e-3, 1e-3]
        for axis in FORCES
    }


def stewart_influence(data: Path) -> NDArray:
    """G (6, 6) of the sensor, from leg forces to the wrench about the platform's centre, N and N m."""
    config = json.loads((data / "sps01-stewart-force" / "SPS01_CONFIG.json").read_text(encoding="utf-8"))
    lower, upper = (
        1e-3 * config[radius] * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(6)])
        for radius, angle in (("Rb", np.radians(config["thetaB"])), ("Rp", np.radians(config["thetaP"])))
    )
    length = 1e-3 * config["legLength"]
    height = float(np.sqrt(length**2 - np.sum((upper[0] - lower[0]) ** 2)))  # the same by every leg
    return influence_matrix(joint_centres(lower, upper, height))


# 6-Axial_Measurement.xlsx: applied, mean reading, error in per cent (the sheet's own formulas); N and N mm.
PUBLISHED = {
    "Fx": (10.0, 9.99, 0.1),
    "Fy": (10.0, 9.23, 7.7),
    "Fz": (10.0, 10.23, 2.3),
    "Mx": (-105.2, -103.2, 1.9),
    "My": (-105.2, -109.4, 4.0),
    "Mz": (-72.5, -100.99, 39.3),
}


def stewart(data: Path) -> dict[str, Any]:
    """The published error table, leg forces, and where the loads really passed: arms in mm with one sigma."""
    runs, G = stewart_runs(data), stewart_influence(data)
    scaled = G * np.repeat([1.0, 10.0], 3)[:, None]  # moments by 100 mm
    table = {}
    for axis, (applied, _, _) in PUBLISHED.items():
        place = FORCES.index(axis)
        mean = float(runs[axis][:, place].mean()) * (1.0 if place < 3 else 1e3)
        table[axis] = (mean, 100.0 * abs(abs(applied) - abs(mean)) / abs(applied))
    mean = np.array([run.mean(0) for run in runs.values()])
    # readings of a run wander together, and so does their mean: its error is taken as large as their scatter
    cov = np.array([np.cov(run.T) for run in runs.values()])
    lines: LineOfAction = line_of_action(mean, cov)
    return {
        "table": table,
        "legs": {axis: np.linalg.solve(G, one) for axis, one in zip(runs, mean, strict=True)},
        "condition": float(np.linalg.cond(scaled)),
        "arm_mm": dict(zip(runs, 1e3 * lines.arm, strict=True)),
        "sigma_mm": dict(zip(runs, 1e3 * np.sqrt(np.einsum("bii->bi", lines.covariance)), strict=True)),
        "along_nmm": dict(zip(runs, 1e3 * lines.along, strict=True)),
        "along_sigma_nmm": dict(zip(runs, 1e3 * lines.along_sigma, strict=True)),
        "fz_of_moments": {axis: float(runs[axis][:, 2].mean()) for axis in ("Mx", "My", "Mz")},
    }
