"""Comparison of two runs of an axis: a changed size is named, chance is not, and other effects widen the difference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, kstest

from tests.runs.test_axis_corrections import model_of
from truing.runs.comparison.axis_step import axis_numbers, axis_step
from truing.runs.comparison.steps import LEVEL
from truing.simulation.axis.extended_model import ExtendedAxis
from truing.simulation.axis.periodic import AxisPeriodicError
from truing.simulation.cause import Effect

DRAWS = 200
SIGMA = 1e-7  # of every unknown of `model_of`, m or 1


def measured(rng: np.random.Generator, *shifts: float) -> ExtendedAxis:
    """The axis as one campaign finds it: lost motion and scale error with noise, the true sizes shifted."""
    model = model_of()
    away = np.array(shifts or (0.0, 0.0)) + SIGMA * rng.normal(size=2)
    effects = [Effect(e.cause, e.values + d) for e, d in zip(model.effects, away, strict=True)]
    return replace(model, effects=tuple(effects))


@pytest.mark.slow
def test_sizes_that_did_not_change_are_named_no_oftener_than_the_level_says() -> None:
    rng = np.random.default_rng(1)
    steps = [axis_step(measured(rng), measured(rng)).rows for _ in range(DRAWS)]
    z = np.array([rows["z"] for rows in steps], float)
    assert all(kstest(column, "norm").pvalue > 1e-3 for column in z.T)
    assert sum(bool(rows["changed"].any()) for rows in steps) <= binom.ppf(0.999, DRAWS, LEVEL)


def test_lost_motion_that_grew_is_named_in_the_units_of_the_tables() -> None:
    rng = np.random.default_rng(2)
    rows = axis_step(measured(rng), measured(rng, 2e-6, 0.0)).rows
    (changed,) = rows[rows["changed"]].itertuples()
    assert (changed.effect_of, changed.parameter) == ("lost-motion", "backlash")
    assert abs(changed.change - 2e-3) < 4 * changed.sigma_change  # mm
    numbers = axis_numbers(measured(rng))
    assert set(numbers["effect_of"]) == {"lost-motion", "scale-error axis"}
    assert np.isclose(numbers.loc[numbers["parameter"] == "backlash", "sigma"].item(), SIGMA / 1e-3)


def test_an_effect_that_one_run_lacks_widens_the_others_by_its_bias() -> None:
    rng = np.random.default_rng(3)
    before, now = measured(rng), measured(rng, 0.0, 5e-6)
    linked = before.covariance.copy()
    linked[1, 2] = linked[2, 1] = 0.9 * SIGMA**2  # scale and lost motion, as on a short travel from one side
    both = replace(before, covariance=linked), replace(now, covariance=linked)
    alone = replace(both[1], effects=both[1].effects[:1], covariance=linked[:2, :2])
    of_both, of_one = axis_step(*both).rows, axis_step(both[0], alone).rows
    assert list(of_one["parameter"]) == ["backlash"]
    wider = of_one["sigma_difference"].item() / of_both.set_index("parameter")["sigma_difference"]["backlash"]
    assert wider > 10.0


def test_an_axis_of_another_kind_or_without_a_common_effect_is_not_compared() -> None:
    one = model_of()
    assert axis_step(one, replace(one, axis=replace(one.axis, kind="rotary"))).why
    bare = replace(one, effects=(), covariance=one.covariance[:1, :1])
    step = axis_step(one, bare)
    assert step.why
    assert not len(step.rows)


def test_the_phase_of_a_periodic_error_is_not_tested() -> None:
    sine = AxisPeriodicError(kind_of_axis="linear", plausible=1e-5, element="measured", period=0.01)
    model = model_of()
    for_sine = np.eye(2) * SIGMA**2
    covariance = np.block([[model.covariance, np.zeros((3, 2))], [np.zeros((2, 3)), for_sine]])
    one, two = (
        replace(model, effects=(*model.effects, Effect(sine, np.array(values))), covariance=covariance)
        for values in ((3e-6, 0.0), (0.0, 3e-6))
    )
    rows = axis_step(one, two).rows.set_index("parameter")
    assert abs(rows.loc["amplitude", "z"]) < 1e-6
    assert np.isnan(rows.loc["phase", "z"])
    assert rows.loc["phase", "reason"]
    assert not rows["changed"].any()
