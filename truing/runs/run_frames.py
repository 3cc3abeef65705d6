"""Poses with rotations and covariance, causes, and parameters of a recorded run, ready for work in Python."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from truing.arrays import Array, Mask
from truing.schemas.near_names import did_you_mean

if TYPE_CHECKING:
    import pandas as pd
    from scipy.spatial.transform import Rotation

_TOLD = ("found", "suspected", "indistinguishable")
_AXES = "xyz"
_UPPER = np.triu_indices(6)
CAUSES = ("cause", "subject", "verdict", "probability", "p_value", "parameter", "value", "sigma", "unit")
PARAMETERS = ("source", "subject", "parameter", "value", "sigma", "expanded_uncertainty", "unit")


@dataclass(frozen=True)
class Poses:
    """Poses of bodies, n in all: position (n, 3) in m and rotation from body to parent, with covariance (n, 6, 6).

    ``covariance`` is in m^2, m rad and rad^2, in the order position, rotation; a small rotation is about the axes of
    the parent: R <- exp(theta) R. NaN where a pose could not be determined: ``is_determined`` (n,) is then False.
    """

    pose: Array
    body: Array
    parent: Array
    position: Array
    rotation: Rotation
    covariance: Array
    is_determined: Mask

    def __len__(self) -> int:
        return len(self.pose)

    def of(self, body: str) -> Poses:
        """Return the poses of one body; raises KeyError for an unknown one."""
        own = self.body == body
        if not own.any():
            known = list(dict.fromkeys(self.body.tolist()))
            raise KeyError(f"{body}: this run has poses of {', '.join(known)}{did_you_mean(body, known)}")
        arrays = (self.pose, self.body, self.parent, self.position)
        pose, bodies, parent, position = (part[own] for part in arrays)
        return Poses(pose, bodies, parent, position, self.rotation[own], self.covariance[own], self.is_determined[own])


def poses_of(table: pd.DataFrame) -> Poses:
    """Return the poses that later stages use, from the rows of poses.parquet."""
    from scipy.spatial.transform import Rotation

    own = table[table["default"]]
    position = own[[f"p{a}_mm" for a in _AXES]].to_numpy(float) / 1e3
    vectors = own[[f"r{a}_rad" for a in _AXES]].to_numpy(float)
    covariance = np.empty((len(own), 6, 6))
    upper = own[[f"cov_{i}_{j}" for i, j in zip(*_UPPER, strict=True)]].to_numpy(float)
    covariance[:, _UPPER[0], _UPPER[1]] = covariance[:, _UPPER[1], _UPPER[0]] = upper
    determined = np.isfinite(position).all(1) & np.isfinite(vectors).all(1)
    rotation = Rotation.from_rotvec(np.where(determined[:, None], vectors, 0.0))
    pose, body, parent = (own[name].to_numpy() for name in ("pose", "body", "parent"))
    return Poses(pose, body, parent, position, rotation, covariance, determined)


def causes_of(table: pd.DataFrame) -> pd.DataFrame:
    """Return one row per parameter of every cause that was found, is suspected, or cannot be told from a found one.

    A cause without a parameter has one row with no value. Columns are those of ``CAUSES``.
    """
    import pandas as pd

    rows: list[dict[str, Any]] = []
    for row in table[table["verdict"].isin(_TOLD)].to_dict("records"):
        own = {name: row[name] for name in CAUSES[:5]} | {"subject": row["subject"] or ""}
        given: Mapping[str, Any] = json.loads(row["parameters"] or "{}")
        rows += [own | {"parameter": name, **number} for name, number in given.items()] or [own]
    return pd.DataFrame(rows, columns=list(CAUSES))


def parameters_of(tables: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return identified parameters: of the calibration, causes and sensor with expanded uncertainty, and of a chain.

    Columns are those of ``PARAMETERS``; ``source`` names the result. Poses and accuracies are no parameters.
    """
    import pandas as pd

    parts: list[pd.DataFrame] = []
    if "uncertainty" in tables:
        own = tables["uncertainty"]
        own = own[~own["result"].isin(("pose", "tip", "load", "accuracy"))]
        names = {"result": "source", "quantity": "parameter", "estimate": "value", "standard_uncertainty": "sigma"}
        parts.append(own.rename(columns=names).reindex(columns=PARAMETERS))
    if "chain_parameters" in tables:
        own = tables["chain_parameters"].rename(columns={"joint": "subject", "identified": "value"})
        parts.append(own.assign(source="chain").reindex(columns=PARAMETERS))
    found = [part for part in parts if len(part)]
    return pd.concat(found, ignore_index=True) if found else pd.DataFrame(columns=list(PARAMETERS))


def verdict_html(campaign: str, verdict: pd.DataFrame, tables: int) -> str:
    """Return the verdict of a run as an HTML table for notebooks, with the number of its tables."""
    from html import escape

    rows = "".join(
        f"<tr><td>{escape(row['section'])}</td><td>{escape(row['state'])}</td>"
        f"<td style='text-align:left'>{escape(row['explanation'])}</td></tr>"
        for row in verdict.to_dict("records")
    )
    head = "<tr><th>section</th><th>state</th><th style='text-align:left'>explanation</th></tr>"
    return f"<p><b>{escape(campaign)}</b>: a run with {tables} tables</p><table>{head}{rows}</table>"
