"""The response model: recovery within its uncertainty, exact leave-one-out, scaling, robustness."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truing.estimation.response import (
    consistent_responses,
    entry_p_values,
    fit_response,
    gain_p_value,
    holm_significant,
    pair_couplings,
    ring_shape,
    significant_rank,
    symmetry,
)

SIGMA = 5e-6


def _campaign(seed: int, poses: int = 40, legs: int = 6, drives: int = 6):
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.3e-3, 0.0, 1.3e-3], size=(poses, drives))
    k = 0.02 * rng.standard_normal((legs, drives))
    root = np.eye(legs) + 0.2 * rng.standard_normal((legs, legs))
    cov = SIGMA**2 * root @ root.T
    survey = SIGMA**2 * np.eye(legs)
    noise = rng.multivariate_normal(np.zeros(legs), cov, poses)
    offset = rng.multivariate_normal(np.zeros(legs), survey)
    return u, k, u @ k.T + noise + offset, np.tile(cov, (poses, 1, 1)), survey


def test_matrix_is_recovered_within_its_covariance():
    z = []
    for seed in range(150):
        u, k, y, cov, survey = _campaign(seed)
        fit = fit_response(u, y, cov, offset_cov=survey)
        error = (fit.coefficients - k).ravel()
        z.append(error @ np.linalg.solve(fit.covariance, error))
    # sum of 150 chi-squares of 36 degrees of freedom: mean 5400, standard deviation 104
    assert abs(sum(z) - 150 * 36) < 4 * np.sqrt(2 * 150 * 36)


def test_residuals_agree_with_the_declared_noise():
    ratios = [(lambda f: (f.chi_square, f.dof))(fit_response(*_pick(_campaign(seed)))) for seed in range(50)]
    total, dof = np.sum(ratios, axis=0)
    assert abs(total - dof) < 4 * np.sqrt(2 * dof)


def _pick(campaign):
    u, _, y, cov, _ = campaign
    return u, y, cov


def test_leave_one_out_is_what_a_fit_without_the_row_predicts():
    u, _, y, cov, survey = _campaign(3)
    y[7, 2] = np.nan
    fit = fit_response(u, y, cov, offset_cov=survey)
    for row in (0, 7, 21):
        others = np.arange(len(u)) != row
        rest = fit_response(u[others], y[others], cov[others], offset_cov=survey)
        predicted = rest.offset[0] + rest.predict(u[row : row + 1])[0]
        is_observed = np.isfinite(y[row])
        np.testing.assert_allclose(
            fit.loo_residuals[row][is_observed], (y[row] - predicted)[is_observed], rtol=1e-6, atol=1e-13
        )


@given(st.floats(1e-6, 1e6), st.floats(1e-6, 1e6), st.integers(0, 1000))
def test_results_are_independent_of_the_units_of_drive_and_response(drive_unit, response_unit, seed):
    u, _, y, cov, survey = _campaign(seed, poses=15)
    plain = fit_response(u, y, cov, offset_cov=survey)
    scaled = fit_response(
        u * drive_unit, y * response_unit, cov * response_unit**2, offset_cov=survey * response_unit**2
    )
    factor = response_unit / drive_unit
    np.testing.assert_allclose(scaled.coefficients, plain.coefficients * factor, rtol=1e-6, atol=1e-9 * factor)
    np.testing.assert_allclose(scaled.sigma, plain.sigma * factor, rtol=1e-6)
    assert scaled.chi_square == pytest.approx(plain.chi_square, rel=1e-6)


@given(st.integers(0, 1000), st.permutations(range(6)))
def test_renumbering_the_legs_renumbers_the_matrix(seed, order):
    u, _, y, cov, survey = _campaign(seed, poses=15)
    plain = fit_response(u, y, cov, offset_cov=survey).coefficients
    p = np.array(order)
    turned = fit_response(u[:, p], y[:, p], cov[:, p][:, :, p], offset_cov=survey[np.ix_(p, p)]).coefficients
    np.testing.assert_allclose(turned, plain[np.ix_(p, p)], rtol=1e-6, atol=1e-12)


def test_linear_model_is_the_diagonal_and_equals_regression_for_equal_noise():
    u, _, y, _, _ = _campaign(5)
    cov = np.tile(SIGMA**2 * np.eye(6), (len(u), 1, 1))
    fit = fit_response(u, y, cov, form="linear")
    centred = u - u.mean(axis=0)
    slope = (centred * y).sum(axis=0) / (centred**2).sum(axis=0)
    np.testing.assert_allclose(np.diag(fit.coefficients), slope, rtol=1e-10)
    assert not fit.coefficients[~np.eye(6, dtype=bool)].any()


def test_gross_errors_are_found_and_nothing_else_loses():
    u, _, y, cov, survey = _campaign(11)
    wrong = [(3, 1), (10, 4), (11, 0), (11, 2), (30, 5)]
    for row, leg in wrong:
        y[row, leg] += 1e-3 * (-1) ** row
    kept = consistent_responses(u, y, cov, offset_cov=survey, false_rejections=0.01)
    assert {(int(a), int(b)) for a, b in np.argwhere(~kept)} == set(wrong)


@pytest.mark.slow
def test_poses_held_out_of_a_saturated_fit_are_assessed_by_what_it_knows():
    """With hardly more poses than drives K is known badly: what it misses elsewhere is no gross error."""
    rejected, found = 0, 0
    for seed in range(60):
        u, _, y, cov, survey = _campaign(seed, poses=12)
        fitted = np.arange(12) < 7
        rejected += int((~consistent_responses(u, y, cov, offset_cov=survey, fitted=fitted)).sum())
        y[10, 3] += 1e-2
        found += not consistent_responses(u, y, cov, offset_cov=survey, fitted=fitted)[10, 3]
    assert rejected <= 12  # 0.05 expected per table: Poisson of 3
    assert found >= 55


@pytest.mark.slow
def test_good_values_are_rejected_as_rarely_as_stated():
    rejected = sum(
        int((~consistent_responses(u, y, cov, offset_cov=s)).sum()) for u, _, y, cov, s in map(_campaign, range(60))
    )
    # 0.05 expected per table of 240 values, fewer since residuals are smaller than errors: 60 tables, Poisson of 3
    assert rejected <= 12


def test_matrix_earns_its_parameters_only_where_it_should():
    p = []
    for seed in range(80):
        u, k, y, cov, _ = _campaign(seed)
        y = y - u @ (k - np.diag(np.diag(k))).T
        p.append(gain_p_value(fit_response(u, y, cov, form="linear"), fit_response(u, y, cov)))
    share = np.mean(np.array(p) < 0.05)
    assert 0.0 <= share <= 0.05 + 4 * np.sqrt(0.05 * 0.95 / 80)
    assert 0.3 < np.mean(p) < 0.7
    u, _, y, cov, _ = _campaign(1)
    assert gain_p_value(fit_response(u, y, cov, form="linear"), fit_response(u, y, cov)) < 1e-10


def test_singular_covariance_leaves_out_what_it_cannot_see():
    u, k, y, _, _ = _campaign(2)
    plane = np.linalg.qr(np.random.default_rng(0).standard_normal((6, 3)))[0]
    projector = np.eye(6) - plane @ plane.T
    rng = np.random.default_rng(4)
    y = (u @ k.T + SIGMA * rng.standard_normal(y.shape)) @ projector
    fit = fit_response(u, y, np.tile(SIGMA**2 * projector, (len(u), 1, 1)))
    assert fit.deficient == 3 * 7
    np.testing.assert_allclose(plane.T @ fit.coefficients, 0.0, atol=1e-9)
    assert np.abs(fit.coefficients - projector @ k).max() < 5 * SIGMA / 1.3e-3 / np.sqrt(40) * 2


def test_offsets_belong_to_their_group():
    u, k, y, cov, _ = _campaign(6)
    group = np.repeat([0, 1], 20)
    y = y + np.array([[0.0], [1e-3]])[group]
    fit = fit_response(u, y, cov, group=group)
    np.testing.assert_allclose(fit.offset[1] - fit.offset[0], 1e-3, atol=8 * SIGMA)
    assert np.abs(fit.coefficients - k).max() < 6 * fit.sigma.max()


def test_shapes_that_disagree_are_refused():
    u, _, y, cov, _ = _campaign(0)
    with pytest.raises(ValueError, match=r"expected \(N, D\), \(N, L\)"):
        fit_response(u, y, cov[:, :3, :3])
    with pytest.raises(ValueError, match="expected as many drives as responses"):
        fit_response(u[:, :4], y, cov, form="linear")


def test_structure_of_a_symmetric_matrix_of_low_rank():
    rng = np.random.default_rng(8)
    u, _, y, cov, _ = _campaign(8)
    a = rng.standard_normal((6, 2))
    k = 0.01 * (a @ a.T)
    y = u @ k.T + rng.multivariate_normal(np.zeros(6), cov[0], len(u))
    fit = fit_response(u, y, cov)
    assert significant_rank(fit, 0.001) == 2
    even = symmetry(fit)
    assert even.p_value > 1e-3
    assert even.dof == 15
    assert len(pair_couplings(fit)) == 15


def test_significance_holds_its_family_wise_rate():
    false = 0
    for seed in range(150):
        u, k, y, cov, _ = _campaign(seed)
        fit = fit_response(u, y - u @ k.T, cov)
        false += holm_significant(entry_p_values(fit), 0.05).any()
    assert false <= 150 * 0.05 + 4 * np.sqrt(150 * 0.05 * 0.95)


def test_ring_shape_splits_what_it_is_given():
    angle = np.arange(6) * np.pi / 3
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(6)])
    lift = ring_shape(np.ones((4, 6)), ring)
    tilt = ring_shape(np.outer([1.0, -2.0], np.cos(angle)), ring)
    wheel = ring_shape(np.outer([1.0, 3.0], np.cos(2 * angle)), ring)
    assert (lift.lift, tilt.tilt, wheel.buckle) == (pytest.approx(1), pytest.approx(1), pytest.approx(1))
    assert wheel.amplitude == pytest.approx(3.0 * np.linalg.norm(np.cos(2 * angle)))


@pytest.mark.parametrize("form", ["linear", "matrix"])
def test_a_drive_that_never_moved_is_left_open_and_spoils_nothing(form):
    u, y, cov = _pick(_campaign(3))
    u[:, 2] = 0.0
    fit = fit_response(u, y, cov, form=form)
    assert fit.deficient == (1 if form == "linear" else 6)
    assert np.isfinite(fit.loo_residuals).all()
    assert np.isfinite(np.delete(entry_p_values(fit), 2, axis=1)[np.delete(fit.free, 2, axis=1)]).all()
    assert np.isnan(entry_p_values(fit)[2, 2])


@pytest.mark.parametrize("form", ["none", "linear", "matrix"])
def test_components_without_common_errors_are_fitted_as_if_together(form, monkeypatch):
    """Each component by itself, from the rows in which it was seen, is the joint fit; its covariance too."""
    rng = np.random.default_rng(4)
    u, group = rng.standard_normal((40, 3)), np.repeat(np.arange(4), 10)
    y = u @ rng.standard_normal((3, 3)).T + rng.standard_normal((4, 3))[group] + 0.1 * rng.standard_normal((40, 3))
    y[rng.random(y.shape) < 0.3] = np.nan
    y[group == 2, 0] = np.nan  # a run that did not see the first component
    cov = np.where(np.eye(3, dtype=bool), rng.uniform(0.005, 0.02, (40, 1, 3)), 0.0)
    for prior in (None, np.diag([0.5, 1.0, 2.0])):
        apart = fit_response(u, y, cov, form=form, group=group, offset_cov=prior)
        with monkeypatch.context() as patched:
            patched.setattr("truing.estimation.response._separate", lambda *_: False)
            together = fit_response(u, y, cov, form=form, group=group, offset_cov=prior)
        for name in ("coefficients", "covariance", "offset", "residuals", "loo_residuals", "free"):
            np.testing.assert_allclose(getattr(apart, name), getattr(together, name), rtol=1e-8, atol=1e-12)
        assert (apart.dof, apart.deficient) == (together.dof, together.deficient)
        assert apart.chi_square == pytest.approx(together.chi_square)
