"""Diagnosis of a campaign on real measurements, from the tables of its run."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np
import pandas as pd

from truing.estimation.rigid_poses.umeyama import umeyama
from truing.report.diagnosis.adequacy import shortcoming
from truing.report.numbers import percent
from truing.report.wordings.nonparametric_wordings import columns_words
from truing.schemas.covariates import names_in

_MM = ["x_mm", "y_mm", "z_mm"]
_EDGE = 25  # poses at either end that tell where a target began and ended


def diagnosed(tables: dict[str, pd.DataFrame]) -> dict[str, Any]:
    """Causes found or suspected, in order, with errors before and after; unexplained rest; violated assumptions of the
    final model."""
    rows = tables["diagnosis"]
    found = rows[rows["verdict"].isin(["found", "suspected"])]
    is_remainder = found["reason_code"] == "remainder"
    causes = found[~found["parameters"].str.contains("noise_ratio") & ~is_remainder]
    noise = found[found["parameters"].str.contains("noise_ratio")]
    return {
        "found": [_finding(row) for _, row in causes.iterrows()],
        "noise": [_first_sentence(text) for text in noise["explanation"]],
        "remainder": [_followed(row) for _, row in found[is_remainder].iterrows()],
        "before": float(causes["rms_before"].iloc[0]) if len(causes) else None,
        "after": float(causes["rms_after"].iloc[-1]) if len(causes) else None,
        "floor": float(rows["noise_floor"].iloc[len(causes) - 1]) if len(causes) else None,
        "falls_short": shortcoming(tables),
        "rivals": sorted(set(rows.loc[rows["verdict"] == "indistinguishable", "cause"])),
    }


def _finding(row: pd.Series) -> dict[str, Any]:
    return {
        "cause": row["cause"],
        "verdict": row["verdict"],
        "subject": row["subject"],
        "says": row["clause"],
        "settings": json.loads(row["settings"]),
        "before": float(row["rms_before"]),
        "after": float(row["rms_after"]),
        "value": {name: load["value"] for name, load in json.loads(row["parameters"]).items()},
    }


def _followed(row: pd.Series) -> str:
    """The inputs that predict residuals, and their largest share of the squares of the model without causes."""
    return f"{columns_words(names_in(row['follows']))} {percent(100.0 * row['share_predicted'])}"


def _first_sentence(text: str) -> str:
    return re.split(r"(?<=[a-z)])[.:,] ", text)[0]


def length(value: dict[str, Any], names: tuple[str, ...]) -> float:
    """The length of a vector of parameters."""
    return float(np.linalg.norm([value[name] for name in names]))


def seen_in_between(row: dict[str, Any], observations: pd.DataFrame) -> bool:
    """Return True if a step is visible between first and last poses: their medians do not show one at the very ends."""
    poses = sorted(observations["pose"].unique())
    first = poses.index(row["value"]["from_pose"]) if "from_pose" in row["value"] else _EDGE
    return _EDGE // 2 <= first < len(poses) - _EDGE // 2


def walked(observations: pd.DataFrame) -> dict[str, float]:
    """Distance between the mean target of each body in the first and in the last poses, mm."""
    found = {}
    for body, rows in observations.groupby("body"):
        wide = rows.pivot(index="pose", columns="target", values=_MM).sort_index()
        wide = wide.dropna()
        points = wide.to_numpy().reshape(len(wide), 3, -1)
        first, last = np.median(points[:_EDGE], axis=0), np.median(points[-_EDGE:], axis=0)
        found[str(body)] = float(np.linalg.norm((last - first).mean(axis=1)))
    return found


def up_and_down(tables: dict[str, pd.DataFrame], drive: str) -> dict[str, float]:
    """Rms and largest distance of targets between the way up and the way down at equal values of a drive, mm; the same
    after a rigid fit."""
    rows = tables["observations"].merge(tables["configurations"], on="pose")
    turn = int(rows.loc[rows[drive].idxmax(), "pose"])
    wide = [
        part.pivot(index=drive, columns="target", values=_MM).sort_index()
        for part in (rows[rows["pose"] <= turn], rows[rows["pose"] > turn])
    ]
    shared = wide[0].index.intersection(wide[1].index)
    up, down = (w.loc[shared].to_numpy().reshape(len(shared), 3, -1).transpose(0, 2, 1) for w in wide)
    apart = np.linalg.norm(down - up, axis=-1)
    fit = umeyama(up * 1e-3, down * 1e-3)
    return {
        "rms": float(np.sqrt(np.mean(apart**2))),
        "largest": float(apart.max()),
        "shape_um": 1e6 * float(np.sqrt(np.mean(fit.rms**2))),
    }


def sag(observations: pd.DataFrame, poses: tuple[int, int]) -> float:
    """Rigid-fit rms per point between two poses, um."""
    wide = observations.pivot(index="pose", columns="target", values=_MM).loc[list(poses)].dropna(axis=1)
    first, second = wide.to_numpy().reshape(2, 3, -1).transpose(0, 2, 1) * 1e-3
    return 1e6 * float(umeyama(first, second[None]).rms[0])
