"""Least number of configurations of each model that campaign.toml has the numbers for."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np

from truing.calibration.configuration_search import DesignProblem
from truing.calibration.needed_configurations import NeededConfigurations, needed_configurations
from truing.simulation.mechanisms.structures.catalogue import structures
from truing.stages.common.nominal_mechanism import nominal_machine

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import LeggedMechanism

_CORNERS, _GENERIC = 100, 60


def needed_by_models(
    settings: Campaign, problem: DesignProblem, rng: np.random.Generator
) -> tuple[NeededConfigurations, ...]:
    """Return the least number of configurations of each model within the limits, rigid legs first."""
    machine = nominal_machine(cast("LeggedMechanism", settings.mechanism))
    corners = problem.region.corners()
    corners = rng.permutation(corners)[:_CORNERS]
    x = np.concatenate([corners, problem.region.draw(_GENERIC, rng)])
    placed = problem.regressors.at(x[problem.reached(x)])
    needs = (needed_configurations(structure, machine, placed) for structure in structures(machine))
    return tuple(need for need in needs if need is not None)
