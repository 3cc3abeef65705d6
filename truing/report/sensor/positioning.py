"""The section of an axis' positioning by ISO 230-2."""

from __future__ import annotations

from typing import TYPE_CHECKING

from truing.report.numbers import with_uncertainty
from truing.report.page import Listing, Section
from truing.report.sensor.corrections import corrections
from truing.report.tables import Tables, filled

if TYPE_CHECKING:
    import pandas as pd

_MEANING = {
    "A": "accuracy, both directions",
    "E": "systematic deviation, both directions",
    "M": "mean deviation, both directions",
    "R": "repeatability, both directions",
    "B": "reversal",
}


def positioning(tables: Tables) -> Section | None:
    """What ISO 230-2 says of every run, the axis first, then target by target."""
    rows = filled(tables, "positioning")
    if rows is None:
        return None
    axis, targets = rows[rows["subject"].isna()], rows[rows["subject"].notna()]
    lead = "By ISO 230-2, targets approached from either side. What all targets' deviations share counts for nothing."
    listings = (_of_axis(axis), corrections(tables, of_axis=True), _of_targets(targets))
    shown = tuple(listing for listing in listings if listing.rows)
    return Section("positioning", "Positioning", lead, listings=shown)


def _of_axis(rows: pd.DataFrame) -> Listing:
    told = tuple(
        (
            str(r.run),
            r.figure,
            _MEANING.get(r.figure, r.figure.replace("_", ", ")),
            with_uncertainty(r.value, r.sigma) if r.sigma == r.sigma else f"{r.value:.3g}",
            f"{r.low:.3g} to {r.high:.3g}" if r.low == r.low else "",
        )
        for r in rows.itertuples()
    )
    return Listing(("run", "symbol", "what", "um", "95 %"), told, held_by="positioning.parquet")


def _of_targets(rows: pd.DataFrame) -> Listing:
    wide = rows.pivot(index=["run", "subject"], columns="figure", values="value")
    order = rows.drop_duplicates(["run", "subject"])[["run", "subject"]]
    heads = ("mean_forward", "mean_backward", "B", "s_forward", "s_backward", "R")
    told = tuple(
        (str(run), subject, *(f"{wide.loc[(run, subject), head]:.3g}" for head in heads))
        for run, subject in order.itertuples(index=False)
    )
    shown = ("run", "target", "mean forward, um", "mean backward", "B", "s forward", "s backward", "R")
    return Listing(shown, told, caption="Target by target", folded=len(told) > 12, held_by="positioning.parquet")
