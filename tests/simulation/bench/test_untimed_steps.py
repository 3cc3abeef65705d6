"""Steps whose times only count them: an effect follows their order, and no time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.simulation.bench.sensor_benches import bench
from truing.report.wordings.nonparametric_wordings import columns_words
from truing.simulation.bench.causes.nonparametric import NonparametricReadingEffect
from truing.simulation.bench.load_steps import IN_RUN
from truing.simulation.inputs import ORDER, TIME

OF_TIME = {TIME, IN_RUN}


def _columns(*, is_timed: bool) -> tuple[set[str], set[str]]:
    """Inputs of all effects without a name, as they act and as the tables have them."""
    model = bench().model()
    scene = model.at(replace(model.conditions, is_timed=is_timed)).scene
    kind = NonparametricReadingEffect()
    single = [own.member(0, 0) for own in kind.channel_candidates(scene)]
    found = [*kind.candidates(scene), *single]
    return {name for one in found for name in one.columns}, {name for one in found for name in one.inputs(6)}


def test_effects_of_untimed_steps_follow_their_order() -> None:
    acting, told = _columns(is_timed=False)
    assert not OF_TIME & (acting | told)
    assert ORDER in acting & told
    assert "order" in columns_words((ORDER,))


def test_effects_of_timed_steps_follow_time() -> None:
    acting, told = _columns(is_timed=True)
    assert acting >= OF_TIME
    assert TIME in told
    assert ORDER not in acting | told


def test_the_order_of_untimed_steps_is_that_of_all_runs() -> None:
    model = bench().model()
    counted = replace(model.conditions, time_s=model.conditions.step.astype(float), is_timed=False)
    order = model.at(counted).steps.covariates[ORDER]
    assert order.tolist() == np.arange(len(order)).tolist()
