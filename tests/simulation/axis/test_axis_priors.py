"""Prior weights of unnamed effects on an axis."""

from __future__ import annotations

import numpy as np

from truing.simulation.axis.causes import AxisScene
from truing.simulation.axis.nonparametric import HISTORY, NonparametricAxisEffect
from truing.simulation.axis.rows import COMMAND, LINEAR, Axis, AxisRows


def test_the_place_of_an_axis_and_its_history_have_a_fifth_of_its_prior_each() -> None:
    rng = np.random.default_rng(1)
    count = 60
    command = rng.uniform(0.0, 0.2, count)
    others = {"temperature_c": 20.0 + rng.normal(size=count)}
    rows = AxisRows.of(range(count), 60.0 * np.arange(count), command, 0.0, others=others)
    scene = AxisScene(Axis(LINEAR, ("motor", "load", "measured")), rows)
    weight = dict.fromkeys(("history", "place", "other"), 0.0)
    for candidate in NonparametricAxisEffect().candidates(scene):
        own = "place" if candidate.columns == (COMMAND,) else "other"
        weight["history" if candidate.form == HISTORY else own] += candidate.prior(scene)
    for own in ("history", "place"):
        assert 0.15 < weight[own] / sum(weight.values()) < 0.3
