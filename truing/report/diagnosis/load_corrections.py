"""Unrecorded loads that acted because the line of action or the unit of a recorded load is wrong."""

from __future__ import annotations

import re

import pandas as pd

from truing.report.diagnosis.assessed_causes import FOUND, AssessedCause, accepted_of
from truing.report.numbers import capitalised, rough
from truing.report.page import ReportSection
from truing.report.tables import Tables, load_steps, table_or_none
from truing.report.wordings.bench_wordings import load_words
from truing.report.wordings.claim import determined_sizes

_TITLE = "Loads that acted but were not recorded"
_MM = 1e-3
# Share of a parameter that acts at the largest load, by form: half of a difference between the two signs.
_SHARE = {"": 1.0, "_asymmetry": 0.5, "_growth": 1.0}


def unrecorded_loads(rows: list[AssessedCause], tables: Tables) -> ReportSection | None:
    """Return the section on unrecorded moments or forces and their effect on a calibration; None where
    there are none."""
    acted = _corrected_loads(rows, tables)
    if not acted or table_or_none(tables, "sensor_matrix") is None:
        return None
    text = load_warning(rows, tables) or (
        f"{capitalised(acted)}. The calibration of the sensor includes this, as [diagnosis] apply asks. Using nominal "
        "loads biases the calibration matrix; residuals would not reveal it, because every run has the same bias."
    )
    return ReportSection("swallowed", _TITLE, text, see=(("calibration", "Calibration of the sensor"),))


def load_warning(rows: list[AssessedCause], tables: Tables) -> str:
    """Return the warning that unrecorded loads bias a calibration; empty where there are none."""
    acted = _corrected_loads(rows, tables)
    if not acted or table_or_none(tables, "sensor_matrix") is None or _used_corrected_loads(tables):
        return ""
    cure = "before it is used, centre the load, record all loads that act, or apply the finding ([diagnosis] apply)."
    if corrected_loads := _corrected_loads([row for row in rows if row.verdict == FOUND], tables):
        return f"G_B is fitted to the recorded loads, but {corrected_loads}. This biases G_B: {cure}"
    return f"G_B is fitted to the recorded loads. It is suspected that {acted}, which would bias G_B: {cure}"


def _corrected_loads(rows: list[AssessedCause], tables: Tables) -> str:
    if not (accepted_rows := accepted_of(rows)):
        return ""
    steps = load_steps(tables)
    return "; ".join(text for row in accepted_rows for text in _other_load_text(row, steps))


def _used_corrected_loads(tables: Tables) -> bool:
    """Return True if the calibration used the loads as corrected by the diagnosis."""
    choice = table_or_none(tables, "sensor_choice")
    return choice is not None and bool((choice["figure"] == "loads_as_diagnosed").any())


def _other_load_text(row: AssessedCause, steps: pd.DataFrame) -> list[str]:
    """Return the load in words, ``the z load also applied an unrecorded moment of up to 108 N·m about y and 72 N·m
    about x``; empty for other causes."""
    axis = re.fullmatch(r"load ([fm][xyz])", row.subject)
    if row.cause not in ("load-eccentricity", "load-imbalance") or axis is None:
        return []
    largest = float(steps[axis[1]].abs().max()) if len(steps) else 0.0
    size_of_component: dict[str, float] = {}
    for size in determined_sizes(row.sizes):
        name = re.fullmatch(r"(offset|moment|force)_([xyz])(_asymmetry|_growth)?", size.name)
        if name is None or size.number is None:
            continue
        if name[1] == "offset":
            component = ({"x", "y", "z"} - {axis[1][1], name[2]}).pop()
            share = _MM * abs(size.number)
        else:
            component, share = name[2], _SHARE[name[3] or ""] * abs(size.number)
        size_of_component[component] = size_of_component.get(component, 0.0) + share * largest
    kind, unit, preposition = ("moment", "N·m", "about") if axis[1][0] == "f" else ("force", "N", "along")
    parts = sorted(((size, c) for c, size in size_of_component.items() if size > 0.0), reverse=True)
    if not parts:
        return []
    words = " and ".join(f"{rough(size)} {unit} {preposition} {c}" for size, c in parts)
    return [f"{load_words(axis[1])} also applied an unrecorded {kind} of up to {words}"]
