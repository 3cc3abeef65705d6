"""ISO 230-2 and ISO 9283 agree with a second implementation on random tests with unequal counts."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tests.second_hand import iso_figures as second
from truing.estimation.interferometry.iso230 import BACKWARD, FORWARD, positioning
from truing.estimation.repeatability import (
    distance_figures,
    largest_change,
    largest_distance,
    orientation_distance_figures,
    orientation_repeatability,
    position_repeatability,
    turned_from_first,
)

SIDES = {FORWARD: "up", BACKWARD: "down"}


@pytest.mark.parametrize("seed", range(6))
def test_positioning_of_random_axes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    targets, most = int(rng.integers(2, 12)), int(rng.integers(2, 7))
    few = 1 if seed % 3 == 0 else 2  # with single readings nothing that needs a scatter is stated
    x = rng.normal(0.0, 5.0, (targets, 1, 1)) + rng.normal(0.0, 2.0, (targets, 2, 1))
    x = x + rng.normal(0.0, rng.uniform(0.2, 3.0, (targets, 2, 1)), (targets, 2, most))
    counts = rng.integers(few, most + 1, (targets, 2))
    x[np.arange(most) >= counts[..., None]] = np.nan
    sides = [{float(i): x[i, side, : counts[i, side]].tolist() for i in range(targets)} for side in SIDES]
    own, expected = positioning(x), second.both_ways(*sides)
    found = {
        "B": own.reversal,
        "M": own.mean_deviation,
        "E": own.bidirectional_systematic,
        "R": own.bidirectional_repeatability,
        "A": own.bidirectional_accuracy,
    }
    assert ("R" in expected) is bool(counts.min() > 1)
    for name, value in found.items():
        assert_allclose(value, expected.get(name, np.nan), rtol=1e-12)
    for side, readings in enumerate(sides):
        single = second.one_way(readings)
        both = {"E": own.systematic[side], "R": own.repeatability[side], "A": own.accuracy[side]}
        for name, value in both.items():
            assert_allclose(value, single.get(name, np.nan), rtol=1e-12)


@pytest.mark.parametrize("command", [(0.3, 0.1, 0.9, 0.0, 0.0, 0.0), (0.3, -0.2, 0.9, np.pi, 0.0, 0.0)])
def test_repeated_poses_of_a_random_arm(command: tuple[float, ...]) -> None:
    """Angles next to half a turn come out on either side of it."""
    rng = np.random.default_rng(9)
    nominal = Rotation.from_euler("xyz", command[3:])
    counts, sigma = (7, 5, 9), np.array([2e-5, 4e-5, 1e-5])
    groups, moved, turned = [], [], []
    for count in counts:
        places = np.array(command[:3]) + rng.normal(0.0, 5e-5, 3) + rng.normal(0.0, 2e-5, (count, 3))
        turns = Rotation.from_rotvec(rng.normal(0.0, 3e-5, 3) + rng.normal(0.0, sigma, (count, 3))) * nominal
        groups.append(np.column_stack([places, turns.as_euler("xyz")]).tolist())
        moved.append(places)
        turned.append(turns.as_matrix())
    every, places, R = [pose for group in groups for pose in group], np.concatenate(moved), np.concatenate(turned)
    signs = {float(np.sign(pose[3])) for pose in every}
    assert command[3] == 0.0 or signs == {-1.0, 1.0}
    expected = second.pose_repeatability(every, command)
    assert_allclose(position_repeatability(places, rng).value, expected["RP"], rtol=1e-10)
    rows = np.arange(len(R))
    for name, figure in zip("abc", orientation_repeatability(turned_from_first(R, rows, [rows])), strict=True):
        assert_allclose(figure.value, expected[f"RP_{name}"], rtol=1e-3)  # angles against rotations, to second order
    varied = second.multidirectional(groups, command)
    means = np.array([own.mean(0) for own in moved])
    assert_allclose(largest_distance(means), varied["vAP"], rtol=1e-10)


@pytest.mark.parametrize("count", [5, 30])
def test_distances_of_two_random_poses(count: int) -> None:
    """Small rotations about the axes are angles, to second order."""
    rng = np.random.default_rng(count)
    commands = (0.3, 0.1, 0.9, 0.0, 0.0, 0.0), (-0.4, 0.5, 0.2, 0.0, 0.0, 0.0)
    scatter = np.array([3e-5] * 3 + [2e-5] * 3)
    one, other = (
        np.array(command) + rng.normal(0.0, scatter) + rng.normal(0.0, scatter, (count, 6)) for command in commands
    )
    expected = second.distances(one.tolist(), other.tolist(), commands)
    commanded = float(np.linalg.norm(np.subtract(*commands)[:3]))
    accuracy, repeatability = distance_figures(one[:, :3], other[:, :3], commanded)
    assert_allclose(accuracy.value, expected["AD"], rtol=1e-9)
    assert_allclose(repeatability.value, expected["RD"], rtol=1e-9)
    assert repeatability.low < repeatability.value < repeatability.high
    for name, (off, spread) in zip("abc", orientation_distance_figures(one[:, 3:], other[:, 3:]), strict=True):
        assert_allclose([off.value, spread.value], [expected[f"AD_{name}"], expected[f"RD_{name}"]], rtol=1e-9)


def test_drift_is_the_largest_change_from_the_first_cycles() -> None:
    rng, command = np.random.default_rng(3), (0.3, 0.1, 0.9, 0.0, 0.0, 0.0)
    attained = np.array(command) + rng.normal(0.0, 3e-5, (34, 6)) + np.linspace(0.0, 3e-4, 34)[:, None]
    expected = second.drift(attained.tolist(), command, 10)
    looks = [attained[n : n + 10, :3] for n in (0, 10, 20)]
    accuracy = [np.linalg.norm(look.mean(0) - command[:3]) for look in looks]
    assert_allclose(largest_change(accuracy), expected["dAP"], rtol=1e-9)
    repeatability = [position_repeatability(look, rng).value for look in looks]
    assert_allclose(largest_change(repeatability), expected["dRP"], rtol=1e-9)
    angles = [own - command[3:] for own in (attained[n : n + 10, 3:] for n in (0, 10, 20))]
    assert_allclose(largest_change([angle.mean(0)[0] for angle in angles]), expected["dAP_a"], rtol=1e-9)
