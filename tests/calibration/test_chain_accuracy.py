"""Accuracy of a chain's tip: derivatives against moved targets, coverage against drawn campaigns, shares of tolerances
against drawn arms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.blind.generator.arms.motion import at_rest, places
from tests.blind.generator.arms.robot import robot_campaign
from tests.packaging.source_tree import PROJECT
from tests.simulation.mechanisms.chains.made_arms import campaign
from tests.stages.line import run_line
from tests.tolerance import assert_close
from truing.calibration.accuracy import error_of_95_percent
from truing.calibration.chain_accuracy import (
    covered,
    expected_errors,
    held_out_needed,
    poses_needed,
    tip_sight,
    tolerance_sources,
    total_variance,
)
from truing.calibration.chain_design import PlannedPoses
from truing.estimation.design.rival_design import PointInstrument
from truing.estimation.rotation import log_so3
from truing.stages.common.chain_tables import tree_of

NOISE = 2e-5


def planned(rng: np.random.Generator, poses: int, targets: int = 3, joint_noise: float = 1e-6) -> PlannedPoses:
    model = campaign(rng, poses, targets)
    model = replace(model, known=replace(model.known, reading_sigma=np.full(5, joint_noise)))
    covariance = np.broadcast_to(NOISE**2 * np.eye(3), (targets, 3, 3))
    return PlannedPoses(model, model.conditions, PointInstrument(covariance, free=False))


def rigid(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Shift of the mean and rotation vector (6,) from points (K, 3) to others."""
    a, b = start - start.mean(0), end - end.mean(0)
    left, _, right = np.linalg.svd(b.T @ a)
    turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return np.concatenate([end.mean(0) - start.mean(0), log_so3(turn[None])[0]])


def test_the_tip_moves_as_its_targets_do_in_the_axes_of_the_base() -> None:
    rng = np.random.default_rng(1)
    poses = planned(rng, 6)
    sight, model = tip_sight(poses), poses.model
    none = np.zeros((6, model.local_size))
    step = 1e-4 * rng.normal(size=model.shared_size)
    step[model.layout["shape"]] = 0.0  # targets that move on the tip change its shape
    moved, start = model.points(step, none), model.points(-step, none)
    to_base = model.known.base_R[0].T
    for b in range(6):
        found = rigid(start[b] @ to_base.T, moved[b] @ to_base.T)
        assert_close(2.0 * sight.by_unknowns[b] @ step, found, atol=1e-4 * np.abs(found).max(), what="m, rad")
    assert sight.known.all()


def test_two_targets_show_no_rotation() -> None:
    assert list(tip_sight(planned(np.random.default_rng(1), 6, targets=2)).known) == [True] * 3 + [False] * 3


def test_95_of_100_errors_of_drawn_campaigns_stay_below_the_stated_size() -> None:
    """Non-linear campaigns of drawn arms, each fitted by Gauss and Newton."""
    rng = np.random.default_rng(2)
    poses = planned(np.random.default_rng(3), 30, joint_noise=0.0)
    other = replace(planned(np.random.default_rng(4), 40, joint_noise=0.0), model=poses.model)
    model, size = poses.model, poses.model.shared_size
    sight = tip_sight(other)
    stated = expected_errors(sight, poses.information)
    here, there = np.zeros((30, 0)), np.zeros((40, 0))
    inside = []
    for _ in range(40):
        truth = rng.normal(size=size) * np.where(model.setup, 0.01, 1.0)
        measured = model.points(truth, here) + NOISE * rng.normal(size=(30, 3, 3))
        found = np.zeros(size)
        for _ in range(4):
            predicted = model.predict(found, here)
            rows = predicted.by_shared.reshape(-1, size) / NOISE
            missed = (measured - predicted.values).ravel() / NOISE
            found += np.linalg.solve(rows.T @ rows + np.eye(size), rows.T @ missed - found)
        at = other.model.at(other.conditions)
        gaps = (at.points(found, there) - at.points(truth, there)).mean(1) @ model.known.base_R[0]
        inside.append(np.abs(gaps) < stated[:3])
    share = np.mean(inside, (0, 1))
    assert (np.abs(share - 0.95) < 0.03).all(), share


def test_errors_fall_with_poses_until_the_noise_of_the_readings_remains() -> None:
    poses = planned(np.random.default_rng(5), 40, joint_noise=3e-5)
    sight = tip_sight(poses)
    mean = poses.information / 40
    sizes = np.array([expected_errors(sight, n * mean) for n in (20, 80, 320, 10**7)])
    assert (np.diff(sizes, axis=0) < 0.0).all()
    np.testing.assert_allclose(sizes[-1], covered(sight.of_readings), rtol=1e-2)
    none = np.zeros_like(mean)
    limits = expected_errors(sight, 57 * mean) * (1.0 + 1e-9)
    assert poses_needed(sight, mean, none, limits) == [57] * 6
    assert poses_needed(sight, mean, 20 * mean, limits) == [37] * 6
    below = 0.99 * covered(sight.of_readings)
    assert poses_needed(sight, mean, none, below) == [None] * 6
    assert poses_needed(sight, mean, none, np.full(6, np.inf)) == [None] * 6


def test_the_stated_size_and_number_of_held_out_poses_are_those_by_which_a_run_decides() -> None:
    rng = np.random.default_rng(6)
    sight = tip_sight(planned(np.random.default_rng(5), 40, joint_noise=3e-5))
    information = planned(np.random.default_rng(5), 40).information
    size = float(expected_errors(sight, information)[0])
    variance, of_measurement = (size / 1.959964) ** 2, float(sight.of_measurement[:, 0].mean())
    errors = np.sqrt(variance + of_measurement) * rng.choice([-1.0, 1.0], 400_000)
    interval = error_of_95_percent(errors, np.full(len(errors), of_measurement))
    assert interval is not None
    assert interval.value == pytest.approx(size, rel=1e-9)
    for limit in (0.5 * size, 2.0 * size):
        (count, *_) = held_out_needed(sight, information, np.full(6, limit))
        assert count is not None
        for poses, decided in ((count, True), (count - 1, False)):
            found = error_of_95_percent(errors[:poses], np.full(poses, of_measurement))
            assert found is None or decided == (not found.lower <= limit < found.upper)


def test_rms_errors_by_tolerances_are_those_of_drawn_arms() -> None:
    """The arms are drawn and moved by the generator's own kinematics."""
    bench = robot_campaign().bench
    design, tolerance = bench.design, bench.tolerance
    assert tolerance is not None
    readings = bench.schedule.readings[:20]
    rng, sigmas = np.random.default_rng(7), design.sigmas(tolerance)
    tip = design.arm.tips[0]
    exact = places(design.arm, at_rest(design.arm, readings, 0))
    squares = np.zeros((20, 3))
    for _ in range(400):
        drawn = design.changed(sigmas * rng.normal(size=len(sigmas)))
        squares += (places(drawn, at_rest(drawn, readings, 0)).moved[:, tip] - exact.moved[:, tip]) ** 2 / 400
    tree = tree_of(run_line(PROJECT / "sample_data" / "robot", "ingest")[0]["joints"])
    sigma = np.array([tolerance.length] * 3 + [tolerance.angle] * 3)
    sources = tolerance_sources(tree, tree.links["tool0"], readings, np.full(6, tolerance.offset), sigma)
    built = [source for source in sources if source.subject != "flange"]  # the generator's flange is exact
    np.testing.assert_allclose(np.sqrt(total_variance(built)[:, :3].mean(0)), np.sqrt(squares.mean(0)), rtol=0.05)
    assert len(sources) == len(built) + 2
