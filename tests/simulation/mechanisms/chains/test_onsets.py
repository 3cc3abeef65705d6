"""An onset is located to the pose: of a hundred poses all are tried, of more those between two that were tried."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulation.mechanisms.chains.made_arms import campaign
from truing.simulation.mechanisms.chains.causes import FEWEST, ChainCause
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


def test_a_tool_may_jump_at_every_pose_if_two_targets_distinguish_it_from_one() -> None:
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


@pytest.mark.parametrize("kind", [BaseJump(), JointJump(), ChainTargetMoved()], ids=lambda kind: kind.id)
def test_between_two_onsets_that_were_tried_lie_all_poses(kind: ChainCause) -> None:
    scene = campaign(np.random.default_rng(1), 8 * POSES).scene
    (several, *_) = scene.channel_candidates(kind) or (None,)
    tried = [several.member(0, k) for k in range(len(several.values))] if several else scene.candidates(kind)
    first, second = tried[3:5]
    onsets = scene.onsets(first)
    assert onsets is not None
    assert onsets.moved(0) == first
    assert onsets.moved(onsets.spacing) == second
    assert onsets.spacing > 1
    between = [onsets.moved(by) for by in range(1, onsets.spacing)]
    assert [cause.from_pose for cause in between] == list(range(first.from_pose + 1, second.from_pose))
    assert {cause.subject for cause in between} == {first.subject}
    assert onsets.moved(-8 * POSES) is None
