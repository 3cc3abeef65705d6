"""An onset within a hundred poses is located to the pose."""

from __future__ import annotations

import numpy as np

from tests.simulation.mechanisms.chains.made_arms import campaign
from truing.simulation.mechanisms.chains.causes import FEWEST
from truing.simulation.mechanisms.chains.jumps import BaseJump, JointJump, ToolJump
from truing.simulation.mechanisms.chains.target_causes import ChainTargetMoved

POSES = 100
EVERY = set(range(FEWEST, POSES - FEWEST + 1))


def test_the_base_may_jump_at_every_pose_of_a_hundred() -> None:
    found = BaseJump().candidates(campaign(np.random.default_rng(1), POSES).scene)
    assert {cause.from_pose for cause in found} == EVERY


def test_every_joint_may_jump_at_every_pose_of_a_hundred() -> None:
    found = JointJump().candidates(campaign(np.random.default_rng(1), POSES).scene)
    assert {(cause.subject, cause.from_pose) for cause in found} == {
        (f"joint j{k}", pose) for k in range(1, 6) for pose in EVERY
    }


def test_a_tool_may_jump_at_every_pose_if_two_targets_tell_it_from_one() -> None:
    found = ToolJump().candidates(campaign(np.random.default_rng(1), POSES).scene)
    assert {cause.from_pose for cause in found} == EVERY
    assert {cause.subject for cause in found} == {"link tip"}
    assert not ToolJump().candidates(campaign(np.random.default_rng(1), POSES, targets=1).scene)
    assert ToolJump().candidates(campaign(np.random.default_rng(1), POSES, targets=1, orientation=True).scene)


def test_a_target_may_move_at_every_pose_of_some_hundred() -> None:
    for poses in (POSES, 5 * POSES):
        (several,) = ChainTargetMoved().channel_candidates(campaign(np.random.default_rng(1), poses).scene)
        onsets = {several.member(0, k).from_pose for k in range(len(several.values))}
        assert onsets == set(range(FEWEST, poses - FEWEST + 1))
