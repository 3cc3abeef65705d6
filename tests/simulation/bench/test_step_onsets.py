"""Onsets of slips and steps of a long bench campaign: every few are tried, and all others lie between them."""

from __future__ import annotations

import numpy as np
import pytest

from truing.simulation.bench.causes.counts import FringeSlip
from truing.simulation.bench.causes.reading_causes import FEWEST_READINGS, BenchScene
from truing.simulation.bench.causes.zero_step import ZeroStep
from truing.simulation.bench.load_steps import LoadSteps

RUNS, STEPS = 60, 30
CHANNELS = ("dx", "dy", "dz", "rx", "ry", "rz")


def _scene() -> BenchScene:
    count = RUNS * STEPS
    run, step = np.repeat(np.arange(1, RUNS + 1), STEPS), np.tile(np.arange(1, STEPS + 1), RUNS)
    steps = LoadSteps(
        run, step, np.arange(float(count)), np.ones((count, 6)), np.ones(count), {}, CHANNELS, np.ones(6),
        np.zeros((count, 6)), np.zeros((count, 0)), 6.3e-7,
    )  # fmt: skip
    return BenchScene(steps)


def _tried(kind: FringeSlip | ZeroStep, scene: BenchScene) -> list[FringeSlip | ZeroStep]:
    if isinstance(kind, FringeSlip):
        return list(kind.candidates(scene))
    family = kind.channel_candidates(scene)[-1]  # all displacements together
    return [family.member(0, shape) for shape in np.flatnonzero(family.usable[:, 0])]


@pytest.mark.slow
@pytest.mark.parametrize("kind", [FringeSlip(), ZeroStep()], ids=lambda kind: kind.id)
def test_every_step_with_readings_on_either_side_is_reached_from_one_that_is_tried(kind: FringeSlip | ZeroStep) -> None:
    scene = _scene()
    tried = _tried(kind, scene)
    reached = set()
    for cause in tried:
        onsets = scene.onsets(cause)
        assert onsets is not None
        assert onsets.moved(0) == cause
        assert onsets.spacing > 1
        reached |= {onsets.moved(by) for by in range(1 - onsets.spacing, onsets.spacing)} - {None}
    found = {(cause.run, cause.from_step) for cause in reached if cause is not None}
    assert found == {
        (run, step + 1) for run in range(1, RUNS + 1) for step in range(FEWEST_READINGS, STEPS - FEWEST_READINGS + 1)
    }
    if isinstance(kind, FringeSlip):
        assert {cause.channel for cause in reached if isinstance(cause, FringeSlip)} == {"dx", "dy", "dz"}
    assert all(cause.from_rank + 1 == cause.from_step for cause in reached if cause is not None)
