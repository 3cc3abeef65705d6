"""The statements of docs/poses.md on figure 5 agree with the experiment, and the page is current."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from docs.experiments import figure5
from tests.docs.shown import shown

PAGE = Path(figure5.__file__).resolve().parents[1] / "poses.md"


@pytest.mark.parametrize("count", [6, 20])
def test_the_bound_is_that_of_the_closed_formulas(count):
    limit = figure5.bound(count)
    assert limit.position == pytest.approx(figure5.SIGMA * np.sqrt(3 / count), rel=1e-9)
    assert limit.roll == pytest.approx(figure5.SIGMA / (figure5.RADIUS * np.sqrt(count)), rel=0.03)
    spread = figure5.LENGTH**2 / 12 + figure5.RADIUS**2 / 2
    assert limit.tilt == pytest.approx(figure5.SIGMA * np.sqrt(2 / count / spread), rel=0.03)


@pytest.mark.parametrize("noise", list(figure5.NOISES))
def test_line_and_points_tie_in_position_and_axis_and_only_points_have_a_roll(noise):
    found, limit, factor = figure5.simulate(10, noise), figure5.bound(10), figure5.NOISES[noise][1]
    for method in ("line", "least squares", "default"):
        assert found[method].position / limit.position / factor == pytest.approx(1.0, abs=4 / np.sqrt(6000))
        assert found[method].tilt / limit.tilt / factor == pytest.approx(1.0, abs=4 / np.sqrt(4000))
    assert np.isnan(found["line"].roll)
    assert found["default"].roll / limit.roll / factor == pytest.approx(1.0, abs=4 / np.sqrt(2000))


def test_a_gross_error_costs_the_line_and_not_the_robust_methods():
    found, limit = figure5.simulate(10, "Gaussian", 2e-4), figure5.bound(10)
    assert found["line"].position > 5 * limit.position
    for method in ("Haralick", "default"):
        assert found[method].position < 1.15 * limit.position


def test_the_page_shows_what_the_command_writes():
    page = PAGE.read_text(encoding="utf-8")
    for old, new in zip(_numbers(shown(page, "gaussian")), _numbers(figure5.TABLES["gaussian"]()), strict=True):
        assert old == pytest.approx(new, rel=0.01)


def _numbers(text):
    words = text.replace(",", " ").replace("|", " ").split()
    return [float(word) for word in words if word.replace(".", "", 1).isdigit()]
