"""Centres of mass that are declared in the frame at a row's end lie behind their joints: a question, no failure."""

from __future__ import annotations

import numpy as np
import pytest

from truing.belonging.relation import RelationState
from truing.belonging.weights import Weights, relate_weights

ENDS = np.array([[0.0, 0.0, 0.4], [0.56, 0.0, 0.0], [0.035, 0.0, 0.0], [0.0, 0.0, 0.08]])  # m
LINKS = ("link1", "link2", "link3", "link4")


def _tested(second: float, third: float) -> tuple[RelationState, str, str]:
    com = np.array([[0.0, 0.0, 0.2], [second, 0.0, 0.02], [third, 0.0, 0.0], [0.0, 0.0, 0.05]])
    weights = Weights(np.array([30.0, 18.0, 9.0, 6.0]), com, 5.0, np.zeros(3), 1.6, True, ENDS, LINKS)
    tested = relate_weights(weights)
    return tested.state, tested.reason, tested.subject


@pytest.mark.parametrize(("second", "third"), [(0.28, 0.02), (-0.1, 0.02), (0.28, -0.02)])
def test_centres_along_their_links_counterweights_and_short_links_are_not_asked_about(second, third) -> None:
    assert _tested(second, third)[:2] == (RelationState.OK, "agrees")


def test_a_centre_behind_its_joint_by_half_a_link_is_asked_about() -> None:
    assert _tested(-0.28, 0.02) == (RelationState.ATTENTION, "centre-behind", "link2")
