"""The section of the platform's displacement: what was measured of it, and what readings leave beside it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from truing.report.numbers import count, p_value, with_uncertainty
from truing.report.page import Listing, Section
from truing.report.sensor.axes import CHANNELS, LOADS, moved_unit
from truing.report.sensor.reading_figures import reading_residuals
from truing.report.tables import Tables, filled, reason

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

_COMPONENTS = dict(zip(CHANNELS, ("dx_mm", "dy_mm", "dz_mm", "rx_rad", "ry_rad", "rz_rad"), strict=True))
_LOAD_COLUMNS = dict(zip(LOADS, ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm"), strict=True))
_UNLIKELY = 1e-3


def displacement(tables: Tables) -> Section | None:
    """Load cases, which components are known of them, and what is left of the readings."""
    if "displacement" not in tables:
        return None
    cases = filled(tables, "displacement")
    if cases is None:
        why = reason(tables, "displacement") or "The campaign holds no readings of a platform under load."
        return Section("displacement", "Displacement", why, state="not evaluated")
    residuals, terms = tables["reading_residuals"], tables["run_terms"]
    drawn: tuple[tuple[go.Figure, str], ...] = ()
    if residuals["residual"].notna().any():
        words = (
            "What is left about a smooth curve of load and time through each run. Crosses: kept out as gross errors."
        )
        drawn = ((reading_residuals(residuals), words),)
    listings = [one for one in (_known(cases), _drifts(terms)) if one is not None]
    return Section("displacement", "Displacement", _lead(cases, residuals), drawn, tuple(listings))


def _lead(cases: pd.DataFrame, residuals: pd.DataFrame) -> str:
    known = cases[list(_COMPONENTS.values())].notna().to_numpy()
    said = [
        f"{count(len(residuals), 'reading')} of {count(residuals['run'].nunique(), 'run')} join to the displacement"
    ]
    whole = int(known.all(axis=1).sum())
    said[0] += f" of the platform in {count(len(cases), 'load case')}, {whole:,} of them in all six components."
    never = [channel for channel, seen in zip(_COMPONENTS, known.any(axis=0), strict=True) if not seen]
    if never:
        said.append(f"Never measured, and therefore unknown: {', '.join(never)}.")
    said.append("Zeros and drifts of the runs are taken out; their uncertainty is in the covariance.")
    return " ".join(said)


def _known(cases: pd.DataFrame) -> Listing | None:
    """How many load cases of every axis know every component."""
    loads = cases[list(_LOAD_COLUMNS.values())].to_numpy()
    rows, marks = [], []
    for a, load in enumerate(LOADS):
        own = (loads[:, a] != 0.0) & (np.delete(loads, a, axis=1) == 0.0).all(axis=1)
        if own.any():
            seen = [int(cases.loc[own, column].notna().sum()) for column in _COMPONENTS.values()]
            rows.append((load, f"{int(own.sum()):,}", *(f"{n:,}" if n else "not measured" for n in seen)))
            marks.append("" if all(seen) else "none")
    several = (loads != 0.0).sum(axis=1) > 1
    if several.any():
        seen = [int(cases.loc[several, column].notna().sum()) for column in _COMPONENTS.values()]
        rows.append(("several", f"{int(several.sum()):,}", *(f"{n:,}" if n else "not measured" for n in seen)))
        marks.append("")
    if not rows:
        return None
    caption = "Load cases in which each component was measured"
    return Listing(("load", "cases", *CHANNELS), tuple(rows), tuple(marks), caption, held_by="displacement.parquet")


def _drifts(terms: pd.DataFrame) -> Listing | None:
    """Runs that drift beyond chance."""
    drifts = terms[terms["term"] == "drift"]
    real = drifts[drifts["p_value"] < _UNLIKELY / max(len(drifts), 1)]
    if not len(real):
        return None
    rows = tuple(
        (str(r.run), r.channel, with_uncertainty(r.value, r.sigma), f"{moved_unit(r.channel)}/h", p_value(r.p_value))
        for r in real.itertuples()
    )
    caption = f"Runs that drift beyond chance, {len(real)} of {len(drifts)} that tell their drift"
    return Listing(("run", "channel", "drift", "unit", "p"), rows, (), caption, len(rows) > 20, "run_terms.parquet")
