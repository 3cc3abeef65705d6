"""Steps without real times: an effect may depend on their order, but not on time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.bench.sensor_benches import bench
from truing.report.wordings.nonparametric_wordings import columns_words
from truing.simulation.bench.causes.channels import ZeroDrift
from truing.simulation.bench.causes.load_history import Creep
from truing.simulation.bench.causes.nonparametric import NonparametricReadingEffect, fading_times
from truing.simulation.bench.causes.reading_causes import BenchScene, ReadingCause
from truing.simulation.bench.load_steps import IN_RUN, LoadSteps
from truing.simulation.inputs import ORDER, TIME, Missing

OF_TIME = {TIME, IN_RUN}


def _scene(*, is_timed: bool) -> BenchScene:
    model = bench().model()
    return model.at(replace(model.conditions, is_timed=is_timed)).scene


def _with_a_break(steps: LoadSteps) -> LoadSteps:
    """Steps, the second half of every run a day later."""
    late = steps.rank >= steps.rank.max() // 2
    return replace(steps, time_s=steps.time_s + 86400.0 * late)


def _columns(*, is_timed: bool) -> tuple[set[str], set[str]]:
    """Inputs of all effects without a name, as they act and as the tables have them."""
    scene = _scene(is_timed=is_timed)
    kind = NonparametricReadingEffect()
    single = [own.member(0, 0) for own in kind.channel_candidates(scene)]
    found = [*kind.candidates(scene), *single]
    return {name for one in found for name in one.columns}, {name for one in found for name in one.inputs(6)}


def test_effects_of_untimed_steps_follow_their_order() -> None:
    acting, reported = _columns(is_timed=False)
    assert not OF_TIME & (acting | reported)
    assert ORDER in acting & reported
    assert "order" in columns_words((ORDER,))


def test_effects_of_timed_steps_follow_time() -> None:
    acting, reported = _columns(is_timed=True)
    assert acting >= OF_TIME
    assert TIME in reported
    assert ORDER not in acting | reported


@pytest.mark.parametrize("kind", [ZeroDrift(), Creep()])
def test_rates_and_time_constants_need_recorded_times(kind: ReadingCause) -> None:
    scenes = {is_timed: _scene(is_timed=is_timed) for is_timed in (True, False)}
    assert kind.candidates(scenes[True])
    assert not kind.candidates(scenes[False])
    assert kind.missing_input(scenes[False]) is Missing.TIME


def test_untimed_steps_have_no_breaks() -> None:
    seen = np.ones(len(bench().conditions.run), bool)
    steps = {is_timed: _with_a_break(_scene(is_timed=is_timed).steps) for is_timed in (True, False)}
    assert len(fading_times(steps[True], seen))
    assert not len(fading_times(steps[False], seen))


def test_the_order_of_untimed_steps_is_that_of_all_runs() -> None:
    model = bench().model()
    counted = replace(model.conditions, time_s=model.conditions.step.astype(float), is_timed=False)
    order = model.at(counted).steps.covariates[ORDER]
    assert order.tolist() == np.arange(len(order)).tolist()
