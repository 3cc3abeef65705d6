"""Listing of the design parameters of flexures and legs: effect of a tolerance, and whether the data determine them."""

from __future__ import annotations

from typing import Any

import pandas as pd

from truing.report.numbers import count, plain, quantity, sign
from truing.report.page import Listing
from truing.report.parameter_names import name_of
from truing.report.tables import Tables, filled


def design_parameters(tables: Tables) -> tuple[Listing, ...]:
    """Return the listing of the design parameters, where a model uses flexures."""
    table = filled(tables, "flexure_parameters")
    if table is None:
        return ()
    rows = tuple(_row(r) for r in table.itertuples())
    marks = tuple("pass" if known else "none" for known in table["identifiable"])
    heads = ("model", "parameter", "nominal", "tolerance", "effect of it", "noise", "sigma / tolerance", "identifiable")
    return (Listing(heads, rows, marks, _caption(table), True, "flexure_parameters.parquet"),)


def _row(r: Any) -> tuple[str, ...]:
    unit = sign(r.unit) if r.unit != "1" else ""
    return (
        r.model,
        name_of(r.parameter, r.leg),
        f"{plain(r.nominal)} {unit}".strip(),
        f"{plain(r.tolerance)} {unit}".strip(),
        quantity(r.sensitivity_um, "um"),
        quantity(r.closure_noise_um, "um"),
        plain(r.sigma_over_tolerance),
        "yes" if r.identifiable else "no",
    )


def _caption(table: pd.DataFrame) -> str:
    known = int(table["identifiable"].sum())
    words = f"{known or 'None'} of {count(len(table), 'design parameter')} of flexures and legs can be identified"
    return (
        f"{words}. Effect: rms change of the closure by one tolerance; without a declared tolerance, by 100 % of the "
        "nominal value"
    )
