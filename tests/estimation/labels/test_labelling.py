"""Labels by geometry: invariance under motion and permutation, missing and foreign points, ambiguous bodies."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.tolerance import assert_between, assert_close
from truing.estimation.labels.labelling import (
    ACCIDENTS_LIMIT,
    MARGIN_LOG_ODDS,
    LabellingStatus,
    label_bodies,
    label_points,
)
from truing.estimation.rotation import exp_so3, log_so3

SIGMA = 5e-6
PLATFORM_RING = np.radians([-96.0, -84.0, 24.0, 36.0, 144.0, 156.0])
seeds = st.integers(0, 2**32 - 1)


def ring(angles, radius=0.135):
    return radius * np.c_[np.cos(angles), np.sin(angles), np.zeros(len(angles))]


def moved(rng, survey, sigma=SIGMA):
    R, t = exp_so3(rng.normal(size=3)), rng.normal(size=3)
    return survey @ R.T + t + rng.normal(scale=sigma, size=survey.shape), R, t


def scattered(rng, n, flat=1.0, size=0.3):
    return rng.uniform(-size, size, (n, 3)) * [1, 1, flat]


@given(seeds, st.integers(6, 60), st.floats(0.0, 0.5), st.floats(0.0, 1.0), st.sampled_from([0.0, 0.05, 1.0]))
def test_labels_survive_motion_permutation_missing_and_extra_points(seed, n, missing, extra, flat):
    rng = np.random.default_rng(seed)
    survey = scattered(rng, n, flat)
    kept = rng.permutation(n)[: max(5, n - int(missing * n))]
    cloud, R, t = moved(rng, survey[kept])
    strangers = cloud.mean(0) + scattered(rng, int(extra * n))
    truth = np.r_[kept, np.full(len(strangers), -1)]
    order = rng.permutation(len(truth))
    found = label_points(np.r_[cloud, strangers][order], survey + rng.normal(scale=SIGMA, size=survey.shape), SIGMA)
    assert found.status == LabellingStatus.OK
    assert np.array_equal(found.assignment, truth[order])
    assert np.array_equal(found.missing, np.setdiff1d(np.arange(n), kept))
    assert found.n_consistent == len(kept)
    assert found.expected_accidental < ACCIDENTS_LIMIT
    # The noise of both sets, over a body of 0.3 m seen at 5 points or more.
    assert_close(log_so3(found.T_measurement_survey[:3, :3] @ R.T), np.zeros(3), atol=60 * SIGMA / 0.1, what="attitude")
    assert_close(
        found.T_measurement_survey[:3, :3] @ survey.mean(0) + found.T_measurement_survey[:3, 3],
        R @ survey.mean(0) + t,
        atol=60 * SIGMA,
        what="position",
    )


def test_the_residuals_of_a_labelling_are_the_noise_of_both_sets():
    rng = np.random.default_rng(0)
    survey = scattered(rng, 200)
    cloud, _, _ = moved(rng, survey)
    found = label_points(cloud, survey + rng.normal(scale=SIGMA, size=survey.shape), SIGMA)
    expected = SIGMA * np.sqrt(2 * 3 * (1 - 2 / 200))
    # 594 degrees of freedom: the root mean square scatters by 2.9 %; four of that.
    assert_between(found.rms, 0.884 * expected, 1.116 * expected, what="rms")


@given(seeds)
def test_the_answer_does_not_depend_on_the_order_or_the_frame(seed):
    rng = np.random.default_rng(seed)
    survey = np.r_[ring(PLATFORM_RING), scattered(rng, 4, 0.1, 0.1)]
    cloud, _, _ = moved(rng, survey)
    first = label_points(cloud, survey, SIGMA)
    order, names = rng.permutation(len(cloud)), rng.permutation(len(survey))
    again = label_points(moved(rng, cloud, 0.0)[0][order], survey[names], SIGMA)
    assert first.status == again.status == LabellingStatus.OK
    assert np.array_equal(names[again.assignment], first.assignment[order])
    assert_close(again.log_odds, first.log_odds, atol=1e-3, what="log odds against the best rival")


@pytest.mark.parametrize(("angles", "n_rivals"), [(np.arange(6) * np.pi / 3, 11), (PLATFORM_RING, 5)])
def test_a_symmetric_ring_is_refused_and_its_rivals_are_named(angles, n_rivals):
    rng = np.random.default_rng(1)
    names = [f"P{i}" for i in range(1, 7)]
    found = label_points(moved(rng, ring(angles))[0], ring(angles), SIGMA, names)
    assert found.status == LabellingStatus.AMBIGUOUS
    assert np.all(found.assignment == -1)
    assert found.T_measurement_survey is None
    full = [rival for rival in found.rivals if rival.n_consistent == 6]
    assert len(full) == n_rivals
    assert all(rival.log_odds < MARGIN_LOG_ODDS for rival in full)
    assert all(" as P" in rival.name for rival in full)
    assert len({tuple(rival.assignment) for rival in full}) == n_rivals
    assert "symmetry" in found.remedy


def test_one_target_off_the_symmetry_determines_a_ring_while_it_is_seen():
    rng = np.random.default_rng(2)
    survey = np.r_[ring(np.arange(6) * np.pi / 3), [[0.02, 0.03, 0.05]]]
    cloud = moved(rng, survey)[0]
    assert np.array_equal(label_points(cloud, survey, SIGMA).assignment, np.arange(7))
    assert label_points(cloud[:6], survey, SIGMA).status == LabellingStatus.AMBIGUOUS


def test_a_mirror_image_is_a_rival_only_of_a_plane_set():
    rng = np.random.default_rng(3)
    half = scattered(rng, 6)
    solid = np.r_[half, half * [1, 1, -1]]
    assert np.array_equal(label_points(moved(rng, solid)[0], solid, SIGMA).assignment, np.arange(12))
    plane = np.r_[half[:, [0, 1, 1]], half[:, [0, 1, 1]] * [1, -1, 1]] * [1, 1, 0]
    assert label_points(moved(rng, plane)[0], plane, SIGMA).status == LabellingStatus.AMBIGUOUS


@pytest.mark.slow
@given(seeds)
def test_mirrored_axes_and_wrong_units_are_never_labelled(seed):
    rng = np.random.default_rng(seed)
    survey = scattered(rng, 10)
    cloud = moved(rng, survey)[0]
    mirrored = label_points(cloud * [1, 1, -1], survey, SIGMA)
    assert mirrored.status != LabellingStatus.OK
    assert np.all(mirrored.assignment == -1)
    assert label_points(1000 * cloud, survey, SIGMA).status == LabellingStatus.NO_MATCH


@given(seeds, st.integers(3, 30), st.integers(3, 30), st.sampled_from([1e-5, 1e-4, 1e-3]))
def test_a_cloud_without_the_body_is_not_labelled(seed, n_points, n_targets, sigma):
    rng = np.random.default_rng(seed)
    found = label_points(scattered(rng, n_points), scattered(rng, n_targets), sigma)
    assert found.status == LabellingStatus.NO_MATCH
    assert np.all(found.assignment == -1)
    assert len(found.missing) == n_targets
    assert "units" in found.remedy


@pytest.mark.slow
def test_noise_as_coarse_as_the_spacing_costs_labels_but_not_their_truth():
    """Thirty targets of 0.3 m with 1 mm noise: neighbours come within reach of each other, and are then refused."""
    wrong = labelled = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        survey = scattered(rng, 30, size=0.15)
        found = label_points(moved(rng, survey, 1e-3)[0], survey + rng.normal(scale=1e-3, size=survey.shape), 1e-3)
        wrong += np.count_nonzero((found.assignment >= 0) & (found.assignment != np.arange(30)))
        labelled += np.count_nonzero(found.assignment >= 0)
    assert wrong == 0
    assert labelled >= 0.95 * 20 * 30


def test_neighbours_closer_than_the_noise_lose_only_their_own_labels():
    rng = np.random.default_rng(4)
    survey = scattered(rng, 12)
    survey = np.r_[survey, survey[:1] + 1e-5]
    found = label_points(moved(rng, survey)[0], survey, SIGMA)
    assert found.status == LabellingStatus.AMBIGUOUS
    assert np.array_equal(found.assignment, np.r_[-1, np.arange(1, 12), -1])
    assert found.rivals[0].name == "0 as 12, 12 as 0"


def test_a_target_that_deforms_is_found_by_its_own_tolerance():
    rng = np.random.default_rng(5)
    survey = scattered(rng, 14)
    bent = survey + np.r_[np.zeros((8, 3)), rng.choice([-8e-5, 8e-5], (6, 1)) * [0, 0, 1]]
    cloud = moved(rng, bent)[0]
    assert np.array_equal(np.flatnonzero(label_points(cloud, survey, SIGMA).assignment < 0), np.arange(8, 14))
    loose = np.r_[np.full(8, SIGMA), np.full(6, 4e-5)]
    assert np.array_equal(label_points(cloud, survey, SIGMA, survey_sigma=loose).assignment, np.arange(14))


def test_a_body_whose_targets_lie_on_a_line_is_labelled_by_its_spacing():
    rng = np.random.default_rng(6)
    line = np.c_[[0.0, 0.03, 0.1], np.zeros((3, 2))]
    strangers = scattered(rng, 30)
    cloud, R, _ = moved(rng, line)
    found = label_points(np.r_[strangers, cloud], line, SIGMA)
    assert np.array_equal(np.flatnonzero(found.assignment >= 0), [30, 31, 32])
    assert_close(found.T_measurement_survey[:3, 0], R[:, 0], atol=6 * SIGMA / 0.05, what="direction of the line")
    even = np.c_[[0.0, 0.05, 0.1], np.zeros((3, 2))]
    assert label_points(moved(rng, even)[0], even, SIGMA).status == LabellingStatus.AMBIGUOUS


@pytest.mark.slow
@given(seeds)
def test_bodies_that_move_on_their_own_share_a_cloud_and_no_point(seed):
    rng = np.random.default_rng(seed)
    bodies = {
        "base": scattered(rng, 12, 0.05),
        "platform": np.r_[ring(PLATFORM_RING), scattered(rng, 6, 0.2, 0.1)],
        "leg1": scattered(rng, 3, 0.1, 0.2),
        "leg2": scattered(rng, 4, 0.1, 0.2),
    }
    cloud = np.concatenate([*(moved(rng, survey)[0] for survey in bodies.values()), scattered(rng, 6, size=1.0)])
    owner = np.r_[np.repeat(list(bodies), [len(s) for s in bodies.values()]), np.repeat("nobody", 6)]
    number = np.concatenate([*(np.arange(len(s)) for s in bodies.values()), np.full(6, -1)])
    order = rng.permutation(len(cloud))
    for body, found in label_bodies(cloud[order], bodies, SIGMA).items():
        assert found.status == LabellingStatus.OK
        assert np.array_equal(found.assignment, np.where(owner == body, number, -1)[order])


def test_identical_bodies_are_refused_and_the_others_are_not():
    rng = np.random.default_rng(7)
    leg = scattered(rng, 4, 0.1, 0.2)
    bodies = {"base": scattered(rng, 12), "leg1": leg, "leg2": leg}
    found = label_bodies(np.concatenate([moved(rng, survey)[0] for survey in bodies.values()]), bodies, SIGMA)
    assert [found[body].status for body in bodies] == ["ok", "ambiguous", "ambiguous"]
    assert found["leg1"].rivals[0].name.startswith("on the points of leg")


def test_points_of_a_body_that_no_survey_knows_have_no_names():
    assert label_bodies(np.random.default_rng(1).normal(size=(5, 3)), {}, SIGMA) == {}


def test_a_body_seen_twice_is_refused():
    rng = np.random.default_rng(8)
    survey = scattered(rng, 8)
    found = label_points(np.r_[moved(rng, survey)[0], moved(rng, survey)[0]], survey, SIGMA)
    assert found.status == LabellingStatus.AMBIGUOUS
    assert np.all(found.assignment == -1)


@pytest.mark.parametrize(("n_points", "n_targets"), [(0, 5), (2, 5), (5, 2)])
def test_fewer_than_three_of_either_are_too_few(n_points, n_targets):
    rng = np.random.default_rng(9)
    found = label_points(scattered(rng, n_points), scattered(rng, n_targets), SIGMA)
    assert found.status == LabellingStatus.TOO_FEW
    assert found.T_measurement_survey is None
    assert len(found.assignment) == n_points


def test_bad_input_is_refused_at_the_door():
    good = np.eye(3)
    with pytest.raises(ValueError, match=r"points: found shape \(3, 2\), expected \(N, 3\)"):
        label_points(good[:, :2], good, SIGMA)
    with pytest.raises(ValueError, match="non-finite"):
        label_points(good, np.where(good == 1, np.nan, good), SIGMA)
    with pytest.raises(ValueError, match="not positive"):
        label_points(good, good, 0.0)
    with pytest.raises(ValueError, match="found 2, expected 3"):
        label_points(good, good, SIGMA, ["A", "B"])
