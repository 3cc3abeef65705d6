"""The page that compares runs explains its tables."""

from __future__ import annotations

import pandas as pd
import pytest

from tests.report.bench_tables import bench_tables
from tests.report.calibration_tables import calibration_tables
from tests.report.campaign_tables import campaign_tables
from tests.report.diagnosis_tables import row, rows
from tests.report.explained import unexplained, unlinked
from tests.sentences import assert_says
from truing.report.comparison.compared_runs import ComparedRun, RunComparison, RunTransition
from truing.report.comparison.page import comparison_head, comparison_sections
from truing.report.glossary_section import with_reference
from truing.report.rendering.render import render_page
from truing.report.tables import Tables

_CLASS = {"error_class": "hysteresis", "load": "fz", "indicated": "fz", "value": 0.2, "sigma": 0.01, "unit": "percent"}
CAMPAIGNS = {
    "points": campaign_tables() | calibration_tables(),
    "bench": bench_tables() | {"error_classes": pd.DataFrame([_CLASS])},
}
EXPECTED = {
    "points": {"effects", "accuracy", "quality", "provenance"},
    "bench": {"effects", "errors", "quality", "provenance"},
}


def compared(tables: Tables) -> RunComparison:
    """Two runs of the same tables, of which no number was compared."""
    numbers = pd.DataFrame(columns=["place", "group", "z", "value", "sigma", "changed", "reason"])
    runs = tuple(ComparedRun(label, label, "1.0", tables) for label in ("spring", "autumn"))
    return RunComparison(runs, numbers, (RunTransition(("no model",), rebuilt=False),))


@pytest.mark.parametrize("kind", CAMPAIGNS)
def test_tables_side_by_side_have_a_sentence_and_a_working_anchor_for_every_head(kind: str) -> None:
    comparison = compared(CAMPAIGNS[kind])
    sections = with_reference(comparison_sections(comparison), bench=kind == "bench")
    assert {section.id for section in sections if section.listings} == {*EXPECTED[kind], "glossary"}
    page = render_page(comparison_head(comparison), sections)
    assert not unexplained(page)
    assert not unlinked(page, "check")
    assert not unlinked(page, "class")


def _with_numbers(*tables: Tables) -> RunComparison:
    """Runs of these tables, each with one number that did not change."""
    row = {"group": "leg", "effect_of": None, "leg": 1.0, "parameter": "l", "unit": "mm", "value": 1.0, "sigma": 0.1}
    rows = [{**row, "place": place + 1, "z": 0.1, "changed": False, "reason": None} for place in range(len(tables))]
    runs = tuple(ComparedRun(f"run {place}", f"run {place}", "1.0", table) for place, table in enumerate(tables))
    return RunComparison(runs, pd.DataFrame(rows), (RunTransition((), rebuilt=False),) * (len(tables) - 1))


def test_nothing_has_changed_only_where_the_same_effects_were_found() -> None:
    bare = {"diagnosis": rows(row("measurement-scale", verdict="rejected", subject=""))}
    scaled = {"diagnosis": rows(row("measurement-scale", verdict="found", subject=""))}
    first, second = comparison_head(_with_numbers(bare, scaled)).verdicts[:2]
    assert first == ("found", "run 0 → run 1: found for the first time: measurement scale.")
    assert second[0] == "pass"
    assert_says(second[1], "no change beyond chance", "1 number", "both")
    same = comparison_head(_with_numbers(scaled, scaled)).verdicts[0]
    assert same[0] == "pass"
    assert_says(same[1], "Nothing has changed beyond chance", "1 number")
