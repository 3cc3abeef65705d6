"""A browser renders the figures of the diagnosis for any names of causes, targets and purposes."""

from __future__ import annotations

import pytest

from tests.report import diagnosis_tables as made
from tests.report.diagnosis_tables import diagnosis_tables, per_leg, rejected, row, rows, size
from truing.report.diagnosis.section import diagnosis
from truing.report.page_head import build_head
from truing.report.rendering.render import render_page

ATTACK = "</script><img src=x onerror=document.title='broken'>"


@pytest.fixture(scope="module")
def drawn(opened):
    gain = row("actuator-gain", parameters=per_leg("gain"), scale_holds="changes")
    moved = row("target-moved", subject=f"target {ATTACK}", parameters={"dx": size(0.03, 0.003, "mm")})
    matrix = row("platform-deformation-matrix", parameters=made.matrix())
    rival = row("platform-deformation-linear", "indistinguishable", subject="leg3")
    tables = diagnosis_tables(rows(matrix, gain, moved, rival, *rejected())) | {"changes": made.changes()}
    tables["next_poses"]["purpose"] = ATTACK
    tables["prediction"]["pose"] = [f"{ATTACK} {k}" for k in range(46)]
    page = opened(render_page(build_head(ATTACK, tables), [diagnosis(tables)]))
    page.scroll_through()
    return page


def test_every_figure_is_drawn(drawn):
    figures = drawn.value("[...document.querySelectorAll('.plot:has(.main-svg)')].map((plot) => plot.id)")
    assert figures == [
        "figure-evidence-0",
        *(f"figure-gain-{k}" for k in range(3)),
        *(f"figure-sizes-{k}" for k in range(2)),
        "figure-pulls-0",
        "figure-changes-0",
    ]


def test_the_browser_complains_of_nothing(drawn):
    assert not drawn.complaints()
    assert drawn.value("document.title") == f"{ATTACK} – truing"


def test_every_candidate_has_its_bar(drawn):
    assert drawn.value("document.querySelectorAll('#figure-evidence-0 .point').length") == 4 + len(rejected())


def test_every_pull_has_its_mark_before_and_after(drawn):
    marks = drawn.value("document.querySelectorAll('#figure-pulls-0 path.point').length")
    assert marks == 2 * int(made.pulls()["identifiable"].sum())
