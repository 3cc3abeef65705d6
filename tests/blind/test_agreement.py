"""The generator and ``truing.simulation``, written independently, agree if no effect is hidden.

Both know the same geometry and the same displacements; they may differ by a tenth of the noise (0.5 um) and differ
by rounding alone, some 1e-12 of half a metre carried through the closure.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.blind.generator.campaign import Campaign, draw_campaign
from tests.blind.generator.effects import ActuatorGain, Effect, LinearDeformation, MatrixDeformation
from tests.blind.generator.layout import DataFaults, Layout, Noise, Surroundings, noiseless, telescope_geometry
from tests.blind.generator.quaternions import rotate, with_axis
from tests.blind.generator.schedule import published_moves
from tests.blind.generator.telescope import PUBLISHED_K
from tests.tolerance import assert_close
from truing.estimation.rotation import exp_so3, log_so3
from truing.simulation.mechanisms.forward_pass import simulate
from truing.simulation.mechanisms.legs.closures import Legs, mechanism
from truing.simulation.mechanisms.legs.kinematics import forward, inverse, leg_vectors, unit
from truing.simulation.mechanisms.recording import leg_frames, positions
from truing.simulation.mechanisms.state import State
from truing.simulation.targets import BASE, LEG, PLATFORM, Targets

EXACT = Layout(
    name="exact",
    noise=noiseless(Noise()),
    faults=DataFaults(0.0, 0.0),
    surroundings=Surroundings(frame_turn_rad=0.0, frame_shift_mm=0.0),
)
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


def test_both_see_every_target_in_the_same_place(campaign: Campaign) -> None:
    """All bodies and poses to a tenth of the noise; to rounding but for a leg's roll, which no closure fixes."""
    legs, truth, measured = _legs(campaign), campaign.truth, campaign.record.points / 1e3
    at_rest = simulate(legs, legs.rho0[None])
    upright = unit(leg_vectors(legs, at_rest.p, at_rest.R, at_rest.rho))[0]
    state = _state(legs, truth.drho / 1e3, truth.delta_bz / 1e3)
    targets = _targets(campaign)
    state = replace(state, shape=_upright_shape(campaign, upright), moved=np.zeros((1, 1, 3)))
    directions = unit(leg_vectors(legs, state.p, state.R, state.rho, state.delta_bz))
    # truing counts the platform's twist from the base's axes, the generator from the reference configuration.
    roll = -0.5 * np.einsum("bli,bi->bl", directions, log_so3(at_rest.R))
    found = positions(state, targets, leg_frames(state, upright, roll))
    assert_close(found, measured, atol=TENTH_OF_NOISE_M, what="points, m")

    frames = leg_frames(state, upright, roll + _remaining_roll(campaign, found, measured, directions))
    assert_close(positions(state, targets, frames), measured, atol=ROUNDING_M, what="points but for the roll, m")


def _state(legs: Legs, delta_rho: NDArray, delta_bz: NDArray) -> State:
    reached = forward(legs, legs.rho0 + delta_rho, delta_bz)
    return State(legs, legs.rho0 + delta_rho, delta_bz, reached.p, reached.R, reached.converged)


def _targets(campaign: Campaign) -> Targets:
    marks = campaign.marks
    legs = [int(body[3:]) if body.startswith("leg") else on for body, on in zip(marks.body, marks.on_leg, strict=True)]
    kinds = [{"base": BASE, "platform": PLATFORM}.get(body, LEG) for body in marks.body]
    return Targets(body=np.array(kinds), leg=np.array(legs) - 1)


def _upright_shape(campaign: Campaign, upright: NDArray) -> NDArray:
    """The surveyed places (K, 3), m, those of the legs turned from their own axes into the reference configuration."""
    shape = campaign.surveyed / 1e3
    for leg in range(6):
        own = campaign.marks.of(f"leg{leg + 1}")
        shape[own] = rotate(with_axis(upright[leg]), shape[own])
    return shape


def _remaining_roll(campaign: Campaign, found: NDArray, measured: NDArray, directions: NDArray) -> NDArray:
    """The turn (B, L) of each leg about its direction that brings its targets from found to measured, rad."""
    rolls = []
    for leg in range(6):
        own = campaign.marks.of(f"leg{leg + 1}")
        tangent = np.cross(directions[:, leg, None], found[:, own] - found[:, own].mean(axis=1, keepdims=True))
        gap = measured[:, own] - found[:, own]
        gap = gap - gap.mean(axis=1, keepdims=True)
        rolls.append(np.sum(tangent * gap, axis=(1, 2)) / np.sum(tangent**2, axis=(1, 2)))
    return np.stack(rolls, axis=1)
