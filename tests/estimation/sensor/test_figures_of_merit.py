"""Figures of merit: the paper's Tables 4 and 5, leg forces by eq. 33 and 34, and uncertainties."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.tolerance import assert_between, assert_close
from truing.estimation.sensor.calibrate import fit_calibration
from truing.estimation.sensor.calibration import (
    Figures,
    MatrixEstimate,
    angles_to_theory,
    calibration_matrix,
    condition_number,
    leg_force_matrix,
    newton_per_millivolt,
    relative_errors,
    sensitivities,
)
from truing.estimation.sensor.load_table import load_table

# Force-sensor paper, Table 4 and Table 5.
J = np.array([0.2964, 0.5472, 0.5473, 1.5025, 1.3973, 1.3974])
J_PRIME = np.array([1.0459, 0.8465, 0.9009, 6.8417, 3.7478, 6.0042])
J_B_PRIME = np.array([1.4205, 0.9930, 1.8518, 8.2074, 3.2378, 6.9202])
TYPE_1 = [26.37, 14.75, 51.35, 16.64, 15.75, 13.24]
TYPE_2 = [79.13, 44.89, 70.44, 81.69, 56.84, 79.81]
STEP = 1e-6
VECTORS = json.loads((Path(__file__).parent / "reference_vectors.json").read_text(encoding="utf-8"))


def test_both_types_of_error_are_those_printed():
    measured = Figures(J_B_PRIME, np.zeros(6))
    assert_close(100 * relative_errors(J_PRIME, measured).value, TYPE_1, atol=0.00501)
    # the third was cut off, not rounded: 70.445
    assert_close(100 * relative_errors(J, measured).value, TYPE_2, atol=0.0053)


def test_the_condition_numbers_differ_as_printed():
    measured = Figures(np.array([10.7808]), np.zeros(1))
    assert_close(
        100 * relative_errors(np.array([11.7549, 6.3336]), Figures(measured.value.repeat(2), np.zeros(2))).value,
        [9.0355, 41.2511],
        atol=5e-5,
    )


def test_a_cell_of_two_tonnes_gives_980_newtons_per_millivolt():
    assert newton_per_millivolt(2000.0, 2.0, 10.0, gravity=9.8) == pytest.approx(980.0, abs=1e-12)
    assert newton_per_millivolt(2000.0, 2.0, 10.0) == pytest.approx(980.665, abs=1e-9)


@pytest.mark.parametrize("name", ["A", "S", "N"])
def test_condition_and_sensitivities_are_those_of_the_reference(name):
    expected = VECTORS[f"fs.eq4.{name}"]["outputs"]
    exact = MatrixEstimate(np.array(expected["G"]), np.zeros((36, 36)))
    assert_close(condition_number(exact).value, [expected["cond"]], atol=1e-9)
    assert_close(sensitivities(exact).value, expected["sensitivities"], atol=1e-9)


def test_the_calibration_matrix_is_that_of_the_reference():
    given, expected = VECTORS["fs.eq34"]["inputs"], VECTORS["fs.eq34"]["outputs"]
    found = calibration_matrix(fit_calibration(load_table(np.array(given["V_mV"]).T, np.array(given["F_w"]).T)))
    assert_close(found.value, expected["G_B"], atol=1e-9 * np.abs(expected["G_B"]).max())
    legs = leg_force_matrix(found, given["N_per_mV"], given["k"])
    assert_close(legs.value, expected["G_B_prime"], atol=1e-9 * np.abs(expected["G_B_prime"]).max())


def _matrix(seed: int = 0) -> MatrixEstimate:
    rng = np.random.default_rng(seed)
    root = 1e-3 * rng.normal(size=(36, 36))
    return MatrixEstimate(rng.normal(size=(6, 6)), root @ root.T)


@pytest.mark.parametrize("figure", [condition_number, sensitivities])
def test_the_errors_of_figures_are_those_of_central_differences(figure):
    matrix = _matrix()
    steps = STEP * np.eye(36).reshape(36, 6, 6)

    def at(one):
        return figure(MatrixEstimate(matrix.value + one, matrix.covariance)).value

    by = np.stack([(at(step) - at(-step)) / (2 * STEP) for step in steps], axis=-1)
    expected = np.sqrt(np.diag(by @ matrix.covariance @ by.T))
    assert_close(figure(matrix).sigma / expected, np.ones(len(expected)), atol=1e-6)


def test_leg_forces_carry_the_tolerance_of_every_cell():
    matrix, rng = _matrix(1), np.random.default_rng(2)
    found = leg_force_matrix(matrix, 980.0, 250.0, relative_sigma=0.005)
    assert_close(found.value, matrix.value * 250 / 980, atol=1e-12)
    draws = 4000
    drawn = matrix.value.ravel() + rng.multivariate_normal(np.zeros(36), matrix.covariance, draws)
    cells = 1.0 + 0.005 * rng.normal(size=(draws, 1, 6))
    scattered = (drawn.reshape(draws, 6, 6) * cells * 250 / 980).std(axis=0)
    assert_between(float((scattered / found.sigma).min()), 0.93, 1.0, what="least scatter over its sigma")
    assert_between(float((scattered / found.sigma).max()), 1.0, 1.07, what="largest scatter over its sigma")


def test_sensitivities_do_not_depend_on_the_order_of_legs():
    matrix = _matrix(3)
    order = np.random.default_rng(0).permutation(6)
    blocks = matrix.covariance.reshape(6, 6, 6, 6)[:, order][:, :, :, order].reshape(36, 36)
    other = MatrixEstimate(matrix.value[:, order], blocks)
    for figure in (condition_number, sensitivities):
        assert_close(figure(other).value, figure(matrix).value, atol=1e-9)
        assert_close(figure(other).sigma, figure(matrix).sigma, atol=1e-9)


@pytest.mark.parametrize("channels", [6, 8])
def test_figures_of_a_matrix_change_as_their_derivatives_say(channels):
    rng = np.random.default_rng(channels)
    G, theory = rng.normal(size=(6, channels)), rng.normal(size=(channels, 6))
    for figure in (sensitivities, lambda matrix: angles_to_theory(theory, matrix)):
        sigma = np.zeros(6)
        for entry in range(G.size):
            nudge = 1e-6 * np.eye(G.size)[entry].reshape(G.shape)
            none = np.zeros((G.size, G.size))
            slope = (
                figure(MatrixEstimate(G + nudge, none)).value - figure(MatrixEstimate(G - nudge, none)).value
            ) / 2e-6
            sigma += slope**2
        found = figure(MatrixEstimate(G, np.eye(G.size))).sigma
        np.testing.assert_allclose(found, np.sqrt(sigma), rtol=1e-6)


def test_an_angle_sees_the_sign_of_a_cell_that_a_norm_does_not():
    rng = np.random.default_rng(3)
    G = rng.normal(size=(6, 6))
    turned, none = G * np.array([1, 1, -1, 1, 1, 1]), np.zeros((36, 36))
    np.testing.assert_allclose(
        sensitivities(MatrixEstimate(turned, none)).value, sensitivities(MatrixEstimate(G, none)).value
    )
    assert np.all(angles_to_theory(np.linalg.inv(G), MatrixEstimate(G, none)).value < 1e-6)
    assert angles_to_theory(np.linalg.inv(G), MatrixEstimate(turned, none)).value.max() > 0.1
