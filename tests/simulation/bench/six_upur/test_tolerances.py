"""Tolerances: samples against first order, random streams, and the interval of a sampled rms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.simulation.bench.six_upur.sensors import SEEDS, SETS, TOLERANCES_UM, crooked_joints, joints_of, vector
from tests.tolerance import assert_between, assert_close
from truing.simulation.bench.six_upur import tolerances
from truing.simulation.bench.six_upur.assembly import closed_loop_map, comprehensive, open_chain_map
from truing.simulation.bench.six_upur.tolerances import (
    box_muller,
    first_order_covariances,
    rms_band,
    rms_scatter,
    sampled_errors,
    sigma_of,
)

SIGMA = 1e-6 * sigma_of(TOLERANCES_UM)


def test_a_sample_is_that_of_the_reference() -> None:
    inputs, outputs = vector("eq17")
    sigma = sigma_of(inputs["T_um"])
    assert_close(sigma, outputs["sigma_um"], atol=1e-13, what="sigma")
    assert_close(box_muller(sigma, inputs["mu1"], inputs["mu2"]), outputs["dW_um"], atol=1e-13, what="sample")


def test_box_mullers_errors_are_normal() -> None:
    rng = np.random.default_rng(1)
    drawn = box_muller(2.0, 1.0 - rng.random(40_000), rng.random(40_000))
    beyond = np.count_nonzero(np.abs(drawn) > 6.0)
    expected = 40_000 * 0.0026998
    assert_between(beyond, expected - 5 * np.sqrt(expected), expected + 5 * np.sqrt(expected), what="beyond T / 2")
    assert_between(float(np.mean(drawn**2)), 4 - 20 * np.sqrt(2 / 40_000), 4 + 20 * np.sqrt(2 / 40_000), what="square")


@pytest.mark.parametrize("name", SETS)
def test_samples_scatter_as_the_first_order_says(name: str) -> None:
    """Whitened by the first order, squares of the errors are chi-square; the second order is 1e-4 of them."""
    joints, count = joints_of(name), 40_000
    C = first_order_covariances(closed_loop_map(joints), SIGMA).sum(0)
    drawn = sampled_errors(joints, SIGMA, count, np.random.default_rng(2))
    white = np.linalg.solve(np.linalg.cholesky(C), drawn.T)
    bound = 5 * np.sqrt(2 / count)
    for k in range(6):
        assert_between(float(np.mean(white[k] ** 2)), 1 - bound, 1 + bound, what=f"variance along direction {k}")
    crossed = white @ white.T / count - np.eye(6)
    assert np.abs(crossed[~np.eye(6, dtype=bool)]).max() < 5 / np.sqrt(count), "directions scatter apart"
    inside = np.count_nonzero(np.sum(white**2, 0) < 5.348121)  # the median of chi-square with 6 degrees of freedom
    assert_between(inside, count / 2 - 2.5 * np.sqrt(count), count / 2 + 2.5 * np.sqrt(count), what="below the median")


def test_each_source_scatters_as_the_first_order_says() -> None:
    joints, count = joints_of("S"), 4000
    covariances = first_order_covariances(closed_loop_map(joints), SIGMA)
    for k, C in enumerate(covariances):
        sigma = np.where(np.arange(5) == k, SIGMA, 0.0)
        position, attitude = comprehensive(sampled_errors(joints, sigma, count, np.random.default_rng(k)))
        for norms, block in ((position, C[:3, :3]), (attitude, C[3:, 3:])):
            found, scatter = np.sqrt(np.mean(norms**2) / np.trace(block)), rms_scatter(block, count)
            assert_between(float(found), 1 - 5 * scatter, 1 + 5 * scatter, what=f"source {k}")


def test_open_chains_scatter_by_sigma_over_root_six_whatever_the_geometry() -> None:
    C = first_order_covariances(open_chain_map(crooked_joints(np.random.default_rng(0))), SIGMA)
    rms = np.sqrt(np.trace(C[:, :3, :3], axis1=1, axis2=2))
    assert_close(rms, SIGMA / np.sqrt(6), atol=1e-18, what="rms by source")


@settings(max_examples=3)
@given(seed=SEEDS, workers=st.integers(2, 5))
def test_draws_are_identical_for_any_number_of_workers(seed: int, workers: int) -> None:
    count = 2 * tolerances._STREAM + tolerances._BLOCK + 1  # a last stream and a last block that are not full
    alone, together = (
        sampled_errors(joints_of("S"), SIGMA, count, np.random.default_rng(seed), workers=n) for n in (1, workers)
    )
    assert alone.tobytes() == together.tobytes()
    assert len(np.unique(alone[:, 0])) == count, "no two streams repeat each other"


def test_one_generator_never_gives_the_same_samples_twice() -> None:
    rng = np.random.default_rng(0)
    first, second = (sampled_errors(joints_of("S"), SIGMA, 10, rng) for _ in range(2))
    assert not np.any(first == second)


def test_bounded_errors_stay_within_their_zone() -> None:
    """One source alone, one leg at a time seen through its own lengthening: nothing beyond 3 sigma."""
    joints, count, only = joints_of("S"), 20_000, np.array([0.0, 0.0, 0.0, 0.0, SIGMA[4]])
    for bounded in (True, False):
        drawn = sampled_errors(joints, only, count, np.random.default_rng(3), bounded=bounded)
        lengthened = np.linalg.solve(closed_loop_map(joints)[..., 4], drawn.T) / SIGMA[4]
        beyond = np.count_nonzero(np.abs(lengthened) > 3.0 + 1e-3)  # 1e-3: what the first order leaves out
        assert (beyond == 0) == bounded
        variance = 0.973341 if bounded else 1.0
        bound = 5 * np.sqrt(2 / lengthened.size)
        assert_between(float(np.mean(lengthened**2)), variance - bound, variance + bound, what="variance")


@pytest.mark.parametrize("confidence", [0.9, 0.95])
def test_bands_contain_the_truth_at_their_stated_rate(confidence: float) -> None:
    """1000 experiments of 400 samples; the band is right to first order in 1 / sqrt(samples)."""
    rng = np.random.default_rng(4)
    root = np.diag([3.0, 1.0, 0.5])
    norms = np.linalg.norm(rng.normal(size=(1000, 400, 3)) @ root, axis=-1)
    band = rms_band(norms, confidence)
    truth = np.sqrt(np.trace(root**2))
    held = np.count_nonzero((band.low < truth) & (truth < band.high))
    spread = 3.5 * np.sqrt(1000 * confidence * (1 - confidence))
    assert_between(held, 1000 * confidence - spread - 10, 1000 * confidence + spread, what="bands that hold the truth")
    scatter = float(np.std(band.value / truth))
    assert_between(scatter / rms_scatter(root**2, 400), 0.9, 1.1, what="scatter of an rms")


def test_an_error_that_is_always_zero_is_known_to_be() -> None:
    band = rms_band(np.zeros(100))
    assert band.value == band.low == band.high == 0.0
