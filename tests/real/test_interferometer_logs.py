"""A laboratory's quadrature signals and an axis' positioning test give the known results."""

from __future__ import annotations

import numpy as np
import pytest

from tests.real.interferometer_logs import (
    LINES,
    published_radius,
    quadrature,
    quadrature_facts,
    slit_facts,
    slit_report,
    strange_axis,
    surroundings_facts,
)
from tests.tolerance import assert_between, assert_close


@pytest.fixture(scope="module")
def axes(real_data):
    return quadrature_facts(quadrature(real_data))


def test_signals_are_whole_steps_of_a_converter(real_data):
    assert_close(quadrature(real_data)[..., 0].shape, (3, 16511), atol=0.0)
    assert np.abs(quadrature(real_data)).max() == 512.0


def test_the_radius_is_as_round_as_the_laboratory_says(axes, real_data):
    assert_close(axes.raw, [3.39, 12.25, 6.80], atol=0.005)
    assert_close(axes.raw, published_radius(real_data, "raw"), atol=0.002)
    published = published_radius(real_data, "Heydemann")
    assert_close(published, [2.02, 12.00, 2.67], atol=0.01)
    # at least as round as published, and hardly rounder: an ellipse has no more to give
    assert (axes.corrected <= published + 0.006).all()
    assert (axes.corrected > 0.99 * published).all()


def test_the_axis_that_stays_bad_is_flagged_and_its_converter_named(axes):
    assert list(axes.flagged) == [False, True, False]
    assert list(axes.clipped_share == 0.0) == [True, False, True]
    assert_between(axes.clipped_share[1], 0.41, 0.43)
    # without the samples that were cut off the bad axis is as good as the others
    assert axes.unclipped[1] < 0.005 * axes.mean_radius[1]
    assert axes.fit.ok.all()
    assert axes.kept_fit.values[1, 2:4].min() > 512.0  # its ellipse is larger than the converter's range


def test_all_axes_keep_one_wave_of_the_fourth_order(axes):
    assert_between(axes.fourth_wave.min(), 0.004, 0.0075)
    assert_between(axes.fourth_wave.max(), 0.004, 0.0075)


def test_the_air_of_the_scan_stood_nearly_still(real_data):
    found = surroundings_facts(real_data)
    assert_between(found["index"], 1.000264, 1.000265)
    assert_close([found["pressure_pa"], found["temperature_k"]], [13.0, 0.0033], atol=1e-3)
    # by its pressure alone, 2.7e-9 per Pa: the temperatures hardly moved
    assert_between(found["span"] / (2.67e-9 * found["pressure_pa"]), 0.8, 1.0)


def test_every_line_of_the_report_is_right_but_one(real_data):
    found = slit_facts(real_data)
    assert set(found["report"]) == set(LINES)
    assert found["wrong"] == ["E"]
    assert_close(found["ours"]["E"], 0.01294, atol=0.5e-5)
    assert found["report"]["E"] == 0.00845
    assert_close(found["as_printed"], 0.00845, atol=0.6e-5)
    assert_close(found["standard_r"], found["report"]["R"], atol=0.6e-5)
    assert found["report"]["E"] < found["report"]["E_bwd"]  # which no E of both directions can be


def test_every_position_of_the_report_is_ours(real_data):
    own = slit_facts(real_data)["own"]
    tables = slit_report(real_data)["tables"]
    both = next(rows for head, rows in tables.items() if head.startswith("i |x_avg(i)"))
    assert_close(own.mean.mean(1), both[:, 0], atol=0.6e-5)
    assert_close(own.reversal_at, both[:, 1], atol=0.6e-5)
    scatter = next(rows for head, rows in tables.items() if head.startswith("i |S_fwd"))
    ours = np.column_stack([own.scatter, own.repeatability_at, own.bidirectional_at])
    assert_close(ours, scatter, atol=0.6e-5)
    forward, backward = (tables[name] for name in tables if name.startswith("i |x(i,1)"))
    assert_close(own.mean, np.column_stack([forward[:, 5], backward[:, 5]]), atol=0.6e-5)


def test_five_cycles_leave_a_fifth_of_the_accuracy_open(real_data):
    found = slit_facts(real_data)["uncertainty"]
    for symbol, low, high in (("B", 0.2, 0.6), ("E", 0.05, 0.25), ("M", 0.05, 0.25), ("R", 0.15, 0.4), ("A", 0.1, 0.3)):
        one = found[symbol]
        assert_between(one.sigma / one.value, low, high, what=symbol)
        assert one.low < one.high


def test_the_unusual_axis_mostly_has_a_shifted_zero(real_data):
    found = strange_axis(real_data)
    assert_close(found["largest"], 0.2338, atol=1e-9)
    assert_close(found["offset"], -0.1925, atol=1e-3)
    assert_between(found["systematic"], 0.07, 0.075)
    assert_between(found["moved_least"], -0.17, -0.15)
    assert_between(found["moved_most"], -0.17, -0.16)
