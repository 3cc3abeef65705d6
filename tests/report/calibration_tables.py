"""Tables as the calibration leaves them: any number of legs, models and deformations, without any physics."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product

import numpy as np
import pandas as pd

MODELS = ("6-pus", "jacobian", "beam", "stiffness")
DEFORMATIONS = ("none", "linear", "matrix")
GEOMETRY = ("a_x", "a_y", "b_x", "b_y", "u_x", "l")
_AXES = {"x": "mm", "y": "mm", "z": "mm", "rx": "deg", "ry": "deg", "rz": "deg"}
_VERDICTS = ("meets", "meets", "fails", "undecided", "meets", "not evaluated")
# How many times the noise each model's predictions miss by, and how far parameters go from nominal, in tolerances.
_MISS = {"6-pus": 1.0, "ups": 1.0, "jacobian": 4.0, "beam": 1.0, "stiffness": 5.0}
_BENT = {"none": 7.0, "linear": 5.0, "matrix": 1.0}


def calibration_tables(
    legs: int = 6,
    models: Sequence[str] = MODELS,
    deformations: Sequence[str] = DEFORMATIONS,
    parameters: Sequence[str] = GEOMETRY,
) -> dict[str, pd.DataFrame]:
    """Everything that the calibration of one campaign leaves; the first model is chosen, with the last deformation."""
    rng = np.random.default_rng(11)
    kinds = list(product(models, deformations))
    chosen = (models[0], deformations[-1])
    fitted = pd.concat([_fitted(*kind, legs, parameters, rng) for kind in kinds], ignore_index=True)
    accuracy = pd.concat([_accuracy(*kind, rng) for kind in kinds], ignore_index=True)
    return {
        "calibration": fitted,
        "implicit_calibration": fitted.assign(identified=fitted["identified"] + 0.3 * fitted["sigma"]),
        "correlations": _correlations(fitted, chosen, rng),
        "accuracy": accuracy,
        "implicit_accuracy": accuracy.assign(position_error_um=1.1 * accuracy["position_error_um"]),
        "model_choice": _choice(kinds, chosen),
        "observability": pd.concat([_observability(*kind, legs, parameters) for kind in kinds], ignore_index=True),
        "absorption": _absorption(fitted, models[0], rng),
        "requirements": pd.concat([_requirements(*kind, _MISS[kind[0]]) for kind in kinds], ignore_index=True),
    }


def _fitted(model, deformation, legs, parameters, rng) -> pd.DataFrame:
    names = [*parameters, *(["kappa"] if deformation == "linear" else [])]
    rows = pd.DataFrame(product(range(1, legs + 1), names), columns=["leg", "parameter"])
    if deformation == "matrix":
        k = pd.DataFrame(product(range(1, legs + 1), repeat=2), columns=["leg", "column"])
        k["parameter"] = [f"K{i}{j}" for i, j in zip(k["leg"], k["column"], strict=True)]
        rows = pd.concat([rows, k[["leg", "parameter"]]], ignore_index=True)
    bare = rows["parameter"].str.startswith(("u_", "kappa", "K"))
    tolerance = np.where(bare, 0.002, 0.5)
    sigma = 0.1 * tolerance * rng.uniform(0.5, 2.0, len(rows))
    pull = _BENT[deformation] * rng.normal(0.0, 1.0, len(rows))
    nominal = _nominal(rows, legs)
    rows = rows.assign(model=model, deformation=deformation, unit=np.where(bare, "1", "mm"), nominal=nominal)
    rows = rows.assign(identified=nominal + pull * tolerance, sigma=sigma, tolerance=tolerance, pull=pull)
    return rows.assign(identifiable=rows["parameter"] != "b_y", status="converged")


def _nominal(rows, legs) -> np.ndarray:
    angle = 2.0 * np.pi * (rows["leg"] - 1) / legs
    values = {"a_x": 154.0 * np.cos(angle), "a_y": 154.0 * np.sin(angle), "l": 500.0 + 0.0 * angle}
    values |= {"b_x": 135.0 * np.cos(angle + 0.6), "b_y": 135.0 * np.sin(angle + 0.6)}
    return np.select([rows["parameter"] == name for name in values], list(values.values()), 0.0)


def _correlations(fitted, chosen, rng) -> pd.DataFrame:
    own = fitted[(fitted["model"] == chosen[0]) & (fitted["deformation"] == chosen[1])]
    names = list(zip(own["leg"], own["parameter"], strict=True))
    pairs = [(*a, *b) for a, b in combinations(names, 2)]
    table = pd.DataFrame(pairs, columns=["leg", "parameter", "other_leg", "other_parameter"])
    table = table.assign(model=chosen[0], deformation=chosen[1], correlation=rng.uniform(-0.6, 0.6, len(table)))
    table.loc[0, "correlation"] = -0.97
    return table[table["correlation"].abs() >= 0.05]


def _accuracy(model, deformation, rng) -> pd.DataFrame:
    roles = ["calibration"] * 12 + ["verification"] * 4
    table = pd.DataFrame({"model": model, "deformation": deformation, "pose": range(16), "role": roles})
    size = 3.0 * _MISS[model]
    return table.assign(
        position_error_um=size * rng.uniform(0.3, 2.0, 16),
        orientation_error_arcsec=2.0 * size * rng.uniform(0.3, 2.0, 16),
        position_noise_um=3.3,
        orientation_noise_arcsec=6.4,
    )


def _choice(kinds, chosen) -> pd.DataFrame:
    rows = []
    for method, (model, deformation) in product(("errors-in-variables", "implicit"), kinds):
        miss = _MISS[model] * (1.1 if method == "implicit" else 1.0)
        figures = {f"position_mean_{role}": (3.0 * miss, "um") for role in ("calibration", "verification")}
        figures |= {f"position_max_{role}": (7.5 * miss, "um") for role in ("calibration", "verification")}
        figures |= {f"orientation_mean_{role}": (6.0 * miss, "arcsec") for role in ("calibration", "verification")}
        figures |= {f"orientation_max_{role}": (14.0 * miss, "arcsec") for role in ("calibration", "verification")}
        figures |= {"heldout_ratio": (1.02 * miss, "1"), "rms_pull": (_BENT[deformation], "1")}
        figures |= {"chi_square": (70.0 * miss**2, "1"), "freedom": (72.0, "1"), "p_value": (0.5 / miss**9, "1")}
        figures |= {"parameters": (36.0, "1"), "poses": (12.0, "1"), "poses_downweighted": (1.0, "1")}
        is_chosen = method == "errors-in-variables" and (model, deformation) == chosen
        figures["chosen"] = (float(is_chosen), "1")
        rows += [(model, deformation, method, name, *value) for name, value in figures.items()]
    return pd.DataFrame(rows, columns=["model", "deformation", "method", "figure", "value", "unit"])


def _observability(model, deformation, legs, parameters) -> pd.DataFrame:
    known, asked = legs * (len(parameters) - 1), legs * len(parameters)
    figures = [("rank", known), ("parameters", asked), ("condition", 3.4e4), ("O1", 0.21), ("O2", 2.9e-5), ("O3", 0.01)]
    figures += [("O4", 1.1e-6), ("O5", 0.03), *(("singular_value", 10.0**-k) for k in range(4))]
    rows = [(model, deformation, np.nan, name, float(value), "1", None) for name, value in figures]
    told = [f"a_z{i} - b_z{i} + 0.99 l{i}" for i in range(1, legs + 1)]
    rows += [(model, deformation, float(i + 1), "unidentifiable", 0.98, "1", words) for i, words in enumerate(told)]
    return pd.DataFrame(rows, columns=["model", "deformation", "leg", "figure", "value", "unit", "combination"])


def _absorption(fitted, model, rng) -> pd.DataFrame:
    parts = []
    for effect, ignored in (("platform-deformation-matrix", "none"), ("platform-deformation-matrix", "linear")):
        own = fitted[(fitted["model"] == model) & (fitted["deformation"] == ignored)]
        observed = own["identified"] - own["nominal"]
        predicted = observed + own["sigma"] * rng.normal(size=len(own))
        columns = own[["model", "deformation", "leg", "parameter", "unit", "sigma"]]
        parts.append(columns.assign(effect=effect, predicted=predicted, observed=observed))
    return pd.concat(parts, ignore_index=True)


def _requirements(model, deformation, miss) -> pd.DataFrame:
    rows = []
    for (axis, unit), verdict in zip(_AXES.items(), _VERDICTS, strict=True):
        wanted = {"mm": 0.1, "deg": 0.05}[unit] if verdict != "not evaluated" else np.nan
        error = {"meets": 0.1, "fails": 2.0, "undecided": 1.0}.get(verdict, np.nan) * wanted * miss
        says = f"{axis}: {verdict}."
        rows.append((model, deformation, axis, wanted, error, 0.8 * error, 1.3 * error, unit, verdict, says))
    columns = ["model", "deformation", "axis", "requirement", "error", "lower", "upper", "unit", "verdict", "message"]
    return pd.DataFrame(rows, columns=columns)
