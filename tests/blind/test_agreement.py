"""Generator and ``truing.simulation``, written twice from the same physics, agree where no effect is hidden.

Both know the same geometry and the same displacements; they may differ by a tenth of the noise (0.5 um) and differ
by rounding alone, some 1e-12 of half a metre carried through the closure.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.blind.generator.campaign import Campaign, draw_campaign
from tests.blind.generator.effects import ActuatorGain, Effect, LinearDeformation, MatrixDeformation
from tests.blind.generator.layout import DataFaults, Layout, Noise, noiseless, telescope_geometry
from tests.blind.generator.schedule import published_moves
from tests.blind.generator.telescope import PUBLISHED_K
from tests.tolerance import assert_close
from truing.estimation.rotation import exp_so3
from truing.simulation.kinematics import forward, inverse
from truing.simulation.legs import Legs
from truing.simulation.mechanisms import mechanism

EXACT = Layout(name="exact", noise=noiseless(Noise()), faults=DataFaults(0.0, 0.0), decimals=12)
OTHER = replace(
    EXACT,
    geometry=telescope_geometry(
        base_radius=260.0,
        platform_radius=200.0,
        base_half_separation_deg=14.0,
        platform_half_separation_deg=8.0,
        length=420.0,
    ),
)
TENTH_OF_NOISE_M = 0.5e-6
ROUNDING_M, ROUNDING_RAD = 1e-10, 1e-10
KAPPA = np.array([0.014, 0.011, 0.009, 0.013, 0.010, 0.012])

CASES: dict[str, tuple[Layout, list[Effect]]] = {
    "plain": (EXACT, []),
    "another geometry": (OTHER, []),
    "linear": (EXACT, [LinearDeformation(KAPPA)]),
    "matrix": (EXACT, [MatrixDeformation(PUBLISHED_K)]),
    "gain": (OTHER, [ActuatorGain(0.01 * np.ones(6))]),
}


def _legs(campaign: Campaign) -> Legs:
    built = campaign.truth.built
    return mechanism("6-pus", built.a / 1e3, built.b / 1e3, built.u, built.length / 1e3, built.rho0 / 1e3)


@pytest.fixture(params=CASES, scope="module")
def campaign(request: pytest.FixtureRequest) -> Campaign:
    layout, effects = CASES[request.param]
    return draw_campaign(layout, published_moves(), effects, np.random.default_rng(11))


def test_both_put_the_platform_in_the_same_place(campaign: Campaign) -> None:
    truth, legs = campaign.truth, _legs(campaign)
    assert ROUNDING_M < TENTH_OF_NOISE_M
    found = forward(legs, legs.rho0 + truth.drho / 1e3, truth.delta_bz / 1e3)
    assert found.converged.all()
    assert_close(found.p, truth.position / 1e3, atol=ROUNDING_M, what="position, m")
    assert_close(found.R, exp_so3(truth.rotation_vector), atol=ROUNDING_RAD, what="rotation")


def test_both_find_the_readings_of_a_pose(campaign: Campaign) -> None:
    truth, legs = campaign.truth, _legs(campaign)
    found = inverse(legs, truth.position / 1e3, exp_so3(truth.rotation_vector), truth.delta_bz / 1e3)
    assert_close(found - legs.rho0, truth.drho / 1e3, atol=ROUNDING_M, what="displacements, m")
