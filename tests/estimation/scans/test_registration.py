"""Poses from dense scans: recovery with a correct covariance, and refusal of surfaces that do not determine a pose."""

from __future__ import annotations

import numpy as np
import pytest

from tests.tolerance import assert_between, assert_close
from truing.estimation.rotation import exp_so3, log_so3
from truing.estimation.scans.registration import ScanStatus, refine_scan, register_scan

NOISE = 5e-5
R_TRUE, T_TRUE = exp_so3(np.array([0.5, -1.3, 2.0])), np.array([0.3, 0.1, -0.5])
# 99.99 % of a chi-square of six degrees of freedom.
SURE = 27.86


def directions(rng, n):
    d = rng.normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1)[:, None]


def casting(rng, n):
    """A body of 0.1 m without any symmetry."""
    x, y, z = directions(rng, n).T
    radius = 0.1 * (1 + 0.15 * x * y + 0.2 * z**2 - 0.1 * x**3 + 0.1 * np.sin(3 * y) + 0.08 * x * z)
    return np.c_[1.2 * x, y, 0.7 * z] * radius[:, None]


def bumpy(rng, n):
    """A disc of 0.28 m with a few hills, flat between them."""
    r, angle = 0.14 * np.sqrt(rng.uniform(size=n)), rng.uniform(0, 2 * np.pi, n)
    xy = np.c_[r * np.cos(angle), r * np.sin(angle)]
    hills = np.array([[0.05, 0.06], [-0.07, 0.02], [0.02, -0.08], [-0.05, -0.06], [0.09, -0.02]])
    distance = np.sum((xy[:, None] - hills) ** 2, axis=-1) / 0.03**2
    return np.c_[xy, np.exp(-distance) @ np.array([0.02, -0.02, 0.02, 0.015, 0.02])]


def box(rng, n):
    half = np.array([0.1, 0.06, 0.03])
    area = np.repeat([half[1] * half[2], half[0] * half[2], half[0] * half[1]], 2)
    face = rng.choice(6, n, p=area / area.sum())
    points = rng.uniform(-1, 1, (n, 3))
    points[np.arange(n), face // 2] = np.where(face % 2, 1, -1)
    return points * half


def tube(rng, n):
    angle = rng.uniform(0, 2 * np.pi, n)
    return np.c_[0.05 * np.cos(angle), 0.05 * np.sin(angle), rng.uniform(-0.1, 0.1, n)]


def plate(rng, n):
    return np.c_[rng.uniform(-0.1, 0.1, (n, 2)), np.zeros(n)]


def ball(rng, n):
    return 0.1 * directions(rng, n)


def measured(rng, shape, n_reference, n_scan, part=False):
    """A noisy reference, and a noisy scan of the body under the true pose, of one side only where `part`."""
    reference, scan = shape(rng, n_reference), shape(rng, n_scan)
    scan = scan[scan[:, 0] + 0.3 * scan[:, 1] > -0.02] if part else scan
    reference = reference + rng.normal(scale=NOISE, size=reference.shape)
    return reference, scan @ R_TRUE.T + T_TRUE + rng.normal(scale=NOISE, size=scan.shape)


def error(fit, R=R_TRUE, t=T_TRUE):
    T = fit.T_measurement_reference
    return np.r_[T[:3, 3] - t, log_so3(T[:3, :3] @ R.T)]


def mahalanobis(fit):
    return error(fit) @ np.linalg.solve(fit.covariance, error(fit))


def true_pose():
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R_TRUE, T_TRUE
    return T


@pytest.mark.slow
def test_one_side_of_a_body_among_clutter_gives_its_pose_within_its_covariance():
    rng = np.random.default_rng(0)
    reference, scan = measured(rng, casting, 5000, 4000, part=True)
    clutter = scan.mean(0) + rng.uniform(-0.2, 0.2, (600, 3))
    fit = register_scan(np.r_[scan, clutter], reference)
    assert fit.status == ScanStatus.OK
    assert mahalanobis(fit) < SURE
    assert_between(fit.overlap, 0.7, len(scan) / (len(scan) + 600), what="overlap")
    # Heights carry the scan's noise and what smoothing leaves of the reference's: between 1 and sqrt(2) of it.
    assert_between(fit.rms / NOISE, 1.0, 1.42, what="rms of the heights over the noise")
    assert fit.n_points == len(scan) + 600


@pytest.mark.slow
def test_the_pose_moves_with_the_scan_and_is_the_same_at_every_call():
    rng = np.random.default_rng(1)
    reference, scan = measured(rng, casting, 4000, 3000)
    fit = register_scan(scan, reference)
    again = register_scan(scan, reference)
    assert np.array_equal(fit.T_measurement_reference, again.T_measurement_reference)
    assert np.array_equal(fit.covariance, again.covariance)
    R, t = exp_so3(rng.normal(size=3)), rng.normal(size=3)
    moved = register_scan(scan @ R.T + t, reference)
    difference = error(moved, R @ fit.T_measurement_reference[:3, :3], R @ fit.T_measurement_reference[:3, 3] + t)
    # Both have settled to a tenth of a standard deviation in each of six directions.
    assert difference @ np.linalg.solve(moved.covariance, difference) < 6 * 2 * 0.1**2


@pytest.mark.slow
def test_the_covariance_is_that_of_the_errors():
    """Noise on both clouds and other points at every trial: the mean squared Mahalanobis error is its dimension."""
    trials = 80
    squared = []
    for seed in range(trials):
        reference, scan = measured(np.random.default_rng(seed), casting, 4000, 2500, part=True)
        fit = refine_scan(scan, reference, true_pose())
        assert fit.status == ScanStatus.OK
        squared.append(mahalanobis(fit))
    four_sigma = 4 * np.sqrt(2 * 6 / trials)
    assert_between(np.mean(squared), 6 - four_sigma, 6 + four_sigma, what="mean squared Mahalanobis error")


@pytest.mark.slow
def test_a_reference_too_sparse_for_its_shape_makes_no_pose_look_better_than_it_is():
    """No noise on the reference, and bumps that its points do not resolve: shape limits the pose, and is counted."""
    trials = 40
    squared = []
    for seed in range(trials):
        rng = np.random.default_rng(seed)
        reference, scan = (bumpy(rng, n) for n in (3000, 2500))
        fit = refine_scan(scan + rng.normal(scale=2e-5, size=scan.shape), reference, np.eye(4))
        T = fit.T_measurement_reference
        deviation = np.r_[T[:3, 3], log_so3(T[:3, :3])]
        squared.append(deviation @ np.linalg.solve(fit.covariance, deviation))
    # It may be too large by a half: what shape does is not known as well as what noise does.
    assert_between(np.mean(squared), 3.0, 6 + 4 * np.sqrt(2 * 6 / trials), what="mean squared Mahalanobis error")


def test_the_covariance_has_units():
    reference, scan = measured(np.random.default_rng(2), casting, 4000, 2500)
    fit = refine_scan(scan, reference, true_pose())
    T = true_pose()
    T[:3, 3] *= 4
    larger = refine_scan(4 * scan, 4 * reference, T)
    unit = np.r_[np.full(3, 4.0), np.ones(3)]
    expected = np.outer(unit, unit) * fit.covariance
    assert_close(
        larger.covariance / np.outer(unit, unit) / fit.covariance[0, 0],
        fit.covariance / fit.covariance[0, 0],
        atol=1e-6 * np.abs(expected / fit.covariance[0, 0]).max(),
        what="covariance in other units",
    )
    assert_close(larger.T_measurement_reference[:3, 3], 4 * fit.T_measurement_reference[:3, 3], atol=1e-9)


def test_noise_is_found_where_it_is_not_declared():
    reference, scan = measured(np.random.default_rng(3), casting, 20_000, 4000)
    found, declared = refine_scan(scan, reference, true_pose()), refine_scan(scan, reference, true_pose(), sigma=NOISE)
    ratio = np.sqrt(np.trace(found.covariance[:3, :3]) / np.trace(declared.covariance[:3, :3]))
    # The scan's 4000 points lie too far apart to tell noise from shape to better than some per cent.
    assert_between(ratio, 0.95, 1.25, what="found over declared standard deviation")


def test_a_body_that_bends_enlarges_its_covariance():
    reference, scan = measured(np.random.default_rng(4), casting, 8000, 6000)
    rigid = refine_scan(scan, reference, true_pose(), sigma=NOISE)
    inside = (scan - T_TRUE) @ R_TRUE
    wave = 1.5 * NOISE * np.sin(60 * inside[:, :1]) * inside / np.linalg.norm(inside, axis=1)[:, None]
    bent = refine_scan((inside + wave) @ R_TRUE.T + T_TRUE, reference, true_pose(), sigma=NOISE)
    assert rigid.noise_ratio < 1.2
    assert bent.noise_ratio > 2
    assert np.trace(bent.covariance) > 4 * np.trace(rigid.covariance) / rigid.noise_ratio**2


@pytest.mark.parametrize(
    ("shape", "motions"),
    [
        (ball, ["rotation", "rotation", "rotation"]),
        (tube, ["translation", "rotation"]),
        (plate, ["translation", "translation", "rotation"]),
    ],
)
def test_a_surface_that_slides_along_itself_is_refused_and_its_motions_are_named(shape, motions):
    reference, scan = measured(np.random.default_rng(5), shape, 3000, 2500)
    fit = refine_scan(scan, reference, true_pose())
    assert fit.status == ScanStatus.DEGENERATE
    assert [motion.split()[0] for motion in fit.unobservable] == motions
    assert fit.T_measurement_reference is None
    assert fit.covariance is None
    if shape is tube:
        assert fit.unobservable[0] == "translation along (0.000, 0.000, 1.000)"
        assert fit.unobservable[1].startswith("rotation about (0.000, 0.000, 1.000) through (0.0")


@pytest.mark.slow
def test_a_box_is_refused_with_the_three_attitudes_that_look_the_same():
    reference, scan = measured(np.random.default_rng(6), box, 4000, 3000)
    fit = register_scan(scan, reference)
    assert fit.status == ScanStatus.AMBIGUOUS
    assert fit.T_measurement_reference is None
    assert len(fit.rivals) == 3
    turns = [np.linalg.norm(log_so3(T[:3, :3].T @ rival[:3, :3])) for T in fit.rivals for rival in fit.rivals]
    assert_close(np.sort(turns), np.r_[np.zeros(3), np.full(6, np.pi)], atol=0.02, what="turns between rivals")


def test_another_body_and_other_units_match_nowhere():
    rng = np.random.default_rng(7)
    reference, scan = measured(rng, casting, 3000, 2500)
    assert register_scan(1000 * scan, reference).status == ScanStatus.NO_MATCH
    other = refine_scan(measured(rng, box, 10, 2500)[1], reference, true_pose())
    assert other.status == ScanStatus.NO_MATCH
    assert "units" in other.remedy


def test_few_points_are_no_dense_scan():
    rng = np.random.default_rng(8)
    fit = register_scan(casting(rng, 50), casting(rng, 5000))
    assert fit.status == ScanStatus.TOO_FEW
    assert fit.n_points == 50
    assert "targets" in fit.remedy


def test_bad_input_is_refused_at_the_door():
    good = casting(np.random.default_rng(9), 300)
    with pytest.raises(ValueError, match=r"points: found shape \(300, 2\), expected \(N, 3\)"):
        register_scan(good[:, :2], good)
    with pytest.raises(ValueError, match="reference: found a non-finite coordinate"):
        register_scan(good, np.where(good == good[0, 0], np.inf, good))
