"""Loads beyond the range in a declared overload test."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from tests.sentences import assert_says
from tests.tolerance import assert_close
from truing.schemas.sections import Loading
from truing.simulation.bench.causes.stiffness import Hysteresis
from truing.stages.quality.check import CampaignLimits
from truing.stages.quality.steps_and_surroundings import load_range


def test_an_overload_check_gives_the_largest_load_over_the_range():
    load = np.zeros((3, 6))
    load[:, 2] = 0.0, 12000.0, -3000.0
    view = SimpleNamespace(steps=SimpleNamespace(load=load))
    loading = Loading(fz_n=10000.0, overload=1.3)
    (row,) = load_range(view, loading, CampaignLimits("interferometer"))
    assert (row.verdict, row.value) == ("pass", 1.2)
    assert_says(row.message, "fz", "120 %", "range")
    assert_says(row.message, "overload test", "130 %")


def test_a_loop_is_closed_beyond_the_largest_load():
    share = np.array([[0.5], [1.0], [1.2], [-1.2]])
    steps = SimpleNamespace(unloading=np.ones_like(share, bool), share=share)
    assert_close(Hysteresis("fz").course(steps)[:, 0], [2.0, 0.0, 0.0, 0.0], atol=1e-15)
