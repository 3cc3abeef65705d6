"""Absorption of an effect outside the model: the telescope's deformation, and laws of the projection."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.estimation.telescope_rows import DRHO_MM, LEGS, REFERENCE, poses
from tests.simulation.mechanisms.telescope import K, telescope
from tests.tolerance import assert_between, assert_close
from truing.estimation.design.absorption import absorb, absorb_in_full
from truing.estimation.least_squares.solver import SolverStatus

SEEDS = st.integers(0, 2**32 - 1)
EPS = np.finfo(float).eps
LABELS = list("abcdef")


class Leg:
    """Residual and Jacobian, in mm, of one leg's calibration on data of the telescope that deforms by K.

    Parameters: a_x, a_y, b_x, b_y, then u_x or kappa, then l; changes from nominal.
    """

    def __init__(self, leg: int, fifth: str, size: float = 1.0) -> None:
        legs = telescope()
        self.a, self.b, self.drho, self.fifth = 1e3 * legs.a[leg], 1e3 * legs.b[leg], DRHO_MM[:, leg], fifth
        self.p, self.R = poses(size)
        self.shift = size * DRHO_MM @ K[leg]

    def gap(self, x: NDArray, shift: NDArray | float = 0.0) -> NDArray:
        u_x, kappa = (x[4], 0.0) if self.fifth == "ux" else (0.0, x[4])
        u = np.array([u_x, 0.0, np.sqrt(1 - u_x**2)])
        a, b = self.a + np.append(x[:2], 0.0), self.b + np.append(x[2:4], 0.0)
        lift = (kappa * self.drho + shift)[:, None] * self.R[:, :, 2]
        return self.p + self.R @ b + lift - a - (self.drho + 10.0)[:, None] * u

    def residual(self, x: NDArray, shift: NDArray | float = 0.0) -> NDArray:
        return 500.0 + x[5] - np.linalg.norm(self.gap(x, shift), axis=1)

    def jacobian(self, x: NDArray) -> NDArray:
        g = self.gap(x)
        z = g / np.linalg.norm(g, axis=1, keepdims=True)
        by_b, u_x = -np.einsum("bji,bj->bi", self.R, z), x[4]
        by_u = (self.drho + 10.0) * (z[:, 0] - u_x / np.sqrt(1 - u_x**2) * z[:, 2]) if self.fifth == "ux" else None
        by_kappa = -np.einsum("bi,bi->b", z, self.R[:, :, 2]) * self.drho
        fifth = by_kappa if by_u is None else by_u
        return np.column_stack([z[:, :2], by_b[:, :2], fifth, np.ones(len(z))])

    def fit(self) -> NDArray:
        x = np.zeros(6)
        for _ in range(8):  # Gauss-Newton, whose rate here is below 1e-2
            x = x - np.linalg.lstsq(self.jacobian(x), self.residual(x))[0]
        return x


@pytest.mark.parametrize("leg", LEGS)
@pytest.mark.parametrize(("name", "fifth"), [("none", "ux"), ("linear", "kappa")])
def test_the_linear_prediction_is_the_fits_answer_but_for_terms_of_second_order(name, fifth, leg):
    """With x the fit's answer, J(x)'f(x) = 0 makes the difference -J0+ r - (J0'J0)^-1 (J(x) - J0)'f(x) exactly.

    r = f(x) - f(0) - J0 x is the remainder of Taylor's expansion.
    """
    expected, model = REFERENCE["absorption"][name], Leg(leg, fifth)
    reference, fitted = np.array(expected["parameters"])[:, leg], model.fit()
    J0, f0, f = model.jacobian(np.zeros(6)), model.residual(np.zeros(6)), model.residual(fitted)
    found = absorb(J0, f0, LABELS)
    second_order = absorb(J0, f - f0 - J0 @ fitted, LABELS).shift[:, 0]
    second_order -= found.covariance @ (model.jacobian(fitted) - J0).T @ f
    rounding = EPS * 500.0 * np.linalg.cond(J0) * np.sqrt(40 * np.diag(found.covariance))
    assert np.all(np.abs(fitted - found.shift[:, 0] - second_order) < 10 * rounding)
    # the reference stopped where the sum of squares fell by less than 1e-8 of itself, so to 1e-4 of sigma it is the fit
    squares = np.sum(model.residual(reference) ** 2)
    assert_between(squares / np.sum(f**2) - 1.0, 0.0, 1e-7, what="sum of squares")
    assert_close(np.sqrt(squares / 40), expected["rms_mm"][leg], atol=1e-9)
    assert_close((fitted - reference) / np.sqrt(squares * np.diag(found.covariance)), np.zeros(6), atol=np.sqrt(1e-7))


@pytest.mark.parametrize("leg", LEGS)
@pytest.mark.parametrize("fifth", ["ux", "kappa"])
def test_fit_and_prediction_part_by_the_square_of_the_effect(fifth, leg):
    apart = []
    for size in (1 / 256, 1 / 512):
        model = Leg(leg, fifth, size)
        found = absorb(model.jacobian(np.zeros(6)), model.residual(np.zeros(6)), LABELS)
        apart.append(np.linalg.norm(model.fit() - found.shift[:, 0]))
    # 4 but for the third order: next to the second it has the size of u_x over the slope of the leg, 0.15 / 256 / 0.04
    assert_between(apart[0] / apart[1], 4 * 0.95, 4 * 1.05, what="ratio")


@pytest.mark.parametrize("leg", LEGS)
def test_the_deformation_is_the_signature_of_the_residual(leg):
    """At the true geometry the residual is what the neglected shift of the attachment makes of it, to first order."""
    model = Leg(leg, "ux")
    nominal = np.zeros(6)
    assert_close(model.residual(nominal, model.shift), np.zeros(40), atol=1e-11)
    z = model.gap(nominal) / np.linalg.norm(model.gap(nominal), axis=1, keepdims=True)
    signature = np.einsum("bi,bi->b", z, model.R[:, :, 2]) * model.shift
    assert_close(model.residual(nominal), signature, atol=np.max(model.shift**2) / (2 * 500.0))


def test_u_x_absorbs_kappa_by_the_slope_of_the_leg():
    """Equation 40: what is seen of (1 - kappa) z_z is seen of u_x z_x, and a_x follows by -rho0 u_x."""
    for leg in LEGS:
        model = Leg(leg, "kappa")
        by_kappa = model.jacobian(np.zeros(6))[:, 4]
        model = Leg(leg, "ux")
        J0 = model.jacobian(np.zeros(6))
        found = absorb(J0[:, [0, 4]], by_kappa, ["ax", "ux"])
        z = model.gap(np.zeros(6)) / np.linalg.norm(model.gap(np.zeros(6)), axis=1, keepdims=True)
        slope = z[:, 0] / np.einsum("bi,bi->b", z, model.R[:, :, 2])
        a_x, u_x = found.shift[:, 0]
        if np.ptp(slope) < 0.2 * abs(slope.mean()):  # the legs that lean along x
            assert_between(u_x * slope.mean(), 1 - 0.2, 1 + 0.2, what="u_x slope")
            assert_between(-a_x / u_x, 10.0 * (1 - 0.2), 10.0 * (1 + 0.2), what="rho0")
            assert found.absorbed[0] > 0.95


@pytest.mark.parametrize("leg", LEGS)
@pytest.mark.parametrize("fifth", ["ux", "kappa"])
def test_in_full_the_prediction_is_the_fit(fifth, leg):
    model = Leg(leg, fifth)
    start = model.residual(np.zeros(6))
    found = absorb_in_full(lambda x: (model.residual(x) - start, model.jacobian(x)), start, None, 6)
    assert found.status == SolverStatus.CONVERGED
    fitted = model.fit()
    sigma = np.sqrt(np.diag(np.linalg.inv(model.jacobian(fitted).T @ model.jacobian(fitted)))) * np.linalg.norm(start)
    assert_close((found.shift - fitted) / sigma, np.zeros(6), atol=1e-6)
    assert_close(found.left, model.residual(fitted), atol=1e-6 * np.linalg.norm(start))


def test_in_full_a_linear_model_with_a_prior_gives_the_linear_answer():
    _, N, s, scales, labels = draw(3)
    found = absorb_in_full(lambda x: (N @ x, N), s[:, 0], scales, 6)
    assert_close(found.shift, absorb(N, s[:, 0], labels, scales).shift[:, 0], atol=1e-9)


def draw(seed):
    rng = np.random.default_rng(seed)
    return rng, rng.normal(size=(25, 6)), rng.normal(size=(25, 2)), rng.uniform(0.1, 5.0, 6), list("abcdef")


@given(SEEDS)
def test_an_effect_in_the_space_of_the_columns_leaves_nothing(seed):
    rng, N, _, _, labels = draw(seed)
    mix = rng.normal(size=(6, 2))
    found = absorb(N, N @ mix, labels)
    rounding = 100 * EPS * np.linalg.cond(N) * np.linalg.norm(N @ mix)
    assert_close(found.shift, -mix, atol=rounding * np.linalg.cond(N))
    assert_close(found.left, np.zeros((25, 2)), atol=rounding)
    assert_close(found.absorbed, np.ones(2), atol=1e-12)
    assert_close(found.visible, np.zeros(2), atol=rounding)


@given(SEEDS)
def test_an_effect_across_the_columns_is_left_whole(seed):
    _, N, s, scales, labels = draw(seed)
    across = s - N @ np.linalg.lstsq(N, s)[0]
    for found in (absorb(N, across, labels), absorb(N, across, labels, scales)):
        assert_close(found.shift, np.zeros((6, 2)), atol=1e-13 * np.linalg.cond(N) ** 2 * np.linalg.norm(s))
        assert_close(found.left, across, atol=1e-13 * np.linalg.cond(N) ** 2 * np.linalg.norm(s))
        assert_close(found.absorbed, np.zeros(2), atol=1e-12 * np.linalg.cond(N) ** 2)


@given(SEEDS)
def test_the_shift_is_the_formulas_and_shares_add_up(seed):
    _, N, s, scales, labels = draw(seed)
    with_prior, without = absorb(N, s, labels, scales), absorb(N, s, labels)
    relative = 100 * EPS * np.linalg.cond(N) ** 2
    normal = N.T @ N + np.diag(scales**-2)
    assert_close(with_prior.shift, -np.linalg.solve(normal, N.T @ s), atol=relative * np.linalg.norm(s))
    assert_close(with_prior.covariance @ normal, np.eye(6), atol=relative)
    assert_close(without.swallowed.sum(axis=0), without.absorbed, atol=relative)
    for found, penalty in ((without, 0.0), (with_prior, np.sum((with_prior.shift / scales[:, None]) ** 2, axis=0))):
        assert np.all((found.absorbed >= -1e-12) & (found.absorbed <= 1 + 1e-12))
        assert_close(found.visible**2, np.sum(found.left**2, axis=0) + penalty, atol=1e-12 * np.sum(s**2))
    assert np.all(with_prior.absorbed <= without.absorbed + 1e-12)  # a prior holds parameters back


@given(SEEDS)
def test_results_are_independent_of_units_rows_and_size(seed):
    rng, N, s, scales, labels = draw(seed)
    unit, size = 10.0 ** rng.integers(-3, 4, 6), rng.uniform(0.1, 10.0)
    turn = np.linalg.qr(rng.normal(size=(25, 25)))[0]
    first, second = absorb(N, s, labels, scales), absorb(turn @ N / unit, size * (turn @ s), labels, scales * unit)
    rounding = 1e3 * EPS * np.linalg.cond(N) * np.linalg.norm(first.shift)
    assert_close(second.shift / unit[:, None] / size, first.shift, atol=rounding)
    assert_close(second.swallowed, first.swallowed, atol=1e-11)
    assert_close(second.absorbed, first.absorbed, atol=1e-11)
    assert_close(turn.T @ second.left / size, first.left, atol=1e-11)


@pytest.mark.parametrize("against", ["fit", "truth", "nominal"])
def test_observed_minus_predicted_scatters_as_stated(against):
    """Simulated linear calibrations: truth drawn from the prior, noise of one, an effect of uncertain size."""
    rng, N, s, scales, labels = draw(7)
    found, runs = absorb(N, s, labels, scales), 20000
    effect_covariance = np.array([[2.0, 0.5], [0.5, 1.0]])
    assumed = np.array([3.0, -1.0])
    size = assumed[:, None] + np.linalg.cholesky(effect_covariance) @ rng.normal(size=(2, runs))
    truth = scales[:, None] * rng.normal(size=(6, runs))
    # residual as a function of the change from nominal: N (x - truth) + effect + noise
    noise = rng.normal(size=(25, runs))
    fit = -found.covariance @ N.T @ (s @ size + noise - N @ truth)
    with_effect = -found.covariance @ N.T @ (noise - N @ truth)
    observed = {"fit": fit - with_effect, "truth": fit - truth, "nominal": fit}[against]
    difference = observed - found.shift @ assumed[:, None]
    reported = found.comparison_covariance(effect_covariance, against)
    for ratio in difference.std(axis=1) / np.sqrt(np.diag(reported)):
        assert_between(ratio, 1 - 4 / np.sqrt(2 * runs), 1 + 4 / np.sqrt(2 * runs), what=against)
    whitened = np.linalg.lstsq(reported, np.cov(difference), rcond=1e-9)[0]
    assert_close(np.trace(whitened), np.linalg.matrix_rank(reported, rtol=1e-9), atol=4 * 6 * np.sqrt(2 / runs))


def test_columns_that_do_nothing_take_nothing():
    N = np.column_stack([np.arange(5.0), np.zeros(5), np.ones(5), np.ones(5)])
    found = absorb(N, np.ones(5), ["slope", "nothing", "one", "same"])
    assert_close(found.shift[:, 0], [0.0, 0.0, -0.5, -0.5], atol=1e-14)
    assert absorb(N, np.zeros(5), list("abcd")).absorbed == [0.0]


def test_wrong_shapes_and_a_missing_prior_are_refused():
    with pytest.raises(ValueError, match="labels"):
        absorb(np.eye(3), np.ones(3), ["x"])
    with pytest.raises(ValueError, match="scales"):
        absorb(np.eye(3), np.ones(3), list("xyz"), [1.0])
    with pytest.raises(ValueError, match="prior"):
        absorb(np.eye(3), np.ones(3), list("xyz")).comparison_covariance(against="nominal")
