"""Corrections to the nominal geometry of a chain, in a sentence for the first screen."""

from __future__ import annotations

import math

import pandas as pd

from truing.belonging.relation import RelationState
from truing.report.numbers import listed, printed, with_uncertainty
from truing.report.page import Verdict
from truing.report.section_verdict import SectionVerdict
from truing.report.tables import Tables, table_or_none
from truing.schemas.verdict import ReasonCode

_CLEAR = 5.0  # standard deviations: of a hundred numbers, chance passes it once in 17,000 campaigns
_NAMED = 3
_DEGREES = {"rad": (180.0 / math.pi, "deg")}


def estimates_zeros(tables: Tables) -> bool:
    """True if the zero of some joint was identified with the geometry, so that it is no effect to be tested."""
    numbers = table_or_none(tables, "chain_parameters")
    return numbers is not None and bool((numbers["identifiable"] & (numbers["parameter"] == "offset")).any())


def corrections(tables: Tables, adequacy: SectionVerdict | None) -> list[Verdict]:
    """Return the sentence on the numbers that differ clearly from nominal; empty if the model does not fit."""
    numbers = table_or_none(tables, "chain_parameters")
    if numbers is None or adequacy is None:
        return []
    if adequacy.state != RelationState.OK and adequacy.reason_code != ReasonCode.BELOW_NOISE:
        return []
    numbers = numbers.assign(size=(numbers["identified"] / numbers["sigma"]).abs())
    clear = numbers[numbers["identifiable"] & (numbers["size"] > _CLEAR)].sort_values("size", ascending=False)
    if clear.empty:
        return []
    named = listed([_number(row) for _, row in clear.iterrows()], _NAMED)
    return [("found", printed(f"Corrections to the nominal geometry: {named}. Section Chain lists all numbers."))]


def _number(row: pd.Series) -> str:
    factor, unit = _DEGREES.get(row["unit"], (1.0, row["unit"]))
    name = "zero" if row["parameter"] == "offset" else row["parameter"]
    return f"{name} of {row['joint']} {with_uncertainty(factor * row['identified'], factor * row['sigma'])} {unit}"
