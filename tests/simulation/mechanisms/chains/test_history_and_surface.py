"""Nonparametric motion of a joint: functions of two readings, and of the direction of approach."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.polynomial import chebyshev

from tests.simulation.mechanisms.chains.made_arms import campaign
from tests.tolerance import assert_close
from truing.simulation.inputs import MEMORY, PATH, STOPS
from truing.simulation.mechanisms.chains.conditions import movements
from truing.simulation.mechanisms.chains.nonparametric import HISTORY, SURFACE, NonparametricChainEffect


def _memory(readings: np.ndarray, order: np.ndarray | None = None) -> np.ndarray:
    order = np.arange(len(readings)) if order is None else order
    return movements(readings, {"order": order}, np.full(readings.shape[1], 1e-3))[MEMORY]


def test_a_stop_operator_follows_within_its_threshold_and_slips_beyond() -> None:
    course = np.array([0.0, 0.05, 0.1, 1.0, 0.9, 0.98, 0.0])[:, None]
    found = _memory(course)[:, 0]
    assert_close(found[:3, 2], np.array([0.0, 0.05, 0.1]) / STOPS[2], atol=1e-15, what="as far as it moved")
    assert_close(found[3], np.ones(3), atol=1e-15, what="at the end of a long way")
    assert_close(found[4], np.maximum(1.0 - 0.1 / np.array(STOPS), -1.0), atol=1e-14, what="after turning")
    assert_close(found[6], -np.ones(3), atol=1e-15, what="after the way back")


def test_history_is_independent_of_unit_and_order_of_rows() -> None:
    rng = np.random.default_rng(1)
    course, order = rng.normal(size=(40, 2)), rng.permutation(40)
    assert_close(_memory(1e-3 * course), _memory(course), atol=1e-12, what="unit")
    assert_close(_memory(course[order], order), _memory(course)[order], atol=1e-12, what="order of rows")


def _candidates(form: str) -> tuple[list[NonparametricChainEffect], object]:
    model = campaign(np.random.default_rng(2), 60)
    return [c for c in NonparametricChainEffect().candidates(model.scene) if c.form == form], model.machine


def test_a_surface_consists_of_products_of_polynomials_of_two_readings() -> None:
    found, machine = _candidates(SURFACE)
    assert len(found) == 5 * 10 * 2, "five joints, ten pairs, two sizes"
    largest = next(c for c in found if c.joint == "j2" and c.columns == ("j3_deg", "j5_deg") and c.degree == 9)
    moved = largest.deviations(machine)[:, 1]
    x, y = largest.scaled(lambda column: machine.conditions.covariates[column])
    both = chebyshev.chebvander2d(x, y, [3, 3]).reshape(len(x), 4, 4)
    expected = [both[:, i, j] for i in range(4) for j in range(4) if 0 < i + j < 4]
    assert moved.shape[-1] == len(expected)
    for column in expected:
        assert np.abs(moved - column[:, None]).max(0).min() < 1e-12


def test_a_history_effect_moves_its_joint_alone_and_is_not_persistent() -> None:
    found, machine = _candidates(HISTORY)
    assert [c.joint for c in found] == ["j1", "j2", "j3", "j4", "j5"]
    moved = found[2].deviations(machine)
    assert_close(moved[:, 2], machine.conditions.covariates[MEMORY][:, 2], atol=0.0, what="stops")
    assert not np.delete(moved, 2, axis=1).any()
    assert found[2].inputs(5) == ("j3_deg",)
    assert not found[2].is_persistent
    assert len({c.key for c in found}) == 5


def test_own_reading_and_history_have_a_fifth_of_a_joints_prior_each() -> None:
    model = campaign(np.random.default_rng(2), 60)
    found = [c for c in NonparametricChainEffect().candidates(model.scene) if c.joint == "j2"]
    weight = dict.fromkeys(("history", "place", "other"), 0.0)
    for candidate in found:
        own = "place" if candidate.columns == ("j2_deg",) else "other"
        weight["history" if candidate.form == HISTORY else own] += candidate.prior(model.scene)
    for own in ("history", "place"):
        assert 0.15 < weight[own] / sum(weight.values()) < 0.3


def test_history_counts_poses_that_are_left_out() -> None:
    """The state of friction, and the reading before the last movement, of some poses of a campaign."""
    model = campaign(np.random.default_rng(2), 60)
    conditions = model.machine.conditions
    kept = np.arange(60) % 4 > 0
    part = replace(model.scene, inputs_of_machine=replace(model.machine, conditions=conditions.subset(kept)))
    for k, (name, past) in enumerate(part.histories.items()):
        assert_close(past[:, :-1], conditions.covariates[PATH][kept, k], atol=0.0, what="stops")
        before = np.roll(model.scene.inputs[name], 1)
        assert_close(past[1:, -1], before[kept][1:], atol=1e-9, what="reading before")
