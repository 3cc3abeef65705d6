"""A camera that changed between poses is found, and a stable one is not."""

import numpy as np
import pytest

from truing.estimation.bundle.adjustment import adjust
from truing.estimation.bundle.camera_stability import WATCHED, camera_stability
from truing.estimation.bundle.ray_statistics import ray_statistics

from .photographed import simulate


def stability_of(made):
    adjusted = adjust(made.network, made.truth, "free")
    reported = ray_statistics(adjusted.observed, adjusted.state)
    names = [number.name if number.kind == "camera" else "" for number in reported.numbers]
    rows = [names.index(name) for name in WATCHED]
    return camera_stability(reported.score[:, rows], reported.information[:, rows][:, :, rows])


def test_a_stable_camera_passes_at_the_stated_rate():
    found = [stability_of(simulate(seed=seed, poses=3, images=7, points=20)) for seed in range(12)]
    overall = [one.overall_p_value for one in found]
    assert min(overall) > 0.05 / 12 / 5
    assert 0.25 < np.mean(overall) < 0.75
    chi2 = np.concatenate([one.chi2 for one in found])
    assert np.mean(chi2) == pytest.approx(3.0, abs=4 * np.sqrt(6 / 24))  # 36 of them, 24 independent


def test_a_changed_camera_is_found_in_its_pose():
    change = np.zeros((3, 10))
    change[1, :3] = [12.0, 6.0, -4.0]
    found = stability_of(simulate(seed=1, poses=3, images=8, points=25, deviations=change))
    assert found.overall_p_value < 1e-6
    assert found.freedom == 6
    assert np.argmin(found.p_value) == 1
    apart = found.deviation_px - found.deviation_px[0]
    spread = np.sqrt(np.einsum("gii->gi", found.covariance_px2))
    assert (np.abs(apart - change[:, :3]) < 5 * (spread + spread[0])).all()
    assert np.abs(found.deviation_px[1]).max() > 3


def test_poses_without_information_are_left_out():
    found = camera_stability(np.zeros((3, 3)), np.stack([np.eye(3), np.zeros((3, 3)), np.eye(3)]))
    assert found.determined.tolist() == [True, False, True]
    assert np.isnan(found.chi2[1])
    assert found.freedom == 3
    assert found.overall_p_value == 1.0
    assert np.isnan(camera_stability(np.zeros((1, 3)), np.eye(3)[None]).overall_p_value)
