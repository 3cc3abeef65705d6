"""A camera that changed between poses is found, one that did not is not."""

import numpy as np

from truing.estimation.bundle.camera_stability import camera_stability

from .photographed import simulate


def every(made):
    return np.ones(made.network.rays.count, bool)


def test_a_stable_camera_passes_at_the_stated_rate():
    p_values = []
    for seed in range(12):
        made = simulate(seed=seed, poses=2, images=8, points=20)
        p_values.append(camera_stability(made.network, made.truth, "free", every(made)).overall_p_value)
    assert min(p_values) > 0.05 / 12 / 5
    assert 0.25 < np.mean(p_values) < 0.75


def test_a_changed_camera_is_found_in_its_pose():
    change = np.zeros((3, 10))
    change[1, :3] = [12.0, 6.0, -4.0]
    made = simulate(seed=1, poses=3, images=8, points=25, deviations=change)
    found = camera_stability(made.network, made.truth, "free", every(made))
    assert found.overall_p_value < 1e-6
    assert found.freedom[0] == 6
    assert found.pose[np.argmin(found.p_value)] == 1
    apart = found.deviation_px - found.deviation_px.mean(axis=0)
    expected = change[:, :3] - change[:, :3].mean(axis=0)
    assert (np.abs(apart - expected) < 5 * np.sqrt(np.einsum("gii->gi", found.covariance_px2))).all()


def test_nothing_to_compare_is_said():
    made = simulate(seed=2, poses=1, images=5, points=20)
    found = camera_stability(made.network, made.truth, "free", every(made))
    assert np.isnan(found.F)
    assert found.left_out == ("no camera has enough images in two poses",)
