"""Choice of configurations: exchanges against brute force, the bound against all designs, ascents against a grid."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.tolerance import assert_close
from truing.estimation.design.feasible_region import FeasibleRegion
from truing.estimation.design.pose_selection import (
    SelectionStatus,
    bound_design,
    efficiency,
    exchange,
    information_of,
    ioops,
    largest_sensitivity,
    one_by_one,
    optimise_directly,
    rounded_design,
    sum_log_det,
)

seeds = st.integers(0, 2**32 - 1)


def candidates(rng, count=12, legs=2, size=3):
    """Rows of candidates, some of a leg's parameters far weaker than others."""
    return rng.normal(size=(count, legs, size)) * [1.0, 1e-2, 1e2]


@given(seeds)
def test_a_finished_exchange_cannot_be_improved_by_any_single_exchange(seed):
    rng = np.random.default_rng(seed)
    rows = candidates(rng)
    found = exchange(rows, rng.permutation(12)[:5])
    assert found.status is SelectionStatus.CONVERGED
    assert found.log_det == pytest.approx(sum_log_det(information_of(rows[found.chosen])), abs=1e-9)
    for out in range(5):
        for into in range(12):
            other = found.chosen.copy()
            other[out] = into
            assert sum_log_det(information_of(rows[other])) <= found.log_det + 1e-8


@given(seeds)
def test_every_choice_of_few_lies_below_the_bound(seed):
    rng = np.random.default_rng(seed)
    rows = candidates(rng, count=6)[..., :2]
    best = max(sum_log_det(information_of(rows[list(c)])) for c in combinations_with_replacement(range(6), 4))
    bound = bound_design(rows, 4)
    assert bound.converged
    assert best <= bound.upper + 1e-9
    assert exchange(rows, rounded_design(bound, 4)).log_det <= best + 1e-9


@given(seeds, st.booleans())
def test_the_bound_is_reached_by_its_own_weights_and_holds_for_all_others(seed, known):
    rng = np.random.default_rng(seed)
    rows = candidates(rng, 30)
    before = information_of(candidates(rng, 4)) if known else np.zeros((2, 3, 3))
    bound = bound_design(rows, 7, before)
    assert bound.upper - bound.log_det <= 1e-6
    assert bound.weights.sum() == pytest.approx(1.0)
    assert bound.weights.min() >= 0.0
    for weights in rng.dirichlet(np.full(30, 0.3), 50):
        other = before + 7 * np.einsum("c,clq,clr->lqr", weights, rows, rows)
        assert sum_log_det(other) <= bound.upper + 1e-9


@given(seeds, st.floats(-3, 3))
def test_neither_choice_nor_efficiency_depends_on_units(seed, power):
    rng = np.random.default_rng(seed)
    rows, start = candidates(rng), rng.permutation(12)[:5]
    scaled = rows * 10.0**power * [1.0, 3.0, 0.2]
    shares = []
    for same in (rows, scaled):
        found = exchange(same, start)
        shares.append((found.log_det, bound_design(same, 5).upper))
    assert efficiency(*shares[0], 6) == pytest.approx(efficiency(*shares[1], 6), rel=1e-5)


def test_the_best_design_of_a_line_is_its_ends():
    x = np.linspace(-1, 1, 41)
    rows = np.stack([np.ones_like(x), x], -1)[:, None]
    bound = bound_design(rows, 10)
    assert_close(bound.weights[[0, -1]], [0.5, 0.5], atol=1e-4)
    assert bound.upper == pytest.approx(2 * np.log(10), abs=1e-6)
    assert sorted(rounded_design(bound, 10)) == [0] * 5 + [40] * 5


@pytest.mark.slow
@pytest.mark.parametrize("degree", [2, 3, 4, 5])
def test_polynomials_are_measured_at_the_extrema_of_legendre(degree):
    x = np.linspace(-1, 1, 2001)
    rows = (x[:, None] ** np.arange(degree + 1))[:, None]
    weights = bound_design(rows, 1).weights
    inner = np.polynomial.legendre.Legendre.basis(degree).deriv().roots()
    for place in (-1.0, *inner, 1.0):
        near = np.abs(x - place) < 5e-3
        assert weights[near].sum() == pytest.approx(1 / (degree + 1), abs=2e-3)


def test_pose_selection_accounts_for_earlier_poses():
    x = np.linspace(-1, 1, 5)
    rows = np.stack([np.ones_like(x), x], -1)[:, None]
    before = information_of(rows[[4] * 10])
    assert exchange(rows, np.array([2, 2, 2]), before).chosen.tolist() == [0, 0, 0]
    assert ioops(rows, np.array([2, 2, 2]), before).chosen.tolist() == [0, 0, 0]
    assert np.argmax(bound_design(rows, 3, before).weights) == 0


@given(seeds)
def test_one_by_one_improves_on_its_start_and_stays_below_the_bound(seed):
    rng = np.random.default_rng(seed)
    rows = candidates(rng, 30)
    start = rng.choice(len(rows), 8, replace=False)
    found = ioops(rows, start)
    assert sum_log_det(information_of(rows[start])) <= found.log_det <= bound_design(rows, 8).upper
    assert len(found.chosen) == 8


@given(seeds)
def test_as_few_as_there_are_parameters_are_enough_to_begin_with(seed):
    rows = candidates(np.random.default_rng(seed), 30)
    start = one_by_one(rows, 3, bound_design(rows, 3))
    assert np.isfinite(sum_log_det(information_of(rows[start])))
    assert exchange(rows, start).log_det >= sum_log_det(information_of(rows[start]))


def test_a_choice_that_leaves_parameters_undetermined_is_refused():
    rows = candidates(np.random.default_rng(0))
    for search in (exchange, ioops):
        with pytest.raises(ValueError, match="a choice of 2 configurations that determines every parameter"):
            search(rows, np.array([0, 1]))
    with pytest.raises(ValueError, match="candidates that determine every parameter"):
        bound_design(rows[:2], 5)


def test_a_search_cut_short_says_so():
    rows = candidates(np.random.default_rng(1), 200)
    for search in (exchange, ioops):
        cut = search(rows, np.arange(8), max_iterations=1)
        assert cut.status is SelectionStatus.ITERATION_LIMIT
        assert cut.log_det < search(rows, np.arange(8)).log_det


def square(lower=None, upper=None):
    """The square of half range 1."""
    none = np.empty((0, 2))

    def quantities(x):
        return x, np.broadcast_to(np.eye(2), (len(x), 2, 2))

    return FeasibleRegion(2, quantities, np.ones(2), none if lower is None else lower, none if upper is None else upper)


def quadratic(x):
    """Rows 1, x, y, x^2, y^2, x y of one leg, and their derivatives."""
    u, v = x.T
    one, zero = np.ones_like(u), np.zeros_like(u)
    rows = np.stack([one, u, v, u * u, v * v, u * v], -1)[:, None]
    by_u = np.stack([zero, one, zero, 2 * u, zero, v], -1)
    by_v = np.stack([zero, zero, one, zero, 2 * v, u], -1)
    return rows, np.stack([by_u, by_v], -1)[:, None]


def test_a_direct_search_ends_where_no_small_move_helps():
    rng = np.random.default_rng(2)
    region = square()
    found = optimise_directly(region, quadratic, region.draw(9, rng))
    assert found.status is SelectionStatus.CONVERGED
    assert region.excess(found.x).max() <= 1 + 1e-9
    for _ in range(200):
        moved = np.clip(found.x + 1e-3 * rng.normal(size=found.x.shape), -1, 1)
        assert sum_log_det(information_of(quadratic(moved)[0])) <= found.value + 1e-6


def test_climbs_find_what_a_coarse_set_of_candidates_leaves_out():
    x = np.stack(np.meshgrid([-1.0, -0.37, 0.41, 1.0], [-1.0, -0.37, 0.41, 1.0]), -1).reshape(-1, 2)
    coarse = bound_design(quadratic(x)[0], 9)
    fine = np.stack(np.meshgrid(np.linspace(-1, 1, 81), np.linspace(-1, 1, 81)), -1).reshape(-1, 2)
    truth = bound_design(quadratic(fine)[0], 9)
    assert coarse.upper < truth.log_det
    climbed = largest_sensitivity(square(), quadratic, coarse, x)
    assert coarse.with_sensitivity(climbed.value) >= truth.log_det


def test_a_direct_search_keeps_out_of_forbidden_boxes():
    region = square(np.array([[0.2, -np.inf]]), np.array([[0.7, 0.6]]))
    start = region.draw(12, np.random.default_rng(3))
    found = optimise_directly(region, quadratic, start)
    assert region.allowed(found.x).all()
    assert found.value > sum_log_det(information_of(quadratic(start)[0]))
