"""Figures of docs/real-data.md on force sensors, from the tables that their runs leave."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tests.real.diagnosed import diagnosed
from tests.real.sensor_facts import pier_of
from truing.estimation.interferometry.recorded_steps import READING_SI
from truing.estimation.sensor.calibrate import fit_calibration
from truing.estimation.sensor.calibration import CalibrationModel
from truing.estimation.sensor.eccentric_load import line_of_action
from truing.estimation.sensor.load_table import load_table

Tables = dict[str, pd.DataFrame]

LOADS = ("fx", "fy", "fz", "mx", "my", "mz")
LOAD_COLUMNS = ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")
LINEAR = "least squares, direct, zero common, linear"
SQUARES = "least squares, direct, zero common, squares"
PRODUCTS = "least squares, direct, zero common, products"
# 6-Axial_Measurement.xlsx: mean reading and error in per cent, N and N mm
PUBLISHED = {
    "Fx": (9.99, 0.1),
    "Fy": (9.23, 7.7),
    "Fz": (10.23, 2.3),
    "Mx": (-103.2, 1.9),
    "My": (-109.4, 4.0),
    "Mz": (-100.99, 39.3),
}


def calibrations(tables: Tables) -> dict[str, dict[str, Any]]:
    """Of every calibration that contended: its number of parameters, errors fitted and held out, N and N m by load."""
    rows, found = tables["sensor_choice"], {}
    for model, group in rows[rows["figure"] != "refused"].groupby("model", sort=False):
        each = {
            figure: [float(part.set_index("subject")["value"].get(load, np.nan)) for load in LOADS]
            for figure, part in group.groupby("figure")
            if figure in ("fitted_rms", "heldout_rms")
        }
        alone = group[group["subject"].isna()].set_index("figure")["value"]
        found[str(model)] = {
            "fitted": each.get("fitted_rms", [np.nan] * 6),
            "held_out": each["heldout_rms"],
            "parameters": int(alone["parameters"]),
            "chosen": bool(alone["chosen"]),
        }
    return found


def weights(tables: Tables) -> dict[str, Any]:
    """A table of weights: what quality says of exchanged rows, and, where it was diagnosed and calibrated, of these."""
    qa = tables["qa"]
    exchanged = qa[(qa["check"] == "exchanged-rows")]
    found: dict[str, Any] = {
        "rows": len(tables["signals"]),
        "left_out": int(tables["exclusions"]["rows"].sum()),
        "exchanged": [str(row["subject"]) for _, row in exchanged.iterrows() if row["verdict"] == "fail"],
        "says": [str(text) for text in exchanged["message"]],
    }
    if "diagnosis" in tables:
        found["diagnosis"] = diagnosed(tables)
    if np.all(np.ptp(_signals(tables)[1], axis=0) > 0.0):  # else nothing tells the component that was not applied
        found["residuals"] = residuals(tables)
    if "sensor_choice" in tables:
        found["models"] = calibrations(tables)
        found["chosen"] = next(name for name, own in found["models"].items() if own["chosen"])
    return found


def _signals(tables: Tables) -> tuple[NDArray, NDArray]:
    rows = tables["signals"]
    names = [name for name in rows.columns if name.startswith("v") and name.endswith("_mv")]
    return rows[names].to_numpy(), rows[list(LOAD_COLUMNS)].to_numpy()


def residuals(tables: Tables) -> dict[str, Any]:
    """Residuals of the linear calibration with a zero, of the rows as recorded: by load, and along y."""
    signals, loads = _signals(tables)
    fit = fit_calibration(load_table(signals, loads), CalibrationModel(zero="common"))
    return {"rms": np.sqrt(np.mean(fit.residuals**2, 0)).tolist(), "fy": fit.residuals[:, 1].tolist()}


def optical(tables: Tables) -> dict[str, Any]:
    """Errors of every model: of the rows fitted, of random rows left out, of whole poses left out."""
    models = calibrations(tables)
    signals, loads = _signals(tables)
    scaled = (signals - signals.mean(0)) / signals.std(0)  # so that powers are of like size
    for name, powers in ((LINEAR, "linear"), (SQUARES, "squares"), (PRODUCTS, "products")):
        models[name]["random"] = _random_rows(scaled, loads, CalibrationModel(zero="common", powers=powers))
    poses = tables["signals"]["run"].nunique()
    chosen = next(name for name, model in models.items() if model["chosen"])
    return {"rows": len(signals), "poses": poses, "models": models, "chosen": chosen}


def _random_rows(signals: NDArray, loads: NDArray, model: CalibrationModel) -> list[float]:
    """Errors of a fifth of the rows, drawn at random, by a fit to the others, as the authors tested theirs."""
    part = np.random.default_rng(20).permutation(len(loads)) % 5
    miss = np.empty_like(loads)
    for fifth in range(5):
        out = part == fifth
        fit = fit_calibration(load_table(signals[~out], loads[~out]), model)
        miss[out] = fit.predict(signals[out], np.empty((int(out.sum()), 0))) - loads[out]
    return np.sqrt(np.mean(miss**2, 0)).tolist()


def stewart(tables: Tables) -> dict[str, Any]:
    """The wrench of every run by the geometry, next to what was applied and published; where the forces passed."""
    matrix = tables["sensor_matrix"]
    own = matrix[(matrix["matrix"] == "G") & (matrix["model"] == "nominal")]
    G = own.pivot(index="row", columns="column_name", values="value").loc[list(LOADS)].to_numpy()
    signals, loads = _signals(tables)
    run = tables["signals"]["run"].to_numpy()
    shown = signals @ G.T  # 1 mV per N of a leg
    table, means, covs = {}, [], []
    for place, axis in enumerate(PUBLISHED):
        rows = run == axis
        unit = 1.0 if place < 3 else 1e3
        applied, mean = unit * loads[rows, place].mean(), unit * shown[rows, place].mean()
        table[axis] = {
            "applied": applied,
            "mean": mean,
            "error": 100.0 * abs(abs(mean) - abs(applied)) / abs(applied),
            "published": PUBLISHED[axis],
        }
        means.append(shown[rows].mean(0))
        covs.append(np.cov(shown[rows].T))
    lines = line_of_action(np.array(means[:3]), np.array(covs[:3]))
    merit = tables["sensor_merit"]
    merit = merit[(merit["matrix"] == "G") & (merit["figure"] == "condition")]
    reported = tables["diagnosis"]
    row = reported[(reported["cause"] == "load-eccentricity") & reported["verdict"].isin(["found", "suspected"])].iloc[
        0
    ]
    eccentric = {"subject": row["subject"], **json.loads(row["parameters"])}
    offset = np.array([eccentric[f"offset_{axis}"]["value"] for axis in "xyz"])
    forces = np.array([loads[run == axis].mean(0) for axis in list(PUBLISHED)[:3]])
    moved = forces + np.hstack([np.zeros((3, 3)), np.cross(1e-3 * offset, forces[:, :3])])
    return {
        "applied": dict(zip(PUBLISHED, np.linalg.solve(G, forces.T).T, strict=False)),
        "moved": dict(zip(PUBLISHED, np.linalg.solve(G, moved.T).T, strict=False)),
        "table": table,
        "legs": {axis: np.linalg.solve(G, mean).tolist() for axis, mean in zip(PUBLISHED, means, strict=True)},
        "arms": {axis: (1e3 * arm).tolist() for axis, arm in zip(PUBLISHED, lines.arm, strict=False)},
        "condition": float(merit.loc[merit["length_m"].idxmin(), "value"]),
        "length_mm": 1e3 * float(merit["length_m"].min()),
        "diagnosis": diagnosed(tables),
        "eccentricity": eccentric,
    }


KIP_N, INCH_M = 4448.2216152605, 0.0254


def pier(tables: Tables) -> dict[str, Any]:
    """Stiffness of small displacements with what loops leave of it, and hysteresis by component; kip and inch."""
    readings = tables["observations"]
    moved = readings.pivot(index="step", columns="channel", values="reading")[["dx", "dy", "dz", "rx", "ry", "rz"]]
    loads = readings.drop_duplicates("step").set_index("step").loc[moved.index, list(LOAD_COLUMNS)]
    inches = moved.to_numpy() * READING_SI / np.repeat([INCH_M, 1.0], 3)
    kips = loads.to_numpy() / (KIP_N * np.repeat([1.0, INCH_M], 3))
    return {**pier_of(inches, kips), "moved": inches, "force": kips}


def quadrature(tables: Tables) -> dict[str, Any]:
    """The raw signals of the axes: radius before and after, what quality says, lengths of one fringe."""
    rows, qa = tables["quadrature"], tables["qa"]
    flagged = qa[(qa["check"] == "signals-round") & (qa["verdict"] == "fail")]
    last = tables["observations"].groupby("channel")["reading"].last()
    return {
        "samples": int(rows["samples"].iloc[0]),
        "raw": rows["radius_before"].tolist(),
        "corrected": rows["radius_after"].tolist(),
        "uncut": rows["radius_uncut"].tolist(),
        "mean": rows["radius_mean"].tolist(),
        "cut": (100.0 * rows["cut_share"]).tolist(),
        "periodic_nm": (1e3 * rows["periodic_error_um"]).tolist(),
        "flagged": [f"channel {name}" in set(flagged["subject"]) for name in rows["channel"]],
        "says": [str(text) for text in flagged["message"]],
        "fringe_nm": [1e3 * float(last[name]) for name in rows["channel"]],
    }


# The report's names of the lines, and ours.
LINES = {
    "B": "B",
    "B_avg": "B_mean",
    "R_fwd": "R_forward",
    "R_bwd": "R_backward",
    "R": "R",
    "E_fwd": "E_forward",
    "E_bwd": "E_backward",
    "E": "E",
    "M": "M",
    "A_fwd": "A_forward",
    "A_bwd": "A_backward",
    "A": "A",
}


def positioning(tables: Tables) -> dict[str, Any]:
    """Quantities of ISO 230-2 of the axis, mm, by the report's names of its lines; sigma of the accuracy."""
    rows = tables["positioning"]
    axis = rows[rows["subject"].isna()].set_index("figure")
    return {
        "ours": {name: 1e-3 * float(axis.loc[figure, "value"]) for name, figure in LINES.items()},
        "sigma_a": 1e-3 * float(axis.loc["A", "sigma"]),
        "causes": _found_causes(tables["diagnosis"]),
    }


def _found_causes(diagnosis: Any) -> list[dict[str, Any]]:
    """Causes found in the positions: what they follow, and rms errors (um) of approaches left out in turn."""
    found = diagnosis[diagnosis["verdict"] == "found"]
    keys = ("cause", "subject", "follows", "heldout_rms_before", "heldout_rms_after", "noise_floor")
    return [{key: row[key] for key in keys} for row in found.to_dict("records")]
