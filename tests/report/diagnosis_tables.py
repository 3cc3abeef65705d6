"""Synthetic tables of a diagnosis: any causes, verdicts, legs and targets."""

from __future__ import annotations

import json
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from tests.report.calibration_tables import calibration_tables
from tests.report.campaign_tables import campaign_tables

LEGS = 6
_GEOMETRY = {"a_x": "mm", "a_y": "mm", "b_x": "mm", "b_y": "mm", "u_x": "1", "l": "mm"}


def size(value: Any, sigma: float | None = None, unit: str = "1") -> dict[str, Any]:
    """A parameter as the column ``parameters`` holds it."""
    return {"value": value, "sigma": sigma, "unit": unit}


# Of noise alone, of one actuator that reads wrong, of a target that moved by 50 um.
NOISE = {"parameters": {"noise_ratio": size(1.41, 0.05)}, "rms_before": 7.3, "rms_after": 7.3, "log_evidence": None}
NOISE |= {"heldout_rms_before": 7.5, "heldout_rms_after": 7.5}
GAIN_3 = {"gain_3": size(0.0021, 0.0001)}
MOVED = {"dx": size(0.03, 0.003, "mm"), "dy": size(-0.04, 0.003, "mm"), "dz": size(0.0, 0.003, "mm")}


def matrix(legs: int = LEGS) -> dict[str, dict[str, Any]]:
    """The parameters of K: attachment 1 and 6 are moved most, against each other, by actuator 1."""
    k = 0.002 * np.random.default_rng(3).standard_normal((legs, legs))
    k[0, 0], k[legs - 1, 0] = 0.025, -0.025
    between = "_" if legs > 9 else ""
    return {f"K{i + 1}{between}{j + 1}": size(float(k[i, j]), 0.0005) for i, j in product(range(legs), repeat=2)}


def per_leg(kind: str, legs: int = LEGS, unit: str = "1", value: float = 0.002) -> dict[str, dict[str, Any]]:
    """A parameter of each leg, larger from leg to leg."""
    return {f"{kind}_{leg}": size(value * leg, 0.1 * value, unit) for leg in range(1, legs + 1)}


def row(cause: str, verdict: str = "found", **given: Any) -> dict[str, Any]:
    """One candidate; what is not given is as of an effect that was found and modelled well."""
    parameters = given.pop("parameters", per_leg("kappa"))
    facts = {
        "cause": cause,
        "verdict": verdict,
        "subject": "",
        "p_value": 0.0005,
        "probability": 0.9996,
        "parameters": json.dumps(parameters),
        "follows": "",
        "rms_before": 33.1,
        "rms_after": 7.4,
        "heldout_rms_before": 34.2,
        "heldout_rms_after": 7.9,
        "noise_floor": 7.2,
        "unit": "um",
        "explanation": f"The data show that {cause} is there: x = 1 ± 0.1. Predictions miss by 7.4 um rms.",
        "next_measurement": "Move one actuator at a time.",
        "signal_to_noise": 41.0,
        "log_evidence": 812.0,
        "scale_holds": "holds",
        "relation": "readings-poses",
    }
    if verdict == "rejected":
        facts |= {"p_value": 0.4, "probability": 0.0, "log_evidence": -6.0, "signal_to_noise": 1.3}
        facts |= {"rms_before": 7.4, "heldout_rms_before": 7.9, "scale_holds": None}
        facts["explanation"] = f"The data do not show that {cause} is there (p = 0.4)."
    return facts | given


def rows(*several: dict[str, Any]) -> pd.DataFrame:
    """diagnosis.parquet of rows in their order."""
    return pd.DataFrame([{"rank": rank, **one} for rank, one in enumerate(several, 1)])


def rejected() -> list[dict[str, Any]]:
    """Rows of causes that are usually rejected, one per cause."""
    evidence = {"leg-drift": 210.0, "thermal-expansion": -4.1, "leg-thermal": -5.0, "actuator-backlash": 13.0}
    evidence |= {"actuator-periodic-error": -8.0, "measurement-scale": -6.6, "base-deformation": 2.0}
    evidence |= {"flexure-shift": -1.2, "target-moved": -11.0, "targets-swapped": -14.0, "unexplained": 640.0}
    gone = [row(cause, "rejected", log_evidence=e) for cause, e in evidence.items()]
    gone[-1]["follows"] = " ".join(f"rho{leg}_mm" for leg in range(1, LEGS + 1))
    return gone


def diagnosis_tables(diagnosis: pd.DataFrame | None = None, poses: int = 46, held: int = 6) -> dict[str, pd.DataFrame]:
    """A whole run: what was measured and calibrated, and all that its diagnosis leaves."""
    if diagnosis is None:
        found = row("platform-deformation-matrix", parameters=matrix())
        linear = row("platform-deformation-linear", "rejected", log_evidence=420.0)
        diagnosis = rows(found, linear, *rejected())
    return {
        **{name: table.copy() for name, table in _beside(poses).items()},
        "diagnosis": diagnosis,
        "detectable": detectable(),
        "pulls": pulls(),
        "pull_sums": pull_sums(),
        "prediction": prediction(poses, held),
        "next_poses": next_poses(),
    }


@cache
def _beside(poses: int) -> dict[str, pd.DataFrame]:
    """Tables of other stages."""
    return {**campaign_tables(poses), **calibration_tables(models=("6-pus", "beam"))}


def prediction(poses: int = 46, held: int = 6) -> pd.DataFrame:
    """prediction.parquet; the last poses are held out."""
    rng = np.random.default_rng(7)
    roles = ["calibration"] * (poses - held) + ["verification"] * held
    before, after = rng.uniform(15.0, 50.0, poses), rng.uniform(5.0, 9.0, poses)
    table = pd.DataFrame({"pose": range(poses), "role": roles, "rms_before": before, "rms_after": after})
    return table.assign(largest_before=2.4 * before, largest_after=2.4 * after, unit="um")


def detectable(targets: int = 30) -> pd.DataFrame:
    """detectable.parquet: causes of the whole, of single legs, of targets, and one that cannot be shown."""
    found = [("platform-deformation-linear", f"leg{k}", f"kappa_{k}", 0.0011 + 1e-4 * k, "1") for k in range(1, 7)]
    found += [("actuator-backlash", f"leg{k}", f"backlash_{k}", 0.0012 + 1e-4 * k, "mm") for k in range(1, 7)]
    found += [("actuator-gain", "", f"gain_{k}", 0.0004, "1") for k in range(1, 7)]
    found += [("leg-drift", "leg1 leg4", f"drift_{k}", 0.004, "mm") for k in (1, 4)]
    found += [("thermal-expansion", "", "alpha", np.nan, "1/K")]
    found += [("target-moved", f"target P{k}", "dx", 0.02 + 1e-4 * k, "mm") for k in range(targets)]
    table = pd.DataFrame(found, columns=["cause", "subject", "parameter", "size", "unit"])
    return table.assign(power=0.8)


def pulls(legs: int = LEGS) -> pd.DataFrame:
    """pulls.parquet: far out before, where they belong after; one kind that the data do not determine."""
    rng = np.random.default_rng(9)
    table = pd.DataFrame(product(range(1, legs + 1), _GEOMETRY), columns=["leg", "parameter"])
    table = table.assign(pull_before=6.0 * rng.standard_normal(len(table)), pull_after=rng.standard_normal(len(table)))
    return table.assign(identifiable=table["parameter"] != "b_y")


def pull_sums(after: float = 33.0) -> pd.DataFrame:
    """pull_sums.parquet; the band of 30 degrees of freedom."""
    both = [("plain", 1080.0, 30, 16.8, 47.0, 0.0), ("extended", after, 30, 16.8, 47.0, 0.3)]
    return pd.DataFrame(both, columns=["model", "chi_square", "freedom", "lower", "upper", "p_value"])


def next_poses(purposes: tuple[str, ...] = ("platform-deformation-matrix",), poses: int = 5) -> pd.DataFrame:
    """next_poses.parquet."""
    rng = np.random.default_rng(13)
    table = pd.DataFrame(product(purposes, range(1, poses + 1)), columns=["purpose", "pose"])
    table = table.assign(expected="sigma of K11 from 0.50 to 0.25 um/mm")
    table = table.assign(**{f"rho{leg}_mm": 10.0 + rng.uniform(-1.3, 1.3, len(table)) for leg in range(1, LEGS + 1)})
    return table.assign(temperature_c=np.nan)


def changes(legs: int = LEGS, moved: bool = True) -> pd.DataFrame:
    """changes.parquet: the length of leg 4 has changed, or its a_y has; one number was not known before."""
    rng = np.random.default_rng(17)
    table = pd.DataFrame(product(range(1, legs + 1), _GEOMETRY.items()), columns=["leg", "both"])
    table = table.assign(parameter=[p for p, _ in table["both"]], unit=[u for _, u in table["both"]])
    table = table.drop(columns="both").assign(effect_of=None, before=100.0, sigma_before=0.003, sigma_now=0.004)
    z = rng.uniform(-1.5, 1.5, len(table))
    own = (table["leg"] == 4) & (table["parameter"] == "l") & moved
    table = table.assign(now=table["before"] + 0.005 * z, sigma_difference=0.005, z=z, changed=own)
    table = table.assign(change=np.where(own, 0.15, np.nan), sigma_change=np.where(own, 0.002, np.nan))
    table = table.assign(instead=np.where(own, "a_y4", None))
    table.loc[0, ["before", "sigma_before", "sigma_difference", "z"]] = np.nan
    return table
