"""Heads of the page's tables: each with the one sentence that explains its column, or with that of the schema."""

from __future__ import annotations

from typing import Self

from truing.schemas.column import Column
from truing.schemas.columns import COLUMNS
from truing.schemas.glossary import glossary


class Head(str):
    """Text above a column, and the sentence that explains it: tooltip, and entry of the page's reference."""

    meaning: str

    def __new__(cls, text: str, meaning: str) -> Self:
        """Make a head; ``meaning``: one sentence with a full stop."""
        made = super().__new__(cls, text)
        made.meaning = meaning
        return made


def schema_head(text: str, name: str = "") -> Head:
    """Return a head with the description of a column of the schemas, by default of the same name."""
    return Head(text, _sentence(COLUMNS[name or text.replace(" ", "_")]))


def term_head(text: str, name: str = "") -> Head:
    """Return a head with the meaning of a term of the glossary, by default of the same name."""
    return Head(text, next(known.meaning for known in glossary() if known.term == (name or text)))


def leg_head(leg: int) -> Head:
    """Return the head of a column of one leg's values."""
    return Head(f"leg {leg}", "Value of the row's quantity for this leg; legs are counted from 1.")


def meaning_of(head: str) -> str:
    """Return the sentence of a head; empty for one without."""
    return getattr(head, "meaning", "")


def _sentence(described: Column) -> str:
    return f"{described.meaning[:1].upper()}{described.meaning[1:]}."


POSE, BODY, TARGET, UNIT, ROLE = map(schema_head, ("pose", "body", "target", "unit", "role"))
RUN = Head("run", "Number or name of the run: a series of load steps, or of approaches to the targets of an axis.")
CHANNEL = schema_head("channel")
CAUSE = Head("cause", "Candidate effect that the simulation lacks, with the leg, target or axis that it concerns.")
PARAMETER = Head("parameter", "Name of the parameter in the equations of the model.")
LEG = Head("leg", "Leg from base to platform, counted from 1.")
P = term_head("p", "p-value")
CORRECTED_P = "Probability of so large a value by chance, corrected for the number of tests of this table."
FREEDOM = Head("degrees of freedom", "Number of independent values behind the number of this row.")
MODEL_OF_LEGS = Head(
    "model", "Structure of the machine in the calibration: which parts are rigid and which are elastic."
)
DEFORMATION = schema_head("deformation")
FIGURE = Head("figure", "Name of the statistic in the column value.")
VALUE = schema_head("value")
LOAD = Head("load", "Component of the applied wrench: a force (fx, fy, fz) or a torque (mx, my, mz).")
FROM, TO = Head("from", "Smallest value."), Head("to", "Largest value.")
RMS_BEFORE = "Root mean square of measured minus predicted without the causes found; brackets hold its 95 % interval."
RMS_AFTER = "Root mean square of measured minus predicted with the causes found; brackets hold its 95 % interval."
