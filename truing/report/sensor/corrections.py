"""What was corrected in readings, as a listing."""

from __future__ import annotations

from truing.report.numbers import quantity
from truing.report.page import Listing
from truing.report.tables import Tables, cell, filled

_WHAT = {"air": "refractive index of the air", "material": "temperature of the material"}


def corrections(tables: Tables, *, of_axis: bool = False) -> Listing:
    """Channel by channel, or of a positioned axis: how large each correction was, and how well it is known."""
    table = filled(tables, "reading_corrections")
    told = [] if table is None else [row for row in table.itertuples() if (row.subject == "axis") == of_axis]
    rows = tuple(
        (
            row.subject,
            _WHAT[row.correction],
            quantity(row.largest, row.unit) if cell(row.largest) else "corrected as it came",
            quantity(row.sigma, row.unit) if cell(row.sigma) else "not declared",
        )
        for row in told
    )
    heads = ("reading", "corrected for", "at most by", "known to (one sigma)")
    return Listing(heads, rows, caption="Corrections of readings", held_by="reading_corrections.parquet")
