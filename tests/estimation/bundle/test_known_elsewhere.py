"""Known points far from the intersections of rays are a fault; single gross errors and rough start values are not."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from truing.estimation.bundle.named_adjustment import KnownPointMismatch, KnownPointMismatchError, known_elsewhere
from truing.estimation.bundle.network import KnownPoints
from truing.stages.bundle_adjustment.tables import faults_of

XYZ = np.random.default_rng(4).normal(0.0, 0.2, (12, 3))


def elsewhere(given: np.ndarray, sigma_m: float = 2e-5) -> list[KnownPointMismatch]:
    known = KnownPoints(np.arange(12), given, np.broadcast_to(sigma_m**2 * np.eye(3), (12, 3, 3)))
    network = SimpleNamespace(known=known, point_pose=np.zeros(12, int))
    named: Any = SimpleNamespace(network=network, poses=("cold",), points=np.array([f"base/P{n}" for n in range(12)]))
    state: Any = SimpleNamespace(points=XYZ)
    return known_elsewhere(named, state)


def test_known_points_in_another_frame_are_a_fault_with_their_pose() -> None:
    given = XYZ * [1.0, 1.0, -1.0] + [0.0, 0.0, 0.2]
    (found,) = elsewhere(given)
    off = np.linalg.norm(given - XYZ, axis=1)
    assert (found.pose, found.elsewhere, found.known) == ("cold", 12, 12)
    assert (found.furthest, found.off_m) == (f"base/P{off.argmax()}", off.max())
    (fault,) = faults_of(KnownPointMismatchError([found]))
    assert (fault.file, fault.column) == ("known_points", "x_mm, y_mm, z_mm")
    assert fault.value == f"12 of 12 elsewhere, {found.furthest} by {1e3 * off.max():.3g} mm"
    assert "pose cold" in fault.expected
    assert not elsewhere(XYZ[:, [1, 0, 2]], sigma_m=1.0)


def test_small_offsets_and_two_wrong_known_points_are_no_other_frame() -> None:
    assert not elsewhere(XYZ + 5e-4)
    assert not elsewhere(XYZ + np.where(np.arange(12)[:, None] < 2, 0.3, 0.0))
