"""Joints that were held still are no inputs of errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.simulation.mechanisms.chains.made_arms import campaign
from truing.simulation.mechanisms.chains.conditions import moved_joints
from truing.simulation.mechanisms.chains.nonparametric import NonparametricChainEffect


def test_a_joint_that_was_held_still_did_not_move_though_its_reading_varies() -> None:
    readings = np.linspace(-1.0, 1.0, 9)[:, None] * [1.0, 4e-4, 2e-3, 1e-5, 0.0]
    is_revolute = np.array([True, True, True, False, False])
    np.testing.assert_array_equal(moved_joints(readings, is_revolute), [True, False, True, True, False])


def test_no_effect_depends_on_the_reading_of_a_joint_that_was_held_still() -> None:
    model = campaign(np.random.default_rng(1), 40, 3)
    conditions = model.conditions
    readings = conditions.readings.copy()
    readings[:, 1] = 1e-6 * np.arange(40)
    columns = {conditions.columns[1]: readings[:, 1]}
    still = replace(conditions, readings=readings, covariates={**conditions.covariates, **columns})
    scene = replace(model, conditions=still).scene
    inputs = {name for cause in NonparametricChainEffect().candidates(scene) for name in cause.columns}
    assert conditions.columns[1] not in inputs
    assert conditions.columns[0] in inputs
    assert conditions.columns[1] not in scene.covariates
    assert len(scene.inputs) == readings.shape[1] - 1
