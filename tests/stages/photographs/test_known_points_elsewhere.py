"""Known points that are not where rays meet are a fault; a few gross errors among them, or a rough start, are none."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from schemas.faults import CampaignFaults
from stages.bundle_adjustment.adjusting import check_known
from truing.estimation.bundle.network import KnownPoints

XYZ = np.random.default_rng(4).normal(0.0, 0.2, (12, 3))


def check(given: np.ndarray, sigma_m: float = 2e-5) -> None:
    known = KnownPoints(np.arange(12), given, np.broadcast_to(sigma_m**2 * np.eye(3), (12, 3, 3)))
    network = SimpleNamespace(known=known, point_pose=np.zeros(12, int))
    named: Any = SimpleNamespace(network=network, poses=("cold",), points=np.array([f"base/P{n}" for n in range(12)]))
    state: Any = SimpleNamespace(points=XYZ)
    check_known(named, state)


def test_of_another_frame() -> None:
    with pytest.raises(CampaignFaults, match=r"12 of 12 elsewhere, base/P.*pose cold"):
        check(XYZ * [1.0, 1.0, -1.0] + [0.0, 0.0, 0.2])
    check(XYZ[:, [1, 0, 2]], sigma_m=1.0)


def test_of_few_that_are_wrong() -> None:
    check(XYZ + 5e-4)
    check(XYZ + np.where(np.arange(12)[:, None] < 2, 0.3, 0.0))
