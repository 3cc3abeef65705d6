"""Inputs of nonparametric effects: displacements of actuators if there are legs, otherwise columns of that name."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from tests.simulation.mechanisms.made_models import named_model
from tests.tolerance import assert_close
from truing.simulation.inputs import STOPPED
from truing.simulation.mechanisms.causes.deformation import MatrixPlatformDeformation
from truing.simulation.mechanisms.causes.nonparametric import ALL_DRIVES, HISTORY, NonparametricMechanismEffect

DRIVE = NonparametricMechanismEffect(columns=("rho2_mm",), centres=(10.0,), half_ranges=(2.0,))


def state(readings, covariates):
    """Readings (B, L) in m, references of 10 mm, and columns by name."""
    legs = SimpleNamespace(rho0=np.full(readings.shape[1], 0.01))
    return SimpleNamespace(indicated=readings, legs=legs, covariates=covariates)


def test_a_drive_of_legs_is_their_displacement():
    readings = 0.01 + np.outer([0.0, 1.0, -1.0], [1.0, 2.0, 3.0])
    followed = NonparametricMechanismEffect(columns=("rho2_mm",), centres=(0.0,), half_ranges=(2.0,))
    assert_close(followed.functions(state(readings, {}))[:, 0, 0], [0.0, 1.0, -1.0], atol=1e-12)


def test_bodies_without_legs_may_have_a_column_that_is_called_like_one():
    found = DRIVE.functions(state(np.zeros((3, 0)), {"rho2_mm": np.array([8.0, 10.0, 12.0])}))
    assert_close(found[:, 0, 0], [-1.0, 0.0, 1.0], atol=1e-12)


def test_friction_of_a_leg_is_the_states_of_its_stops_and_ends_with_its_campaign():
    rng = np.random.default_rng(2)
    stops = {name: rng.uniform(-1.0, 1.0, (5, 6)) for name in STOPPED}
    friction = NonparametricMechanismEffect(
        columns=STOPPED, centres=(0.0,) * 3, half_ranges=(1.0,) * 3, form=HISTORY, degree=3, legs=(4,)
    )
    found = friction.functions(state(np.full((5, 6), 0.01), stops))
    assert_close(found[:, 3], np.stack([stops[name][:, 3] for name in STOPPED], -1), atol=0.0)
    assert friction.inputs(6) == ("rho4_mm",)
    assert friction.needs(6) == ("rho4_mm", "time_s")
    assert not friction.is_persistent
    assert [p.name for p in friction.parameters(6)] == ["leg4_stop1", "leg4_stop2", "leg4_stop3"]


def test_friction_is_claimed_of_the_legs_alone_where_it_is_clear():
    friction = NonparametricMechanismEffect(
        columns=STOPPED, centres=(0.0,) * 3, half_ranges=(1.0,) * 3, form=HISTORY, degree=3
    )
    stops, sigma = np.zeros((6, 3)), 1e-6
    stops[[1, 4]] = [[2e-5, -1e-5, 4e-6], [-1e-5, 3e-5, 1e-6]]
    clear = friction.narrowed(stops.ravel(), np.eye(18) * sigma**2, 6)
    assert (clear.subject, clear.inputs(6)) == ("leg2 leg5", ("rho2_mm", "rho5_mm"))
    assert friction.narrowed(np.full(18, 1e-5), np.eye(18) * sigma**2, 6) == friction


def test_a_dependence_that_no_data_determine_is_claimed_of_all_legs():
    friction = NonparametricMechanismEffect(
        columns=STOPPED, centres=(0.0,) * 3, half_ranges=(1.0,) * 3, form=HISTORY, degree=3
    )
    assert friction.narrowed(np.zeros(18), np.zeros((18, 18)), 6) == friction


def test_the_matrix_has_a_rival_of_one_leg_that_is_as_large_beforehand():
    """A leg that is soft, or whose joint is misplaced, errs with all drives; the platform need not bend for that."""
    scene = named_model(np.random.default_rng(0), ()).scene
    offered = [one for one in NonparametricMechanismEffect().candidates(scene) if one.form == ALL_DRIVES]
    assert [one.legs for one in offered] == [(), *((leg,) for leg in range(1, scene.legs + 1))]
    travel = float(np.abs(scene.readings - scene.rho0).max())
    kappa = MatrixPlatformDeformation().parameters(scene.legs)[0]
    for size in (travel, 0.2):  # a telescope's and a large machine's
        (plausible,) = {one.scale for one in replace(offered[1], half_ranges=(size,)).parameters(scene.legs)}
        assert plausible == max(5e-6, kappa.scale * size)
