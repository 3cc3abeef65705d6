"""Models of a real arm that were fitted to one plan of poses, tested on another one."""

from __future__ import annotations

import pytest

from tests.real.serial_arms import GRID, RANDOM, campaign, transfers


@pytest.fixture(scope="module")
def forth(real_data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("arms")
    return transfers(campaign(RANDOM, folder), campaign(GRID, folder))


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
