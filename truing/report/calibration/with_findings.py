"""Calibrations of recorded data and of data with findings applied, and the decisions on causes in campaign.toml."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from truing.report.column_heads import Head, schema_head
from truing.report.numbers import count_text, listed, plain, sign
from truing.report.page import Listing, Verdict
from truing.report.tables import Tables, cell, table_or_none

_RECORDED = "as recorded"
_ERROR = "Rms / largest of measured minus predicted in this quantity."
_CAPTION = "Calibrations of the data as recorded and with findings applied: errors on held-out data, rms / largest"
_OF_FITTED = " (here on the fitted poses: none was held out)"
_NO_EFFECT = "no calibration depends on it, so no result changes"


def compared_calibrations(tables: Tables) -> list[Listing]:
    """Return both calibrations with their errors, the main one first; nothing if no finding changes the calibrated
    data."""
    table = table_or_none(tables, "calibrations_compared")
    if table is None:
        return []
    quantities = table.drop_duplicates(["quantity", "unit"])
    columns = list(zip(quantities["quantity"], quantities["unit"], strict=True))
    rows = [row for main in (True, False) for row in _rows(table[table["is_main"] == main], columns)]
    heads = (
        Head("calibration", "Whether the calibration is the main one, which all other tables of the page show."),
        schema_head("findings applied", "findings"),
        Head("model", "Model of the calibration that held-out data choose."),
        schema_head("tested on"),
        *(Head(f"{name} ({sign(unit)})", _ERROR) for name, unit in columns),
    )
    caption = _CAPTION + (_OF_FITTED if (table["tested_on"] == "calibration poses").any() else "")
    return [Listing(heads, tuple(rows), caption=caption, held_by="calibrations_compared.parquet")]


def _rows(errors: pd.DataFrame, columns: list[tuple[str, str]]) -> list[tuple[str, ...]]:
    result = []
    for tested_on, part in errors.groupby("tested_on", sort=False):
        first, by_quantity = part.iloc[0], part.set_index("quantity")
        model = " ".join(filter(None, (first["model"], cell(first.get("deformation")))))
        names = "main" if first["is_main"] else "for comparison"
        head = (f"{first['data']}, {names}", cell(first["findings"]) or "none", model)
        result.append((*head, str(tested_on), *(_size(by_quantity, name) for name, _ in columns)))
        if part["rms_unchanged"].notna().any() and not part["rms_unchanged"].equals(part["rms_error"]):
            unchanged = f"{tested_on} that no finding changes"
            result.append((*head, unchanged, *(plain(by_quantity["rms_unchanged"].get(name)) for name, _ in columns)))
    return result


def _size(by_quantity: pd.DataFrame, name: str) -> str:
    if name not in by_quantity.index:
        return ""
    rms, largest = by_quantity.loc[name, "rms_error"], by_quantity.loc[name, "largest_error"]
    return plain(rms) if largest != largest else f"{plain(rms)} / {plain(largest)}"


def data_words(tables: Tables) -> str:
    """Return in words the data of the main calibration, if applied findings change them; empty otherwise."""
    table = table_or_none(tables, "calibrations_compared")
    if table is None:
        return ""
    finding_words = cell(table.loc[table["data"] != _RECORDED, "findings"].iloc[0]) + _suspected_causes(tables)
    if table.loc[table["is_main"], "data"].iloc[0] == _RECORDED:
        return (
            "The main calibration uses the data as recorded. For comparison, the page also gives a calibration with "
            f"{finding_words} applied."
        )
    return (
        f"The main calibration includes {finding_words}, as [diagnosis] apply asks. For comparison, the page also "
        "gives a calibration of the data as recorded."
    )


def _suspected_causes(tables: Tables, names: Sequence[str] | None = None) -> str:
    """Return in words the causes of the extended model, or of some names, that are only suspected; empty
    where none is."""
    rows = table_or_none(tables, "diagnosis")
    if rows is None:
        return ""
    distinct = dict.fromkeys(rows.loc[rows["verdict"] == "suspected", "cause"])
    doubted = [name for name in distinct if names is None or name in names]
    return f" (only suspected: {listed(doubted)})" if doubted else ""


def choice_verdicts(tables: Tables) -> list[Verdict]:
    """Return the decisions on causes in campaign.toml, and their results."""
    table = table_or_none(tables, "diagnosis_choices")
    if table is None:
        return []
    names = {outcome: group["cause"].tolist() for outcome, group in table.groupby("outcome", sort=False)}
    reported: list[Verdict] = []
    if missed := names.get("not found"):
        missed_text = f"{count_text(len(missed), 'cause')} that the diagnosis did not find"
        reported.append(("warn", f"[diagnosis] apply names {missed_text}: {listed(missed)}. It was not applied."))
    if idle := names.get("no effect"):
        reported.append(("warn", f"[diagnosis] apply names {listed(idle)}: found, but {_NO_EFFECT}."))
    if applied := names.get("applied"):
        reported.append(
            ("warn", f"Applied, as [diagnosis] apply asks: {listed(applied)}{_suspected_causes(tables, applied)}.")
        )
    if ignored := names.get("ignored"):
        reported.append(("warn", f"Not searched for, as [diagnosis] ignore asks: {listed(ignored)}."))
    return reported
