"""A browser draws the figures of the calibrations, whatever the models and parameters are called."""

from __future__ import annotations

import re

import pytest

from tests.report.calibration_tables import calibration_tables
from tests.report.test_page import render
from tests.report.test_rendered import complaints, draw

ATTACK = "</script><img src=x onerror=document.title='broken'>"


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    tables = calibration_tables()
    for table in tables.values():
        for column in ("model", "parameter", "other_parameter", "effect"):
            if column in table:
                table[column] = table[column].replace({"beam": ATTACK, "l": ATTACK})
    return draw(render(tables), tmp_path_factory.mktemp("rendered"))


def test_every_figure_is_drawn(drawn):
    figures = set(re.findall(r'<div id="(figure-[a-z]+-\d+)"', drawn[0]))
    assert figures == {f"figure-{name}-{k}" for name in ("calibration", "knowledge") for k in range(3)} | {
        "figure-requirements-0"
    }
    for part in re.split(r'<div id="figure-', drawn[0])[1:]:
        assert 'class="main-svg"' in part, part[:40]


def test_the_browser_complains_of_nothing(drawn):
    assert not complaints(drawn[1])
    assert "<title>broken" not in drawn[0]


def test_every_bar_of_every_calibration_is_drawn(drawn):
    part = re.split(r'<div id="figure-', drawn[0])[1]
    # Twelve calibrations: calibration and held-out poses, mean and maximum, of position and orientation.
    assert part.count('class="point"') == 12 * 2 * 2 * 2


def test_the_amplified_joints_are_drawn(drawn):
    part = next(part for part in re.split(r'<div id="figure-', drawn[0]) if part.startswith("calibration-1"))
    # By either estimator lower and upper joint of six legs: nominal, and where three deformation models put them.
    assert len(re.findall(r'<path class="point"', part)) == 2 * 2 * 6 * 4
