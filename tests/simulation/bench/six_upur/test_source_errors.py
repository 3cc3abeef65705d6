"""Errors of a sensor's platform by each tolerance: laws, and drawn sensors."""

from __future__ import annotations

import numpy as np
import pytest

from docs.experiments.force_sensor_sets import SETS
from truing.simulation.bench.six_upur.assembly import SOURCES
from truing.simulation.bench.six_upur.geometry import JointCentres
from truing.simulation.bench.six_upur.source_errors import ALL, SAMPLES, SourceErrors, source_errors
from truing.simulation.bench.six_upur.tolerances import sampled_errors

SIGMA = np.array([155.0, 130.0, 36.0, 36.0, 87.0]) / 6.0 * 1e-6


def errors_of_sources(sigma: np.ndarray = SIGMA, seed: int = 0) -> SourceErrors:
    return source_errors(SETS["A"].joints(), sigma, np.random.default_rng(seed))


def test_the_first_order_is_the_rms_of_drawn_sensors() -> None:
    errors = sampled_errors(SETS["A"].joints(), SIGMA, 40_000, np.random.default_rng(5))
    rms = np.sqrt(np.sum(errors.reshape(-1, 2, 3) ** 2, -1).mean(0))
    # the rms of 40,000 sensors scatters by 0.3 %
    np.testing.assert_allclose(errors_of_sources().first_order[-1], rms, rtol=0.012)
    below = np.linalg.norm(errors.reshape(-1, 2, 3), axis=-1) <= errors_of_sources().covered[-1]
    assert ((below.mean(0) > 0.94) & (below.mean(0) < 0.96)).all()


def test_shares_add_up_to_all() -> None:
    one = errors_of_sources()
    assert one.sources == (*SOURCES, ALL)
    np.testing.assert_allclose(one.shares[:-1].sum(0), 1.0, rtol=1e-12)
    np.testing.assert_allclose(one.shares[-1], 1.0)


@pytest.mark.slow
def test_the_band_of_a_hundred_samples_covers_the_first_order_19_times_of_20() -> None:
    covered = [
        (one.band.low <= one.first_order) & (one.first_order <= one.band.high) for one in map(_seeded, range(12))
    ]
    share = np.mean(covered)
    # 144 intervals of nearly 95 %, half of them in pairs: a standard deviation of 2.2 %
    assert 0.88 < share < 0.995
    assert errors_of_sources().samples.shape == (6, 2, SAMPLES)


def _seeded(seed: int) -> SourceErrors:
    return errors_of_sources(seed=seed)


def test_lengths_turn_nothing_in_open_chains_but_do_in_closed_loops() -> None:
    one = errors_of_sources()
    np.testing.assert_allclose(one.open_chains[:, 1], 0.0, atol=1e-15)
    assert (one.first_order[:, 1] > 1e-6).all()
    np.testing.assert_allclose(one.open_chains[:-1, 0], SIGMA / np.sqrt(6.0), rtol=1e-9)


def test_a_wider_tolerance_takes_a_larger_share() -> None:
    wider = errors_of_sources(SIGMA * [1.0, 1.0, 1.0, 2.0, 1.0])
    assert (wider.shares[3] > errors_of_sources().shares[3]).all()
    np.testing.assert_allclose(wider.first_order[3], 2.0 * errors_of_sources().first_order[3], rtol=1e-12)


def test_a_source_without_tolerance_is_left_out() -> None:
    assert errors_of_sources(SIGMA * [1.0, 0.0, 1.0, 0.0, 1.0]).sources == (*SOURCES[::2], ALL)


def test_sensors_without_tolerances_or_with_singular_legs_are_refused() -> None:
    with pytest.raises(ValueError, match="a tolerance above 0"):
        errors_of_sources(np.zeros(5))
    with pytest.raises(ValueError, match="legs close"):
        errors_of_sources(SIGMA * 1e6)
    joints = SETS["A"].joints()
    upright = JointCentres(joints.lower, joints.lower, joints.origin)  # parallel legs
    with pytest.raises(ValueError, match="six legs that hold the platform"):
        source_errors(upright, SIGMA, np.random.default_rng(0))
