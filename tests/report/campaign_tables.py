"""Synthetic tables of a campaign of any size, with any names."""

from __future__ import annotations

import json
from itertools import product

import numpy as np
import pandas as pd

_COVARIANCE = [f"cov_{i}_{j}" for i in range(6) for j in range(i, 6)]


def campaign_tables(
    poses: int = 12, bodies: tuple[str, ...] = ("base", "platform"), targets: int = 8, name: str = "P"
) -> dict[str, pd.DataFrame]:
    """A photogrammetry campaign on six legs in which everything was evaluated and something was left out."""
    rng = np.random.default_rng(5)
    survey = _survey(bodies, targets, name, rng)
    points = survey.merge(pd.DataFrame({"pose": np.arange(poses)}), how="cross")
    points = points.sort_values("pose", kind="stable").reset_index(drop=True)
    observations = points[["pose", "body", "target", "x_mm", "y_mm", "z_mm"]]
    observations = observations.assign(sigma_x_mm=0.005, sigma_y_mm=0.005, sigma_z_mm=0.005)
    return {
        "observations": observations,
        "survey": survey,
        "shape": survey[["body", "target", "x_mm", "y_mm", "z_mm", "leg"]],
        "configurations": _configurations(poses, rng),
        "exclusions": pd.DataFrame(
            [("ingest", "points.csv", "target is not like P", 7, "[files] of campaign.toml")],
            columns=["stage", "subject", "reason", "rows", "by"],
        ),
        "qa": _checks(),
        "poses": _poses(poses, bodies, rng),
        "residuals": _residuals(points, rng),
        **_life(bodies[-1], name),
        **_deformation(poses, rng),
        "diagnosis": _diagnosis(),
    }


def _life(body, name) -> dict[str, pd.DataFrame]:
    """Events of the campaign: a target mounted anew, changed names, repeats, an exclusion."""
    of = {"body": body, "target": f"{name}1"}
    shift = {f"{kind}_{a}_mm": value for a in "xyz" for kind, value in (("shift", 0.4), ("sigma", 0.007))}
    survey = {"later_survey": name, **of, **shift, "p_value": 0.0, "relocated": True, "holds_as": f"{name}1@{name}"}
    names = {**of, "called": f"{name}7", "from_pose": "3", "to_pose": None, "rows": 9}
    repeat = {"repeated": "pose", "subject": f"{body} x", "pure_error": 4.2, "lower": 2.8, "upper": 7.9, "unit": "um"}
    repeat |= {"declared_sigma": 5.0, "freedom_of_error": 8.0, "groups": 8, "told_by": "repeat_of"}
    fit = {"repeated": "pose", "contender": "6-pus, none", "subject": f"{body} x", "f_ratio": 9.0, "p_value": 0.01}
    effect = {"entry": "exclude 1", "subject": body, "by": name, "decided_on": "2026-11-20", "reason": name, "rows": 1}
    rows = {
        "resurveys": survey | {"from_pose": "3", "status": "moved"},
        "relabelled": names | {"reason": name},
        "likely_names": names | {"distance_mm": 0.004},
        "repeats": repeat,
        "lack_of_fit": fit | {"freedom_of_fit": 12.0, "freedom_of_error": 8.0},
        "exclusion_effects": effect | {"gross_anyway": 0, "largest_change": 0.004, "unit": "mm", "over_sigma": 0.9},
    }
    return {table: pd.DataFrame([row]) for table, row in rows.items()}


def _survey(bodies, targets, name, rng) -> pd.DataFrame:
    rows = pd.DataFrame(product(bodies, range(targets)), columns=["body", "number"])
    places = rng.uniform(-100.0, 100.0, (len(rows), 3))
    leg = np.where((rows["body"] == "platform") & (rows["number"] < 6), rows["number"] + 1.0, np.nan)
    out = pd.DataFrame({"body": rows["body"], "target": [f"{name}{n}" for n in rows["number"]]})
    out = out.assign(**dict(zip(["x_mm", "y_mm", "z_mm"], places.T, strict=True)))
    return out.assign(sigma_x_mm=0.005, sigma_y_mm=0.005, sigma_z_mm=0.005, leg=leg)


def _configurations(poses, rng) -> pd.DataFrame:
    table = pd.DataFrame({"pose": np.arange(poses), "role": "calibration", "time_s": 200.0 * np.arange(poses)})
    table = table.assign(temperature_c=20.0)
    return table.assign(**{f"rho{leg}_mm": 10.0 + rng.uniform(-1.3, 1.3, poses) for leg in range(1, 7)})


def _checks() -> pd.DataFrame:
    rows = [
        ("completeness", "base", 0.4, 0.3, "1", "fail", "base: 40 % are missing.", None),
        ("noise", "base", 0.7, 1.5, "1", "warn", "base: the scatter is 0.7 times the declared noise.", None),
        ("base-drift", "base", 0.064, 0.021, "mm", "fail", "base: drifts by 0.064 mm.", "A. Kern: the floor was cut"),
        ("time-gaps", "", 0.0, 1.0, "h", "pass", "No gap.", None),
        ("repeatability", "", np.nan, np.nan, "mm", "not evaluated", "No pose was repeated.", None),
    ]
    return pd.DataFrame(rows, columns=["check", "subject", "value", "limit", "unit", "verdict", "message", "accepted"])


def _poses(poses, bodies, rng) -> pd.DataFrame:
    rows = pd.DataFrame(product(bodies, range(poses)), columns=["body", "pose"])
    rows = rows.assign(parent="measurement", method="maximum_likelihood", default=True)
    for k, column in enumerate(("px_mm", "py_mm", "pz_mm", "rx_rad", "ry_rad", "rz_rad")):
        rows[column] = rng.normal(0.0, 10.0 if k < 3 else 0.01, len(rows))
    for column in _COVARIANCE:
        rows[column] = 1e-11 if column[-1] == column[-3] else 0.0
    return rows.assign(rms_mm=rng.uniform(0.003, 0.006, len(rows)), n_used=8, n_rejected=0, status="ok")


def _residuals(points, rng) -> pd.DataFrame:
    table = points[["pose", "body", "target"]].reset_index(drop=True)
    shift = rng.normal(0.0, 0.005, (len(table), 3))
    table = table.assign(**dict(zip(["dx_mm", "dy_mm", "dz_mm"], shift.T, strict=True)))
    table = table.assign(weight=1.0, rejected=False, reason=None)
    table.loc[0, ["rejected", "reason"]] = [True, "gross error: 0.300 mm off"]
    table.loc[1, ["rejected", "reason", "decision"]] = [
        True,
        "excluded by A. Kern: mirror image in the window",
        "excluded",
    ]
    table.loc[2, ["reason", "decision"]] = ["kept by B. Roth: checked by hand", "kept"]
    table.loc[3, ["reason", "weight"]] = ["attachment: not part of the frame", 0.0]
    return table


def _deformation(poses, rng) -> dict[str, pd.DataFrame]:
    legs = pd.DataFrame(product(range(poses), range(1, 7)), columns=["pose", "leg"])
    drive = rng.uniform(-1.3, 1.3, len(legs))
    shifts = legs.assign(delta_rho_mm=drive, delta_bz_um=13.0 * drive, sigma_um=8.0, rejected=False, reason=None)
    shifts.loc[5, ["rejected", "reason", "delta_bz_um"]] = [True, "gross error: 40 sigma", 90000.0]
    entries = [("matrix", i, j) for i, j in product(range(1, 7), range(1, 7))]
    entries += [("linear", i, i) for i in range(1, 7)]
    models = pd.DataFrame(entries, columns=["model", "leg", "column"])
    models = models.assign(coefficient=rng.normal(0.0, 0.012, len(models)), sigma=0.001)
    models = models.assign(significant=models["coefficient"].abs() > 0.003)
    errors = [("none", 30.6), ("linear", 26.1), ("matrix", 5.6)]
    rows = [(model, np.nan, "rms_error", value, "um", None) for model, value in errors]
    rows.append(("matrix", np.nan, "p_value_over_linear", 1e-40, "1", None))
    columns = ["model", "leg", "figure", "value", "unit", "subject"]
    return {
        "deformation": shifts,
        "deformation_models": models,
        "deformation_errors": pd.DataFrame(rows, columns=columns),
    }


def _diagnosis() -> pd.DataFrame:
    k11 = json.dumps({"K11": {"value": 0.0163, "sigma": 0.0005, "unit": "1"}})
    shared = {"subject": None, "follows": None, "unit": "um", "noise_floor": 4.78, "heldout_rms_after": 4.6}
    found = {
        "rank": 1,
        "cause": "platform-deformation-matrix",
        "verdict": "found",
        "p_value": 0.0005,
        "probability": 1.0,
        "parameters": k11,
        "rms_before": 12.4,
        "rms_after": 4.77,
        "heldout_rms_before": 7.8,
        "explanation": "The data show that the attachments shift: K11 = 0.0163 ± 0.0005. Predictions miss by 4.77 um.",
        "next_measurement": "Move one actuator at a time.",
    }
    other = {**found, "rank": 2, "cause": "unexplained", "verdict": "rejected", "explanation": "Nothing follows time."}
    return pd.DataFrame([{**shared, **found}, {**shared, **other}])
