"""Quality statistics detect inserted faults, and keep their false-alarm rate."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from truing.estimation.quality import (
    body_shape,
    exchanged_pairs,
    find_drift,
    find_steps,
    isolated_values,
    repeated_groups,
    residual_scatter,
    running_median,
    successive_sigma,
)
from truing.estimation.rigid_poses.body_frames import redundancy, residual_covariance

SIGMA = 5e-6


def _residuals(seed: int, poses: int = 46, targets: int = 10):
    rng = np.random.default_rng(seed)
    return rng, SIGMA * rng.standard_normal((poses, targets, 3)), np.full((poses, targets, 3), SIGMA)


def test_scatter_counts_its_degrees_of_freedom():
    total = np.zeros(2)
    for seed in range(60):
        rng, values, sigma = _residuals(seed)
        covariates = rng.standard_normal((46, 7))
        points = 0.1 * rng.standard_normal((10, 3))
        kept = rng.random((46, 10)) > 0.05
        covariance = residual_covariance(points, np.tile(np.eye(3), (46, 10, 1, 1)), kept, kept)
        values = np.einsum("bij,bj->bi", covariance, values.reshape(46, -1)).reshape(values.shape)
        moving = values + 2e-5 + covariates[:, :1, None] * 1e-4
        scatter = residual_scatter(moving, sigma, redundancy(points, kept), covariates)
        total += scatter.chi_square.sum(), scatter.dof.sum()
    assert abs(total[0] - total[1]) < 4 * np.sqrt(2 * total[1])


def test_step_is_found_with_its_onset_and_size():
    _, values, sigma = _residuals(1)
    values[20:, 4] += [40e-6, -20e-6, 0.0]
    step = find_steps(values, sigma, np.ones((46, 10), bool))
    assert step.onset[4] == 20
    assert step.p_value[4] < 1e-12
    assert np.abs(step.size[4] - [40e-6, -20e-6, 0.0]).max() < 4 * step.sigma[4].max()
    assert (np.delete(step.p_value, 4) > 1e-5).all()


def test_steps_are_seen_in_noise_no_more_often_than_stated():
    hits = sum(
        (find_steps(values, sigma, np.ones((46, 10), bool)).p_value < 0.05).sum()
        for _, values, sigma in map(_residuals, range(40))
    )
    assert hits <= 400 * 0.05 + 4 * np.sqrt(400 * 0.05)


def test_a_drift_is_seen_by_chance_as_often_as_its_p_value_says_in_few_poses_too():
    rng, kept = np.random.default_rng(3), np.ones((10, 1), bool)
    p = np.array([find_drift(rng.normal(size=(10, 1, 3)), kept).p_value for _ in range(2000)])
    # Bonferroni over three axes; one standard deviation of 2000 draws is 0.8 %
    assert abs(np.mean(p < 0.15) - (1 - 0.95**3)) < 4 * 0.008


def test_drift_is_distinguished_from_scatter():
    _, values, _ = _residuals(2, poses=200, targets=3)
    kept = np.ones((200, 3), bool)
    assert find_drift(values, kept).p_value > 1e-3
    values[:, 1, 2] += np.linspace(0.0, 50e-6, 200)
    drift = find_drift(values, kept)
    assert drift.p_value < 1e-9
    assert drift.span.argmax() == 1
    assert abs(drift.span[1] - 50e-6) < 10e-6


def test_arbitrary_frames_are_no_drift():
    rng = np.random.default_rng(3)
    assert find_drift(rng.uniform(-1.0, 1.0, (60, 4, 3)), np.ones((60, 4), bool)).p_value > 1e-3


@pytest.mark.parametrize(("rows", "width"), [(40, 10), (41, 11), (30, 30), (31, 60), (60, 9), (300, 15)])
def test_running_median_is_the_median_of_every_complete_window(rows: int, width: int) -> None:
    """For values that repeat, too; a wide window is not sorted anew at each row."""
    series = np.random.default_rng(rows).integers(-5, 6, (rows, 2, 3)).astype(float)
    width = min(width, rows)
    expected = [np.median(series[row : row + width], axis=0) for row in range(rows - width + 1)]
    assert np.array_equal(running_median(series, width), expected)


def test_successive_differences_are_blind_to_steps():
    _, values, _ = _residuals(4, poses=400)
    values[200:, 0] += 1e-3
    scatter = successive_sigma(values, np.ones((400, 10), bool))
    assert (np.abs(scatter / SIGMA - 1.0) < 0.25).all()


def test_isolated_values_are_not_steps():
    _, values, sigma = _residuals(5)
    values[7, 2] += 1e-3
    values[20:, 3] += 1e-3
    far = isolated_values(values, sigma, np.ones((46, 10), bool))
    assert {(int(a), int(b)) for a, b in np.argwhere(far)} == {(7, 2)}


def test_exchanged_labels_are_named():
    rng = np.random.default_rng(6)
    places = rng.uniform(-0.1, 0.1, (1, 8, 3)).repeat(3, axis=0)
    measured = places + SIGMA * rng.standard_normal(places.shape)
    measured[1, [2, 5]] = measured[1, [5, 2]]
    gross = np.linalg.norm(measured - places, axis=2) > 1e-4
    assert exchanged_pairs(places, measured, gross, np.full((3, 8), 1e-4)) == [(1, 2, 5)]


def test_shape_of_a_line_a_plane_and_a_lone_target():
    line = np.column_stack([np.linspace(0, 1, 6), np.zeros(6), np.zeros(6)])
    assert body_shape(line).extents[1] < 1e-12
    rng = np.random.default_rng(7)
    flat = np.column_stack([rng.standard_normal((8, 2)), np.zeros(8)])
    assert body_shape(flat).extents[2] < 1e-12
    solid = rng.standard_normal((8, 3))
    assert abs(body_shape(solid).leverage.sum() - 6 / 3) < 1e-9


def test_repeats_are_grouped():
    settings = np.array([[0.0, 1.0], [5.0, 1.0], [0.001, 1.0], [5.0, 2.0]])
    assert [g.tolist() for g in repeated_groups(settings, np.array([0.01, 0.01]))] == [[0, 2]]


def test_unknown_settings_repeat_nothing():
    settings = np.array([[1.0], [np.nan], [2.0], [np.nan], [2.0]])
    groups = repeated_groups(settings, np.array([0.1]))
    assert [list(group) for group in groups] == [[2, 4]]


@given(
    arrays(
        float, st.tuples(st.integers(1, 40), st.integers(1, 3)), elements=st.sampled_from([0.0, 0.1, 0.2, 1.0, np.nan])
    ),
    st.lists(st.sampled_from([0.0, 0.1, 0.15]), min_size=3, max_size=3),
    st.integers(1, 5),
)
def test_groups_are_those_of_comparing_every_pair(settings: NDArray, tolerance: list[float], at_once: int) -> None:
    allowed = np.array(tolerance[: settings.shape[1]])
    first = []
    for b, one in enumerate(settings):
        alike = [c for c, other in enumerate(settings) if np.all(np.abs(one - other) <= allowed)]
        first.append(min([b, *alike]))
    expected = [[b for b, own in enumerate(first) if own == f] for f in sorted(set(first)) if first.count(f) > 1]
    with patch("truing.estimation.quality._POSES_AT_ONCE", at_once):
        assert [group.tolist() for group in repeated_groups(settings, allowed)] == expected
