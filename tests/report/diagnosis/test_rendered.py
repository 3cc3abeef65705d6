"""A browser draws the figures of the diagnosis, whatever causes, targets and purposes are called."""

from __future__ import annotations

import re

import pytest

from tests.report import diagnosis_tables as made
from tests.report.diagnosis_tables import diagnosis_tables, per_leg, rejected, row, rows, size
from tests.report.test_rendered import complaints, draw
from truing.report.diagnosis.section import diagnosis
from truing.report.head import build_head
from truing.report.rendering.render import render_page

ATTACK = "</script><img src=x onerror=document.title='broken'>"


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    gain = row("actuator-gain", parameters=per_leg("gain"), scale_holds="changes")
    moved = row("target-moved", subject=f"target {ATTACK}", parameters={"dx": size(0.03, 0.003, "mm")})
    matrix = row("platform-deformation-matrix", parameters=made.matrix())
    rival = row("platform-deformation-linear", "indistinguishable", subject="leg3")
    tables = diagnosis_tables(rows(matrix, gain, moved, rival, *rejected())) | {"changes": made.changes()}
    tables["next_poses"]["purpose"] = ATTACK
    tables["prediction"]["pose"] = [f"{ATTACK} {k}" for k in range(46)]
    return draw(render_page(build_head(ATTACK, tables), [diagnosis(tables)]), tmp_path_factory.mktemp("rendered"))


def test_every_figure_is_drawn(drawn):
    figures = re.findall(r'<div id="(figure-[a-z]+-\d+)"', drawn[0])
    assert figures == [
        "figure-evidence-0",
        *(f"figure-gain-{k}" for k in range(3)),
        *(f"figure-sizes-{k}" for k in range(2)),
        "figure-pulls-0",
        "figure-changes-0",
    ]
    for part in re.split(r'<div id="figure-', drawn[0])[1:]:
        assert 'class="main-svg"' in part, part[:40]


def test_the_browser_complains_of_nothing(drawn):
    assert not complaints(drawn[1])
    assert "<title>broken" not in drawn[0]


def test_every_candidate_has_its_bar(drawn):
    part = re.split(r'<div id="figure-', drawn[0])[1]
    assert part.count('class="point"') == 4 + len(rejected())


def test_every_pull_has_its_mark_before_and_after(drawn):
    part = next(part for part in re.split(r'<div id="figure-', drawn[0]) if part.startswith("pulls-0"))
    assert len(re.findall(r'<path class="point"', part)) == 2 * int(made.pulls()["identifiable"].sum())
