"""docs/telescope-report.md: its numbers are computed by the code, and its statements hold."""

from __future__ import annotations

import re

import numpy as np
import pytest

from docs.experiments import telescope_report, telescope_report_figures
from docs.experiments.telescope_report_absorption import leg_fits, shift_by_K, simulated
from docs.experiments.telescope_report_data import published
from docs.experiments.telescope_report_geometry import (
    best_shape,
    fit_shape,
    held_out,
    observed,
    rival_patterns,
)
from docs.experiments.telescope_report_machine import MODEL, stand, with_deformation
from docs.experiments.telescope_report_models import accuracy
from docs.experiments.telescope_report_remainder import CAUSES, TOGETHER, Ignorance, explain, pattern, remainder
from docs.experiments.telescope_report_side import choice, starts
from docs.experiments.telescope_report_tables import reference_reading
from tests.docs.shown import shown
from tests.simulation.mechanisms.telescope import K as REFERENCE_K
from tests.tolerance import assert_close
from truing.estimation.design.absorption import absorb
from truing.simulation.mechanisms.parameters import report_set

# Made again in seconds; the others repeat fits many times and are sampled below.
SLOW = ("rivals", "choice", "starts")
PAGE = telescope_report.PAGE.read_text(encoding="utf-8")


@pytest.mark.parametrize("name", [name for name in telescope_report.TABLES if name not in SLOW])
def test_the_page_shows_what_the_command_writes(name):
    old_ones, made = (_numbers(text) for text in (shown(PAGE, name), telescope_report.TABLES[name]()))
    assert len(old_ones) == len(made)
    for (old, digit), (new, _) in zip(old_ones, made, strict=True):
        assert new == pytest.approx(old, rel=0.01, abs=1.01 * digit)


def _numbers(text: str) -> list[tuple[float, float]]:
    """Numbers of a table, each with what its last digit is worth."""
    words = list(re.finditer(r"(?<![\w.])[-+−]?\d+(?:\.(\d+))?(e[-+]\d+)?", text))
    assert words
    return [
        (float(w.group().replace("−", "-")), float(f"1e-{len(w[1] or '')}") * float(f"1{w[2] or ''}")) for w in words
    ]


def test_all_marks_of_the_page_have_a_table():
    assert sorted(re.findall(r"<!-- table (\S+) -->", PAGE)) == sorted(telescope_report.TABLES)


def test_the_print_is_that_of_the_reference():
    assert_close(published().K, REFERENCE_K, atol=0.0, what="K")
    assert set(published().tables) == {f"{number}{letter}" for number in "567" for letter in "abcd"}
    levels = published().calibration / 1.3e-3
    assert_close(levels, np.rint(levels), atol=1e-15, what="levels of Table 3")
    assert levels.shape == (40, 6)


@pytest.mark.parametrize("table", ["5a", "6a"])
def test_leg_by_leg_is_the_absorption_of_all_legs_at_once(table):
    machine = best_shape().machine
    at, own = stand(machine), np.diag(np.diag(published().K)) if table == "6a" else np.zeros((6, 6))
    nominal = with_deformation(machine, own)
    parameters = report_set(nominal, "linear" if table == "6a" else "none")
    closing = MODEL.close(nominal, at.p, at.R, at.rho, parameters.change(nominal))
    jacobian = closing.by_parameter.reshape(240, -1) * parameters.units
    expected = absorb(jacobian, closing.value.ravel(), parameters.labels).shift[:, 0] * parameters.units
    shift = leg_fits(machine, table).shift.ravel()
    # the condition of a leg's Jacobian, 1e4, times rounding of leg lengths
    assert_close(shift, expected, atol=1e-4 * 1e-6, what="shift")


def test_the_derivative_by_K_is_that_of_the_shift():
    machine, step = best_shape().machine, 1e-5
    moved = [np.array(published().K) for _ in range(2)]
    for sign, matrix in zip((1, -1), moved, strict=True):
        matrix[2, 4] += sign * step
    # the poses keep the printed K, whose change moves them by less than the differences' own error
    at, nominal = stand(machine), with_deformation(machine, np.diag(np.diag(published().K)))
    values = [MODEL.close(with_deformation(nominal, m - np.diag(np.diag(m)) + nominal.deformation), at.p, at.R, at.rho,
                          report_set(nominal, "linear").change(nominal)).value[:, 2] for m in moved]  # fmt: skip
    slope = -np.linalg.pinv(leg_fits(machine, "6a").jacobian[2]) @ (values[1] - values[0]) / (2 * step)
    assert_close(shift_by_K(machine, "6a")[2, :, 4], slope, atol=1e-4 * np.abs(slope).max(), what="slope")


def test_the_shape_is_found_and_no_neighbour_of_it_fits():
    fit = best_shape()
    assert fit.correlation > 0.99
    assert np.all(fit.sigma[:2] < 0.01)
    nearest = sorted(rival_patterns(), key=lambda p: abs(p.towards + np.pi / 2) + (not p.platform) + (p.turning < 0))
    for rival in nearest[:2]:
        assert fit_shape(rival, max_iterations=20).rms > 3 * fit.rms


def test_every_leg_is_predicted_by_the_other_five():
    off = held_out() - observed()
    assert np.all(np.linalg.norm(off, axis=0) < 0.4 * np.linalg.norm(observed(), axis=0))


def test_a_table_made_from_a_known_shape_gives_it_back(monkeypatch):
    truth = best_shape()
    monkeypatch.setattr("docs.experiments.telescope_report_geometry.observed", lambda: observed() + truth.residual)
    assert_close(fit_shape().numbers, truth.numbers, atol=1e-6, what="shape")


def test_the_reference_reading_is_that_of_the_machine():
    value, sigma = reference_reading()
    assert abs(value - 10.0) < 3 * sigma


@pytest.mark.parametrize(("table", "least"), [("5a", 0.98), ("6a", 0.97)])
def test_K_alone_explains_what_was_identified(table, least):
    found, seen = simulated(best_shape().machine, table).rows, published().moved(table)
    for row in set(seen) - {"kappa"}:
        assert np.corrcoef(found[row], seen[row])[0, 1] > least, row


@pytest.mark.parametrize("name", list(CAUSES))
def test_a_cause_that_is_there_is_found(name):
    size = 3.0
    found = explain([name], Ignorance(0.5), of=size * pattern(name))
    assert_close(found.sizes[-1], size, atol=1e-6 * size, what=name)
    assert found.chi_square < 1e-6


def test_frames_alone_do_not_explain_what_is_left_and_five_numbers_do():
    by = Ignorance(0.5)
    before, after = explain((), by), explain(TOGETHER, by)
    assert before.p < 1e-10
    assert after.p > 0.05
    assert np.all(remainder()[4] > 0)
    assert after.sizes[-5] > 3 * after.sigma[-5]


def test_the_linear_models_look_as_good_only_while_K_is_ignored():
    ignored = [accuracy(table)[0].position.mean() for table in ("5a", "5b")]
    known = [accuracy(table)[0].position.mean() for table in ("7a", "7b")]
    assert ignored[1] < 1.3 * ignored[0]
    assert known[1] > 10e-6 > 100 * known[0]


def test_all_of_K_is_worth_more_in_orientation_than_in_position():
    linear, matrix = (choice("a", deformation) for deformation in ("linear", "matrix"))
    assert matrix.orientation_mean < 0.6 * linear.orientation_mean
    assert linear.position_mean - matrix.position_mean < 2 * linear.spread


def test_both_methods_find_the_same_single_minimum():
    found = starts("6a", 0.01, count=8)
    assert all(minima.is_unique for minima in found.minima.values())
    assert found.between < 1e-6


def test_figures_are_complete_svg_files(tmp_path):
    telescope_report_figures.draw_absorption(tmp_path / "absorption.svg")
    telescope_report_figures.draw_geometry(tmp_path / "geometry.svg")
    telescope_report_figures.draw_remainder(tmp_path / "remainder.svg", Ignorance(0.5))
    for path in tmp_path.iterdir():
        text = path.read_text(encoding="utf-8")
        assert "nan" not in text
        assert text.count("<g") == text.count("</g>")
