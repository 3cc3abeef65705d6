"""A tool that shifts with an input is assigned to its link, not to a joint or the base."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.simulation.mechanisms.chains.made_arms import campaign
from truing.inference.forward_search import Settings
from truing.inference.observations import Epochs, Frames, Observations
from truing.inference.selection import CauseDiagnosis, CauseSelection
from truing.simulation.catalogue import catalogue_of_chains
from truing.simulation.mechanisms.chains.nonparametric import NonparametricChainEffect

POSES, NOISE_M = 60, 2e-5


def diagnosed(seed: int, column: str, values: NDArray, moves: NDArray, link: str = "tip") -> CauseDiagnosis:
    """Diagnosis if targets of the tip, or all of the base as seen from the instrument, move by ``moves`` (3,), m, per
    unit of ``column`` above its mean."""
    rng = np.random.default_rng(seed)
    model = campaign(rng, POSES, 3)
    known = replace(model.known, gear_orders=dict.fromkeys(model.tree.readings, ()))
    conditions = replace(model.conditions, covariates={**model.conditions.covariates, column: values})
    model = replace(model, known=known).at(conditions)
    shared = 0.3 * rng.normal(size=model.shared_size) * (np.arange(model.shared_size) > 5)
    points = model.points(shared, np.zeros((POSES, 0)))
    one = NOISE_M  # the rows of a tool's frame, from the model with each target moved along one axis
    turned = [
        (
            replace(model, known=replace(known, shape=known.shape + one * axis)).points(shared, np.zeros((POSES, 0)))
            - points
        )
        / one
        for axis in np.eye(3)
    ]
    size = values - values.mean()
    shift = (
        sum(own * part for own, part in zip(moves, turned, strict=True))
        if link
        else np.broadcast_to(moves, points.shape)
    )
    seen = points + size[:, None, None] * shift + rng.normal(0.0, NOISE_M, points.shape)
    covariance = np.broadcast_to(NOISE_M**2 * np.eye(3), (*seen.shape, 3))
    measured = Observations(seen, covariance, np.ones(seen.shape[:2], bool))
    epochs = Epochs(
        measured, model.conditions, Frames(np.tile(np.eye(3), (POSES, 1, 1)), np.zeros((POSES, 3)), free=False)
    )
    return CauseSelection(model, epochs, None, Settings(0.05, 200, 1)).run(list(catalogue_of_chains().values()))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4])
def test_a_tool_that_differs_by_its_number_is_found_at_its_link(seed: int) -> None:
    number = np.random.default_rng([seed, 1]).integers(1, 3, POSES).astype(float)
    found = [
        v for v in diagnosed(seed, "tool", number, np.array([1.5e-4, -1e-4, 5e-5])).verdicts if v.verdict == "found"
    ]
    assert [(v.cause.id, v.cause.subject, v.cause.columns) for v in found] == [("unexplained", "link tip", ("tool",))]


@pytest.mark.slow
def test_a_base_that_follows_the_humidity_is_found_to_follow_it() -> None:
    humidity = 45.0 + 8.0 * np.sin(np.arange(POSES) / 9.0 + 1.0)
    diagnosis = diagnosed(5, "relative_humidity_pct", humidity, np.array([1e-5, -5e-6, 0.0]), link="")
    found = [v for v in diagnosis.verdicts if v.verdict == "found"]
    assert [(v.cause.subject, v.cause.columns) for v in found] == [("", ("relative_humidity_pct",))]


def test_readings_are_no_inputs_of_the_place_of_a_link() -> None:
    model = campaign(np.random.default_rng(1), POSES, 3)
    places = [c for c in NonparametricChainEffect().candidates(model.scene) if not c.joint]
    assert {c.link for c in places} == {"", "tip"}
    assert not {column for c in places for column in c.columns} & set(model.conditions.columns)
