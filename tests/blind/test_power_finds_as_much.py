"""Effects of `truing power` are found as often as those of the independent generator, size by size.

A few kinds of cause are searched, so that a diagnosis takes little; ``python -m benchmarks.power_agreement`` searches
the whole catalogue in more layouts. ``TRUING_BLIND_SEED`` draws other campaigns; a simulation that is right fails once
in a thousand draws, one that shows effects half as strongly nearly always.
"""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np
import pyarrow as pa
import pytest

from tests.blind.generator.layout import DataFaults, Layout, Noise, Surroundings, Targets
from tests.blind.hidden_twice import Ground, as_hidden
from tests.blind.judging import UNLUCKY
from tests.blind.two_rates import Pair, unlike
from truing.inference.detectable import effect_sensitivities
from truing.inference.fitter import Fitter
from truing.inference.search_candidates import search_of
from truing.inference.selection import CauseSelection
from truing.inference.verdicts import FOUND
from truing.schemas.campaign import Campaign
from truing.simulation.cause import Effect
from truing.simulation.detection_trials import questions
from truing.simulation.mechanisms.causes.drive import ActuatorGain
from truing.simulation.mechanisms.causes.leg_drift import LegDrift
from truing.simulation.mechanisms.causes.measurement_scale import MeasurementScale
from truing.simulation.mechanisms.causes.targets import TargetMoved
from truing.simulation.mechanisms.causes.warmth import LegThermal
from truing.stages.diagnosis.search import assembled_data, rule_of

SEED = int(os.environ.get("TRUING_BLIND_SEED", "1"))
EACH = 4
KINDS = [ActuatorGain(), LegThermal(), MeasurementScale(), TargetMoved()]
LAYOUT = Layout(
    "small",
    targets=Targets(base=5, platform=4, per_leg=0),
    noise=Noise(0.006),
    faults=DataFaults(0.0, 0.0),
    surroundings=Surroundings(temperature_step_c=0.3),
)


@pytest.fixture(scope="module")
def ground() -> Ground:
    return Ground(LAYOUT, 14, 0, SEED)


@pytest.fixture(scope="module")
def hidden(ground: Ground) -> list[list[Effect]]:
    """Effects of every sort that the kinds have, of the size that theory expects to be found four times out of five."""
    gathered = assembled_data(ground.power_tables([], 0), ground.settings)
    stand = Fitter(gathered.model, gathered.calibration, None, 0).prepared()
    search = search_of(stand, KINDS, 400, np.random.default_rng(0))
    seen = effect_sensitivities(search, rule_of(ground.settings).level)
    asked = questions(ground.plan, seen, [kind.id for kind in KINDS], KINDS)
    rng = np.random.default_rng([SEED, 1])
    return [[question.kind.draw(question.expected or 0.0, 6, rng) for _ in range(EACH)] for question in asked]


def _finds(tables: Mapping[str, pa.Table], settings: Campaign) -> bool:
    own = assembled_data(tables, settings)
    search = CauseSelection(own.model, own.calibration, own.held_out, rule_of(settings), lambda _: None, own.given)
    return any(verdict.verdict == FOUND for verdict in search.run(KINDS).verdicts)


def test_both_generators_give_effects_that_are_found_equally_often(ground: Ground, hidden: list[list[Effect]]) -> None:
    pairs = []
    for sort, effects in enumerate(hidden):
        drawn = [_finds(ground.power_tables([e], sort, k), ground.settings) for k, e in enumerate(effects)]
        generated = [_finds(ground.generated_tables([e], sort, k), ground.settings) for k, e in enumerate(effects)]
        pairs.append(Pair(sum(drawn), EACH, sum(generated), EACH))
    both = sum(pair.first + pair.second for pair in pairs)
    assert 0 < both < 2 * EACH * len(pairs), "sizes at which some are found and some are not"
    assert unlike(pairs) > UNLUCKY, pairs


EFFECTS = [
    Effect(ActuatorGain((2,)), np.array([0.004])),
    Effect(LegDrift((), 0.0, 3600.0, 900.0), np.full(6, 1e-5)),
    Effect(MeasurementScale("both"), np.array([3e-5, 1e-5])),
    Effect(TargetMoved("platform", "P02", 3, 3.0), np.array([1e-5, -2e-5, 0.0])),
]


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: str(effect.cause.id))
def test_the_generators_effect_is_the_catalogues(effect: Effect, ground: Ground) -> None:
    """Parameters carry over with their units, and the subject with them."""
    made = as_hidden(effect, ground.settings)
    reported = effect.cause.reported(effect.values, np.zeros((len(effect.values),) * 2), 6)
    parameters = made.parameters()
    assert {row.name: row.unit for row in reported} == {name: unit for name, (_, unit) in parameters.items()}
    assert {row.name: row.value for row in reported} == pytest.approx({name: v for name, (v, _) in parameters.items()})
    assert (made.id, made.subject) == (effect.cause.id, effect.cause.subject)


def test_campaigns_of_one_ground_share_places_and_times_and_nothing_else(ground: Ground) -> None:
    first, second = ground.generated([], 1), ground.generated([], 2)
    framing = np.flatnonzero(np.array(first.marks.on_leg) == 0)
    assert np.array_equal(first.marks.place[framing], second.marks.place[framing])
    assert np.array_equal(first.schedule.temperature_c, second.schedule.temperature_c)
    assert not np.any(first.truth.built.a == second.truth.built.a)
    assert not np.any(first.record.points == second.record.points)
