"""A browser renders the figures of the calibrations for any names of models and parameters."""

from __future__ import annotations

import pytest

from tests.report.calibration_tables import calibration_tables
from tests.report.test_page import render

ATTACK = "</script><img src=x onerror=document.title='broken'>"


@pytest.fixture(scope="module")
def drawn(opened):
    tables = calibration_tables()
    for table in tables.values():
        for column in ("model", "parameter", "other_parameter", "effect"):
            if column in table:
                table[column] = table[column].replace({"beam": ATTACK, "l": ATTACK})
    page = opened(render(tables))
    page.scroll_through()
    return page


def test_every_figure_is_drawn(drawn):
    figures = drawn.value("[...document.querySelectorAll('.plot:has(.main-svg)')].map((plot) => plot.id)")
    assert set(figures) == {f"figure-{name}-{k}" for name in ("calibration", "knowledge") for k in range(3)} | {
        "figure-requirements-0"
    }


def test_the_browser_complains_of_nothing(drawn):
    assert not drawn.complaints()
    assert drawn.value("document.title") == "campaign – truing"


def test_every_bar_of_every_calibration_is_drawn(drawn):
    # Twelve calibrations: calibration and held-out poses, mean and maximum, of position and orientation.
    assert drawn.value("document.querySelectorAll('#figure-calibration-0 .point').length") == 12 * 2 * 2 * 2


def test_the_amplified_joints_are_drawn(drawn):
    # By either estimator lower and upper joint of six legs: nominal, and where three deformation models put them.
    assert drawn.value("document.querySelectorAll('#figure-calibration-1 path.point').length") == 2 * 2 * 6 * 4
