"""The section of the diagnosis: what the simulation gets wrong, in words and in figures."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from truing.report.diagnosis_figure import misses
from truing.report.numbers import count, p_value, plain, printed, sign, with_uncertainty
from truing.report.page import Listing, Section
from truing.report.reasons import why_no_diagnosis
from truing.report.tables import Tables, cell

if TYPE_CHECKING:
    import pandas as pd


def diagnosis(tables: Tables) -> Section | None:
    """Candidates with their evidence and their gain."""
    if "diagnosis" not in tables:
        return None
    table = tables["diagnosis"].sort_values("rank")
    if not len(table):
        why = why_no_diagnosis(tables)
        return Section("diagnosis", "Diagnosis", why[:1].upper() + why[1:], state="not evaluated")
    found = table[table["verdict"] == "found"]
    drawn = [
        (misses(rows), "Calibration poses were fitted to, held-out poses were not.")
        for _, rows in found[found["rms_before"].notna() & found["rms_after"].notna()].groupby("unit", sort=False)
    ]
    listings = [
        _words(found, "What was found"),
        _words(table[table["verdict"] == "indistinguishable"], "What this campaign cannot tell from it"),
        _candidates(table),
        *(_parameters(r.cause, r.subject, r.parameters) for r in found.itertuples()),
        _words(table[table["verdict"] == "rejected"], "What was not found, and how large it could have stayed", True),
    ]
    return Section("diagnosis", "Diagnosis", _lead(table, found), tuple(drawn), tuple(x for x in listings if x.rows))


def _lead(table: pd.DataFrame, found: pd.DataFrame) -> str:
    judged = f"{count(len(table), 'candidate')} judged"
    if not len(found):
        return f"{judged}, none found: the simulation agrees with the data to within its noise."
    return f"{judged}, {len(found)} found and accepted into the extended model, model.toml."


def _words(rows: pd.DataFrame, caption: str, folded: bool = False) -> Listing:
    told = tuple(
        (r.cause, cell(r.subject), printed(cell(r.explanation)), printed(cell(r.next_measurement)))
        for r in rows.itertuples()
    )
    heads = ("cause", "subject", "what the data say", "next measurement")
    return Listing(heads, told, caption=caption, folded=folded, held_by="diagnosis.parquet")


def _candidates(table: pd.DataFrame) -> Listing:
    rows = tuple(
        (
            str(r.rank),
            r.cause,
            r.verdict,
            cell(r.subject),
            p_value(r.p_value),
            plain(r.probability),
            f"{plain(r.rms_before)} → {plain(r.rms_after)}",
            f"{plain(r.heldout_rms_before)} → {plain(r.heldout_rms_after)}",
            plain(r.noise_floor),
            sign(cell(r.unit)),
        )
        for r in table.itertuples()
    )
    heads = ("rank", "cause", "verdict", "subject", "p", "probability", "rms", "held-out rms", "noise floor", "unit")
    marks = tuple("fail" if v == "found" else "none" for v in table["verdict"])
    return Listing(heads, rows, marks, "All candidates, before and after each is accepted", len(rows) > 12)


def _parameters(cause: str, subject: object, parameters: str) -> Listing:
    rows = tuple(
        (
            name,
            with_uncertainty(p["value"], p.get("sigma")) if isinstance(p["value"], (int, float)) else cell(p["value"]),
            sign(cell(p.get("unit"))),
        )
        for name, p in json.loads(parameters).items()
    )
    title = f"Parameters of {f'{cause} {cell(subject)}'.strip()}"
    return Listing(("parameter", "value", "unit"), rows, caption=title, folded=len(rows) > 8)
