"""Causes by weight that depend on an assumed centre of mass are suspected, not found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.mechanisms.chains.made_arms import campaign
from truing.simulation.mechanisms.chains.causes import JointCompliance
from truing.simulation.mechanisms.chains.link_causes import LinkBending
from truing.simulation.mechanisms.chains.loads import ColumnTilt, GravityDirection
from truing.simulation.mechanisms.chains.model import ChainModel

BY_WEIGHT = [LinkBending(), ColumnTilt(), GravityDirection()]


def arm(*unknown: str) -> ChainModel:
    model = campaign(np.random.default_rng(1), 40)
    return replace(model, known=replace(model.known, without_centre=unknown))


@pytest.mark.parametrize("kind", BY_WEIGHT, ids=lambda kind: kind.id)
def test_known_centres_are_no_assumption(kind: LinkBending) -> None:
    found = kind.candidates(arm().scene)
    assert found
    assert not any(cause.is_assumed for cause in found)


@pytest.mark.parametrize("kind", BY_WEIGHT, ids=lambda kind: kind.id)
def test_a_mass_at_the_tip_without_its_centre_is_an_assumption_of_all_that_carry_it(kind: LinkBending) -> None:
    found = kind.candidates(arm("tip").scene)
    assert found
    assert all(cause.is_assumed for cause in found)


def test_a_link_does_not_test_masses_that_it_does_not_carry() -> None:
    links = [node.link for node in arm().tree.nodes]
    assumed = {cause.link: cause.is_assumed for cause in LinkBending().candidates(arm(links[2]).scene)}
    assert assumed[links[2]]
    assert not any(held for link, held in assumed.items() if links.index(link) > 2)


def test_a_joint_fits_unknown_centres_and_assumes_none() -> None:
    assert not any(cause.is_assumed for cause in JointCompliance().candidates(arm("tip").scene))
