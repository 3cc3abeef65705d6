"""Another program's bundle adjustment, repeated: all numbers of its report agree; skipped without the data."""

from __future__ import annotations

import numpy as np
import pytest

from tests.real.bundle_answer_key import FOLDER, answer_key, items
from tests.real.campaigns import data_folder
from tests.tolerance import assert_close

pytestmark = pytest.mark.skipif(
    not (data_folder() / FOLDER).is_dir(), reason=f"the answer key is not there: {data_folder() / FOLDER}"
)


@pytest.fixture(scope="module")
def key():
    return answer_key(from_rays=False)


def test_the_same_observations_unknowns_and_conditions_leave_the_same_sigma0(key):
    ours = dict(key.counts)
    assert_close([ours.pop("sigma0_mm")], [key.report.counts["sigma0_mm"]], atol=0.5e-6)
    assert {name: key.report.counts[name] for name in ours} == ours
    assert ours["redundancy"] == 18804


def test_coordinates_to_a_tenth_of_their_sigma_and_sigmas_to_two_per_cent(key):
    xyz, sigmas = key.points
    assert_close((xyz - key.report.points[:, 1:4]) / sigmas, np.zeros((150, 3)), atol=0.1)
    printed = np.maximum(0.02 * sigmas, 0.5e-4)  # the report prints 0.1 um
    assert_close((sigmas - key.report.points[:, 4:]) / printed, np.zeros((150, 3)), atol=1.0)


def test_the_camera_with_its_sigmas(key):
    values, sigmas, _ = key.camera
    assert_close((values - key.report.camera[:, 0]) / sigmas, np.zeros(7), atol=0.02)
    assert_close(sigmas / key.report.camera[:, 1], np.ones(7), atol=1e-6)


def test_every_other_number_is_the_same_to_the_last_digit_of_the_report(key):
    moved = ("object points: coordinates", "camera: values", "images: centres", "images: rotations")
    checked = [one for one in items(key) if not one.what.startswith(moved)]
    assert sum(one.numbers for one in checked) > 60_000
    assert [(one.what, one.largest) for one in checked if not one.agrees] == []
