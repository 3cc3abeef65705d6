"""Whether the final model holds as a whole: what it leaves, tested against plain noise."""

from __future__ import annotations

from typing import Any

from truing.report.numbers import count, p_value, rough
from truing.report.page import Listing, Section
from truing.report.tables import Tables, cell, filled
from truing.report.wordings.followed import columns_words

_TITLE = "Does the model hold as a whole?"
_LOOKED_FOR = {
    "observation-noise": "noise of what was measured",
    "input-noise": "noise of the inputs",
    "like-neighbours": "residuals that resemble their neighbours",
}
_UNITS = {
    "like-neighbours": "correlation of neighbours",
    **dict.fromkeys(("observation-noise", "input-noise"), "of declared"),
}


def adequacy(tables: Tables) -> Section | None:
    """Every test of the final model; None where the run left none."""
    table = filled(tables, "adequacy")
    if table is None:
        return None
    rows = list(table.itertuples())
    tested = [row for row in rows if row.state != "not tested"]
    failed = shortcoming(tables)
    lead = f"{count(len(tested), 'test')} of what the final model leaves, against plain noise: "
    lead += f"{failed}." if failed else "none finds more than noise."
    untested = [_LOOKED_FOR[row.test] for row in rows if row.state == "not tested"]
    lead += f" Not tested, for too few data: {', '.join(untested)}." if untested else ""
    cells = tuple((_LOOKED_FOR[row.test], _along(row), _value(row), p_value(row.p_value), row.state) for row in rows)
    marks = tuple({"fails": "fail", "ok": "pass"}.get(row.state, "none") for row in rows)
    heads = ("looked for", "along", "value", "p (corrected)", "state")
    listing = Listing(heads, cells, marks, "All tests", len(cells) > 8, "adequacy.parquet")
    state = "fail" if failed else "pass" if tested else "not evaluated"
    return Section("adequacy", _TITLE, lead, (), (listing,), state)


def shortcoming(tables: Tables) -> str:
    """By what the final model falls short most, without a full stop; empty where it holds."""
    table = filled(tables, "adequacy")
    failed = None if table is None else table[table["state"] == "fails"].sort_values("p_value")
    if failed is None or not len(failed):
        return ""
    worst = next(failed.itertuples())
    if worst.test == "like-neighbours":
        return f"residuals resemble each other where {_along(worst)} is alike (correlation {rough(worst.value)})"
    return f"{_LOOKED_FOR[worst.test]} is {rough(worst.value)} times what was declared"


def _along(row: Any) -> str:
    return columns_words(tuple(cell(row.along).split(" "))) if cell(row.along) else "–"


def _value(row: Any) -> str:
    return "–" if row.state == "not tested" else f"{rough(row.value)} {_UNITS[row.test]}"
