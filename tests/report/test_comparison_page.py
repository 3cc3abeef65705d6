"""The page that compares runs explains its tables."""

from __future__ import annotations

import pandas as pd
import pytest

from tests.report.bench_tables import bench_tables
from tests.report.calibration_tables import calibration_tables
from tests.report.campaign_tables import campaign_tables
from tests.report.explained import unexplained, unlinked
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
