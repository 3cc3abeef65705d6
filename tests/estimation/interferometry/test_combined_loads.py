"""Residuals of a sum of responses to single axes: noise follows no products of loads, a nonlinear response does."""

from __future__ import annotations

import numpy as np
import pytest

from truing.arrays import Array, Index
from truing.estimation.interferometry.combined_loads import p_of_products, share_of_products

RUNS, STEPS = 6, 16


def steps(rng: np.random.Generator) -> tuple[Array, Index, Array]:
    """Loads (N, 6), runs (N,), and columns that are fitted: loads, their sizes and cubes, and a zero of each run."""
    load = rng.uniform(-1.0, 1.0, (RUNS * STEPS, 6))
    load[::STEPS] = 0.0
    run = np.repeat(np.arange(RUNS), STEPS)
    return load, run, np.column_stack([load, np.abs(load), load**3, run[:, None] == np.arange(RUNS)])


def p_value(response: Array, load: Array, run: Index, removed: Array) -> float:
    residual = response - removed @ np.linalg.lstsq(removed, response, rcond=None)[0]
    share = share_of_products(residual, removed, load, run)
    return p_of_products([] if share is None else [share])


@pytest.mark.slow
def test_noise_has_uniform_p_values() -> None:
    p = []
    for seed in range(120):
        rng = np.random.default_rng(seed)
        load, run, removed = steps(rng)
        p.append(p_value(rng.normal(size=len(load)), load, run, removed))
    assert 1 <= np.sum(np.array(p) < 0.05) <= 14  # 6 expected; 99.8 % of binomial draws
    assert 0.38 < np.mean(p) < 0.62


def test_a_product_of_two_loads_is_no_noise_whatever_its_size() -> None:
    for seed, size in enumerate((6.0, 30.0, 1e3)):
        rng = np.random.default_rng(seed)
        load, run, removed = steps(rng)
        response = size * load[:, 0] * load[:, 2] + rng.normal(size=len(load))
        assert p_value(response, load, run, removed) < 0.01


def test_too_few_rows_give_no_answer() -> None:
    rng = np.random.default_rng(1)
    load, run, removed = (part[:20] for part in steps(rng))
    assert share_of_products(rng.normal(size=20), removed, load, run) is None
