"""Poses with rotations and covariance, causes, and parameters of a recorded run, ready for work in Python."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from truing.arrays import Array, Mask, TableRow
from truing.report.numbers import count_text, with_uncertainty
from truing.schemas.near_names import did_you_mean

if TYPE_CHECKING:
    import pandas as pd
    from scipy.spatial.transform import Rotation

_REPORTED = ("found", "suspected", "indistinguishable")
_AXES = "xyz"
_UPPER = np.triu_indices(6)
_SHOWN = 6  # poses of a printed table
_MM_AND_MRAD = np.full(6, 1e3)  # from m and rad
CAUSES = ("cause", "subject", "verdict", "probability", "p_value", "parameter", "value", "sigma", "unit")
PARAMETERS = ("source", "subject", "parameter", "value", "sigma", "expanded_uncertainty", "unit")


@dataclass(frozen=True, repr=False)
class Poses:
    """Poses of bodies, n in all: position (n, 3) in m and rotation vector (n, 3) in rad, with covariance (n, 6, 6).

    The rotation is from body to parent. ``covariance`` is in m^2, m rad and rad^2, in the order position, rotation; a
    small rotation is about the axes of the parent: R <- exp(theta) R. NaN where a pose could not be determined:
    ``is_determined`` (n,) is then False.
    """

    pose: Array
    body: Array
    parent: Array
    position: Array
    rotation_vector: Array
    covariance: Array
    is_determined: Mask

    def __len__(self) -> int:
        return len(self.pose)

    @cached_property
    def rotation(self) -> Rotation:
        """Rotations from body to parent, one per pose; SciPy is loaded for them. No rotation where undetermined."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_rotvec(np.where(self.is_determined[:, None], self.rotation_vector, 0.0))

    def of(self, body: str) -> Poses:
        """Return the poses of one body; raises KeyError for an unknown one."""
        is_of_body = self.body == body
        if not is_of_body.any():
            known = list(dict.fromkeys(self.body.tolist()))
            raise KeyError(f"{body}: this run has poses of {', '.join(known)}{did_you_mean(body, known)}")
        arrays = (self.pose, self.body, self.parent, self.position, self.rotation_vector, self.covariance)
        pose, bodies, parent, position, vectors, covariance = (part[is_of_body] for part in arrays)
        return Poses(pose, bodies, parent, position, vectors, covariance, self.is_determined[is_of_body])

    def frame(self) -> pd.DataFrame:
        """Return a table with a row per pose: position, rotation vector, and standard uncertainty of each component."""
        import pandas as pd

        sigma = np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
        names = [f"{a}_m" for a in _AXES] + [f"r{a}_rad" for a in _AXES]
        values = np.hstack([self.position, self.rotation_vector])
        columns = dict(zip(names, values.T, strict=True)) | {
            f"sigma_{name}": sigma_of_axis for name, sigma_of_axis in zip(names, sigma.T, strict=True)
        }
        named = {"pose": self.pose, "body": self.body, "parent": self.parent}
        return pd.DataFrame(named | columns | {"is_determined": self.is_determined})

    def __repr__(self) -> str:
        """Return the number of poses of each body, and the first poses with standard uncertainties."""
        return f"{self._summary}\n{self._first_rows.to_string(index=False)}{self._omitted}"

    def _repr_html_(self) -> str:
        """Return the same as HTML, for notebooks."""
        return f"<p>{self._summary}</p>{self._first_rows.to_html(index=False, border=0)}<p>{self._omitted}</p>"

    @property
    def _summary(self) -> str:
        bodies, counts = np.unique(self.body.astype(str), return_counts=True)
        each = ", ".join(
            f"{count_text(int(number), 'pose')} of {body}" for body, number in zip(bodies, counts, strict=True)
        )
        lost = int((~self.is_determined).sum())
        return f"{each or 'no poses'}; {f'{lost} not determined' if lost else 'all determined'}"

    @property
    def _omitted(self) -> str:
        left = len(self) - _SHOWN
        return f"\n... and {left} more" if left > 0 else ""

    @property
    def _first_rows(self) -> pd.DataFrame:
        import pandas as pd

        values = np.hstack([self.position, self.rotation_vector])[:_SHOWN] * _MM_AND_MRAD
        sigma = np.sqrt(np.diagonal(self.covariance[:_SHOWN], axis1=1, axis2=2)) * _MM_AND_MRAD
        heads = [f"{a} [mm]" for a in _AXES] + [f"r{a} [mrad]" for a in _AXES]
        cells = {
            head: [with_uncertainty(v, s) for v, s in zip(values[:, i], sigma[:, i], strict=True)]
            for i, head in enumerate(heads)
        }
        named = {"pose": self.pose[:_SHOWN], "body": self.body[:_SHOWN], "in": self.parent[:_SHOWN]}
        return pd.DataFrame(named | cells)


def poses_of(table: pd.DataFrame) -> Poses:
    """Return the poses that later stages use, from the rows of poses.parquet."""
    default_rows = table[table["default"]]
    position = default_rows[[f"p{a}_mm" for a in _AXES]].to_numpy(float) / 1e3
    vectors = default_rows[[f"r{a}_rad" for a in _AXES]].to_numpy(float)
    covariance = np.empty((len(default_rows), 6, 6))
    upper = default_rows[[f"cov_{i}_{j}" for i, j in zip(*_UPPER, strict=True)]].to_numpy(float)
    covariance[:, _UPPER[0], _UPPER[1]] = covariance[:, _UPPER[1], _UPPER[0]] = upper
    determined = np.isfinite(position).all(1) & np.isfinite(vectors).all(1)
    pose, body, parent = (default_rows[name].to_numpy() for name in ("pose", "body", "parent"))
    return Poses(pose, body, parent, position, vectors, covariance, determined)


def causes_of(table: pd.DataFrame) -> pd.DataFrame:
    """Return one row per parameter of every cause that was found, is suspected, or is indistinguishable from a found
    one.

    A cause without a parameter has one row with no value. Columns are those of ``CAUSES``.
    """
    import pandas as pd

    rows: list[TableRow] = []
    for row in table[table["verdict"].isin(_REPORTED)].to_dict("records"):
        columns = {name: row[name] for name in CAUSES[:5]} | {"subject": row["subject"] or ""}
        parameters: TableRow = json.loads(row["parameters"] or "{}")
        rows += [columns | {"parameter": name, **number} for name, number in parameters.items()] or [columns]
    return pd.DataFrame(rows, columns=list(CAUSES))


def parameters_of(tables: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return the identified parameters of the calibration, causes, sensor and chain, with expanded uncertainty.

    Columns are those of ``PARAMETERS``; ``source`` names the result. Poses and accuracies are no parameters. The
    expanded uncertainty is NaN where the data do not determine a number of a chain beyond its tolerance.
    """
    import pandas as pd

    parts: list[pd.DataFrame] = []
    if "uncertainty" in tables:
        rows = tables["uncertainty"]
        rows = rows[~rows["result"].isin(("pose", "tip", "load", "accuracy"))]
        names = {"result": "source", "quantity": "parameter", "estimate": "value", "standard_uncertainty": "sigma"}
        parts.append(rows.rename(columns=names).reindex(columns=PARAMETERS))
    if "chain_parameters" in tables:
        rows = tables["chain_parameters"].rename(columns={"joint": "subject", "identified": "value"})
        if parts:
            stated = parts[0][parts[0]["source"] == "chain"][["subject", "parameter", "expanded_uncertainty"]]
            rows, parts = rows.merge(stated, how="left"), [parts[0][parts[0]["source"] != "chain"]]
        parts.append(rows.assign(source="chain").reindex(columns=PARAMETERS))
    filled_parts = [part for part in parts if len(part)]
    return pd.concat(filled_parts, ignore_index=True) if filled_parts else pd.DataFrame(columns=list(PARAMETERS))


def verdict_text(verdict: pd.DataFrame) -> str:
    """Return the verdict of a run as text: a line per section, with its state and its explanation."""
    from textwrap import fill

    rows = verdict.to_dict("records")
    width = max((len(row["section"]) + len(row["state"]) + 4 for row in rows), default=0)
    return "\n".join(
        fill(f"{row['section']} ({row['state']})".ljust(width) + row["explanation"], 100, subsequent_indent=" " * width)
        for row in rows
    )


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
