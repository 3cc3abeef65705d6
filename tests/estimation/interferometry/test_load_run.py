"""Zero, drift and response of a run are separated where possible, and reported as undetermined otherwise."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.interferometry.bench import LEVELS
from tests.tolerance import assert_between, assert_close
from truing.estimation.interferometry.load_run import PLAIN, branch_gap, branches, fit_run, run_columns, widest_gaps

SIGMA = 0.5e-6
TIME = 30.0 * np.arange(len(LEVELS))
ALL = (*PLAIN, "asymmetry", "cubic", "hysteresis")


def made(rng: np.random.Generator, terms: tuple, values: dict[str, float]) -> np.ndarray:
    columns = run_columns(LEVELS, TIME, terms)
    return columns @ [values.get(term, 0.0) for term in terms] + SIGMA * rng.standard_normal(len(LEVELS))


def test_branches_follow_the_load() -> None:
    load = [0, 0, 1, 2, 2, 1, 0, -1, -2, -1, 1, 0]
    assert list(branches(load)) == [0, 0, 1, 1, 1, -1, -1, 1, 1, -1, 1, -1]


def test_terms_are_recovered_within_their_covariance() -> None:
    rng = np.random.default_rng(1)
    values = {"zero": 2e-6, "drift": 3e-9, "response": 2e-10, "asymmetry": 1e-11, "cubic": 5e-12, "hysteresis": 4e-6}
    columns = run_columns(LEVELS, TIME, ALL)
    z, chi_square, dof = [], 0.0, 0
    for _ in range(200):
        fit = fit_run(made(rng, ALL, values), SIGMA, columns, ALL)
        assert fit.open == ()
        z.append((fit.values - list(values.values())) / np.sqrt(np.diag(fit.covariance)))
        chi_square, dof = chi_square + fit.chi_square, dof + fit.dof
    for k, total in enumerate((np.array(z) ** 2).sum(0)):
        assert_between(total, 200 - 4 * np.sqrt(400), 200 + 4 * np.sqrt(400), what=ALL[k])
    assert_between(chi_square, dof - 4 * np.sqrt(2 * dof), dof + 4 * np.sqrt(2 * dof))


def test_drift_is_no_part_of_the_response() -> None:
    """A drift as large as the noise over the run leaves the response unbiased where it is fitted, and not where not."""
    rng = np.random.default_rng(2)
    readings = [made(rng, PLAIN, {"drift": 1e-8, "response": 2e-10}) for _ in range(100)]
    with_drift = [fit_run(y, SIGMA, run_columns(LEVELS, TIME), PLAIN).value("response") for y in readings]
    terms = ("zero", "response")
    without = [fit_run(y, SIGMA, run_columns(LEVELS, TIME, terms), terms).value("response") for y in readings]
    pull = [np.mean([(v - 2e-10) / s for v, s in found]) for found in (with_drift, without)]
    assert abs(pull[0]) < 4 / np.sqrt(100)
    assert abs(pull[1]) > 4 / np.sqrt(100)


def test_a_run_that_only_goes_up_says_that_drift_is_open() -> None:
    up = np.arange(10.0) * 1e3
    fit = fit_run(2e-10 * up, SIGMA, run_columns(up, 60.0 * np.arange(10)), PLAIN)
    assert fit.open == ("drift", "response")
    assert np.isnan(fit.value("drift")[0])
    assert np.isinf(fit.value("response")[1])
    assert np.isnan(fit.p_value("drift"))
    assert np.isfinite(fit.value("zero")[0])


def test_temperatures_are_a_term_of_their_own_and_asked_for() -> None:
    rng = np.random.default_rng(3)
    material = 20.0 + 0.3 * np.sin(np.arange(len(LEVELS)))
    terms = (*PLAIN, "material")
    columns = run_columns(LEVELS, TIME, terms, material_c=material)
    y = columns @ [0.0, 0.0, 2e-10, 5e-6] + SIGMA * rng.standard_normal(len(LEVELS))
    value, sigma = fit_run(y, SIGMA, columns, terms).value("material")
    assert abs(value - 5e-6) < 4 * sigma
    with pytest.raises(ValueError, match="one per step"):
        run_columns(LEVELS, TIME, terms)


def test_missing_readings_cost_freedom_and_nothing_else() -> None:
    rng = np.random.default_rng(4)
    y = made(rng, PLAIN, {"response": 2e-10})
    y[3] = np.nan
    fit = fit_run(y, SIGMA, run_columns(LEVELS, TIME), PLAIN)
    assert fit.dof == len(LEVELS) - 4
    assert np.isnan(fit.residuals[3])


def test_the_gap_between_the_ways_is_the_hysteresis() -> None:
    rng = np.random.default_rng(5)
    terms = (*PLAIN, "hysteresis")
    gaps = [branch_gap(LEVELS, made(rng, terms, {"response": 2e-10, "hysteresis": 6e-6}), SIGMA) for _ in range(100)]
    part = np.abs(gaps[0].load) / 9e3
    assert set(np.abs(gaps[0].load)) == {1e3, 3e3, 5e3, 7e3}
    expected = 6e-6 * 4.0 * part * (1.0 - part)
    off = np.array([(g.gap - expected) / g.sigma for g in gaps])
    total = float((off**2).sum())
    assert_between(total, off.size - 4 * np.sqrt(2 * off.size), off.size + 4 * np.sqrt(2 * off.size))
    assert_close(gaps[0].sigma, np.full(8, SIGMA * np.sqrt(2.0)), atol=1e-12)


def test_gaps_are_reported_for_runs_that_load_one_axis_only() -> None:
    """Run 0 loads x and comes back 2 um off, run 1 loads x and y together: it tells of neither."""
    size, run = len(LEVELS), np.repeat([0, 1], len(LEVELS))
    load = np.zeros((2 * size, 6))
    load[:, 0] = np.tile(LEVELS, 2)
    load[size:, 1] = LEVELS
    reading = np.full((2 * size, 6), np.nan)
    reading[:, 3] = np.where(branches(LEVELS) < 0, 2e-6, 0.0)[np.tile(np.arange(size), 2)]
    reading[size:, 3] *= 50.0
    found = widest_gaps(load, run, reading, np.full(reading.shape, SIGMA))
    assert set(found) == {(0, 3)}
    gap, chance = found[0, 3]
    assert abs(abs(gap) - 2e-6) < 1e-12
    assert chance < 1e-3
