"""Section of a second campaign: its errors under models that were fitted to the first one."""

from __future__ import annotations

import pandas as pd

from truing.report.heads import MODEL_OF_LEGS, Head
from truing.report.numbers import count_text, plain, quantity, sign
from truing.report.page import Listing, ReportSection
from truing.report.tables import Tables, cell, reason, table_or_none

_TITLE = "A second campaign of the same machine"
_ARTIFACT = "second_campaign_errors"


def transfer(tables: Tables) -> ReportSection | None:
    """Return the errors of the second campaign under every model; None where the campaign names none."""
    if _ARTIFACT not in tables:
        return None
    errors = table_or_none(tables, _ARTIFACT)
    if errors is None:
        return ReportSection("transfer", _TITLE, f"Not evaluated: {reason(tables, _ARTIFACT)}", state="not evaluated")
    return ReportSection("transfer", _TITLE, _opening_sentences(errors), listings=(_listing(errors),))


def _opening_sentences(errors: pd.DataFrame) -> str:
    """Return the errors of the first quantity that most models predict, compared with noise."""
    rows = errors[errors["quantity"] == errors["quantity"].value_counts(sort=False).idxmax()]
    first = rows.iloc[0]
    sizes = ", ".join(f"{r.prediction_by} {quantity(r.rms_error, r.unit)}" for r in rows.itertuples())
    noise = first["noise_rms"]
    left = "" if noise != noise else f"; noise alone gives {quantity(noise, first['unit'])}"
    named = f"Models that were fitted to this campaign predict {first['campaign']}, which none of them used."
    return f"{named} Errors in {first['quantity']} of {count_text(int(first['count']), 'value')}, rms: {sizes}{left}."


def _listing(errors: pd.DataFrame) -> Listing:
    quantities = errors.drop_duplicates(["quantity", "unit"])
    columns = list(zip(quantities["quantity"], quantities["unit"], strict=True))
    rows = []
    for (prediction, model), group in errors.groupby(["prediction_by", "model"], sort=False):
        cells = {r.quantity: f"{plain(r.rms_error)} / {plain(r.largest_error)}" for r in group.itertuples()}
        rows.append((str(prediction), cell(model), *(cells.get(name, "") for name, _ in columns)))
    reported = quantities[quantities["noise_rms"].notna()].set_index("quantity")["noise_rms"]
    rows.append(("noise alone", "", *(plain(reported[name]) if name in reported else "" for name, _ in columns)))
    error = "Rms / largest of measured minus predicted in the second campaign."
    heads = (
        Head("predicted by", "Model that predicts: nominal machine, chosen calibration, or extended model."),
        MODEL_OF_LEGS,
        *(Head(f"{name} ({sign(unit)})", error) for name, unit in columns),
    )
    caption = "Measured minus predicted in the second campaign: rms / largest"
    return Listing(heads, tuple(rows), caption=caption, held_by=f"{_ARTIFACT}.parquet")
