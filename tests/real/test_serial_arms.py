"""Models of a real arm, fitted to one set of poses and tested on another."""

from __future__ import annotations

import pytest

from tests.real.serial_arms import GRID, RANDOM, campaign, transfers

MODELS = (
    "geometry",
    "and compliance of shoulder and elbow",
    "and errors once per turn of all joints",
    "and error curves, compliance and zeros",
)


@pytest.fixture(scope="module")
def forth(real_data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("arms")
    return transfers(campaign(RANDOM, folder), campaign(GRID, folder), MODELS)


def test_geometry_and_compliance_hold_on_another_plan_of_poses(forth):
    position = forth["position_other"]
    assert position["base and tool alone"] == pytest.approx(0.84, abs=0.02)
    compliant = position["and compliance of shoulder and elbow"]
    assert compliant < 0.8 * position["geometry"] < 0.8 * position["base and tool alone"]


def test_errors_per_turn_hold_on_their_own_plan_alone(forth):
    turning = forth.loc["and errors once per turn of all joints"]
    compliant = forth.loc["and compliance of shoulder and elbow"]
    assert turning["position_own"] < compliant["position_own"]
    assert turning["position_other"] > 1.5 * compliant["position_other"]


def test_error_curves_of_the_joints_explain_most_and_hold_on_another_plan(forth):
    curves, compliant = (forth.loc[MODELS[k]] for k in (3, 1))
    assert curves["position_own"] < 0.35 * compliant["position_own"]
    assert curves["orientation_own"] < 0.35 * compliant["orientation_own"]
    assert curves["position_other"] < 0.9 * compliant["position_other"]
    assert curves["orientation_other"] < 0.75 * compliant["orientation_other"]
