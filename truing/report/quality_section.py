"""The section of the quality checks."""

from __future__ import annotations

from typing import Any

import pandas as pd

from truing.report.numbers import count as counted
from truing.report.numbers import printed, quantity
from truing.report.page import Listing, Section
from truing.report.reasons import why_no_quality
from truing.report.tables import Tables, cell

_ORDER = {"fail": 0, "warn": 1, "pass": 2, "not evaluated": 3}
_HEADS = ("verdict", "check", "subject", "value", "limit", "what it says")
# More rows that call for a look than this are folded away.
_OPEN = 12


def qa(tables: Tables) -> Section | None:
    """Every check with its verdict, the failed ones first; what a person accepted stands by itself."""
    if "qa" not in tables:
        return None
    if not len(tables["qa"]):
        return Section("qa", "Quality", why_no_quality(tables), state="not evaluated")
    qa = tables["qa"].assign(order=tables["qa"]["verdict"].map(_ORDER)).sort_values("order", kind="stable")
    accepted = accepted_verdicts(qa)
    listings = [
        _checks(qa[(qa["verdict"] == "fail") & ~accepted], "Failed"),
        _checks(qa[accepted], "Accepted by a person", ("accepted by",)),
        _checks(qa[(qa["verdict"] == "warn") & ~accepted], "To look at"),
        _checks(qa, f"All {len(qa)} checks", folded=True),
    ]
    counts = qa[~accepted]["verdict"].value_counts()  # as the head of the page, the log and the exit code count them
    told = [f"{counts[v]} {v}" for v in _ORDER if v in counts]
    lead = ", ".join([*told, *([f"{int(accepted.sum())} accepted"] if accepted.any() else [])])
    idle = (qa["verdict"] == "not evaluated").all()
    state = "fail" if listings[0].rows else "not evaluated" if idle else "pass"
    shown = tuple(x for x in listings if x.rows)
    return Section("qa", "Quality", f"{counted(len(qa), 'check')}: {lead}.", listings=shown, state=state)


def accepted_verdicts(qa: pd.DataFrame) -> pd.Series:
    """Which rows of ``qa`` a person accepted."""
    return qa["accepted"].notna() if "accepted" in qa else qa["verdict"].isna()


def _checks(qa: Any, caption: str, more: tuple[str, ...] = (), folded: bool = False) -> Listing:
    rows = tuple(
        (
            r.verdict,
            r.check,
            cell(r.subject),
            quantity(r.value, r.unit),
            quantity(r.limit, r.unit),
            printed(r.message),
            *([cell(r.accepted)] if more else []),
        )
        for r in qa.itertuples()
    )
    marks = tuple("accepted" if more else "none" if v == "not evaluated" else v for v in qa["verdict"])
    title = f"{caption} ({len(rows)})" if len(rows) > _OPEN and not folded else caption
    return Listing((*_HEADS, *more), rows, marks, title, folded or len(rows) > _OPEN, "qa.parquet")
