"""Synthetic tables of calibrations: any number of legs, models and deformations."""

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
        "model_choice": _choice(kinds, chosen),
        "observability": _observability(chosen, legs, parameters),
        "absorption": _absorption(fitted, models[0], rng),
        "requirements": _requirements(*chosen),
    }


def _fitted(model, deformation, legs, parameters, rng) -> pd.DataFrame:
    names = [*parameters, *(["kappa"] if deformation == "linear" else [])]
    rows = pd.DataFrame(product(range(1, legs + 1), names), columns=["leg", "parameter"])
    if deformation == "matrix":
        k = pd.DataFrame(product(range(1, legs + 1), repeat=2), columns=["leg", "column"])
        k["parameter"] = [f"K{i}{'_' if legs > 9 else ''}{j}" for i, j in zip(k["leg"], k["column"], strict=True)]
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
    for estimator, (model, deformation) in product(("errors-in-variables", "implicit"), kinds):
        miss = _MISS[model] * (1.1 if estimator == "implicit" else 1.0)
        figures = {f"position_mean_{role}": (3.0 * miss, "um") for role in ("calibration", "verification")}
        figures |= {f"position_max_{role}": (7.5 * miss, "um") for role in ("calibration", "verification")}
        figures |= {f"orientation_mean_{role}": (6.0 * miss, "arcsec") for role in ("calibration", "verification")}
        figures |= {f"orientation_max_{role}": (14.0 * miss, "arcsec") for role in ("calibration", "verification")}
        figures |= {"heldout_ratio": (1.02 * miss, "1"), "rms_pull": (_BENT[deformation], "1")}
        figures |= {"chi_square": (70.0 * miss**2, "1"), "freedom": (72.0, "1"), "p_value": (0.5 / miss**9, "1")}
        figures |= {"parameters": (36.0, "1"), "poses": (12.0, "1"), "poses_downweighted": (1.0, "1")}
        is_chosen = estimator == "errors-in-variables" and (model, deformation) == chosen
        figures["chosen"] = (float(is_chosen), "1")
        figures["indistinguishable"] = (float((model, deformation) == ("beam", chosen[1])), "1")
        rows += [(model, deformation, estimator, name, *value) for name, value in figures.items()]
    return pd.DataFrame(rows, columns=["model", "deformation", "estimator", "figure", "value", "unit"])


def _observability(chosen, legs, parameters) -> pd.DataFrame:
    """Leg by leg for the first model with linear deformation, as a whole for the chosen one."""
    indices = [("condition", 3.4e4), ("O1", 0.21), ("O2", 2.9e-5), ("O3", 0.01), ("O4", 1.1e-6), ("O5", 0.03)]
    rows = []
    for leg in (*range(1, legs + 1), None):
        own = ("linear", float(leg)) if leg else (chosen[1], np.nan)
        known = " ".join(f"{name}{leg}" for name in parameters)
        figures = [("parameters", 11.0), ("rank", 6.0)] if leg else [("parameters", 90.0), ("rank", 42.0)]
        reported = [(name, value, None) for name, value in [*figures, *indices]]
        reported += [("identifiable_set", float(len(parameters)), known), ("singular_value", 0.3, None)]
        reported += [("sigma", 9.6, f"{name}{leg}") for name in parameters] if leg else []
        reported += [
            ("sigma", np.nan, f"rho0{leg}"),
            ("unidentifiable", 1.18, f"only a_x{leg} + 0.01 u_x{leg} is determined"),
        ]
        reported += [
            (
                "unidentifiable",
                1.2,
                f"a_z{leg} : rho0{leg} = 1 : -1 is unobservable; b_z{leg} : l{leg} = 1 : 1 is unobservable",
            )
        ]
        rows += [
            (chosen[0], *own, name, value, "1", words) for name, value, words in reported if leg or name != "sigma"
        ]
    return pd.DataFrame(rows, columns=["model", "deformation", "leg", "figure", "value", "unit", "combination"])


def _absorption(fitted, model, rng) -> pd.DataFrame:
    parts = []
    for ignored, estimator in product(("none", "linear"), ("errors-in-variables", "implicit")):
        own = fitted[(fitted["model"] == model) & (fitted["deformation"] == ignored)]
        observed = own["identified"] - own["nominal"]
        predicted = observed + own["sigma"] * rng.normal(size=len(own))
        columns = own[["model", "deformation", "leg", "parameter", "unit", "sigma"]]
        columns = columns.assign(effect="platform-deformation-matrix", estimator=estimator)
        parts.append(columns.assign(predicted=predicted, observed=observed))
    return pd.concat(parts, ignore_index=True)


def _requirements(model, deformation) -> pd.DataFrame:
    rows = []
    for (axis, unit), verdict in zip(_AXES.items(), _VERDICTS, strict=True):
        wanted = {"mm": 0.1, "deg": 0.05}[unit] if verdict != "not evaluated" else np.nan
        error = {"meets": 0.1, "fails": 2.0, "undecided": 1.0}.get(verdict, np.nan) * wanted
        says = f"{axis}: {verdict}."
        rows.append((model, deformation, axis, wanted, error, 0.8 * error, 1.3 * error, unit, verdict, says))
    columns = [
        "model",
        "deformation",
        "component",
        "requirement",
        "error",
        "lower",
        "upper",
        "unit",
        "verdict",
        "message",
    ]
    return pd.DataFrame(rows, columns=columns)
