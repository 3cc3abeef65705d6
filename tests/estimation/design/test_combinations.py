"""Inseparable parameters are named with few parameters, and each named combination is unobservable."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.estimation.telescope_rows import DRHO_MM, LEGS, directions, poses, rows
from tests.tolerance import assert_close
from truing.estimation.design.observability import inseparable, observe, pivots, sparse_directions

SEEDS = st.integers(0, 2**32 - 1)
NOISE_MM, TOLERANCE_MM, TOLERANCE_U, TOLERANCE_KAPPA = 0.005, 0.5, 0.002, 0.01
NINE = ["ax", "ay", "az", "bx", "by", "bz", "ux", "uy", "l"]
SHOWN = {"l": "l", "rho0": "rho0_", "kappa": "kappa"}


def leg_observability(names, leg, wide=1.0):
    """A leg with residuals of 5 um and the tolerances of the sample campaign, or wider ones."""
    small = {"ux": TOLERANCE_U, "uy": TOLERANCE_U, "kappa": TOLERANCE_KAPPA}
    scales = np.array([wide * small.get(name, TOLERANCE_MM) for name in names])
    labels = [f"{SHOWN.get(name, f'{name[:1]}_{name[1:]}')}{leg + 1}" for name in names]
    return observe(rows(names, leg) / NOISE_MM, scales, labels)


@pytest.mark.parametrize("leg", LEGS)
def test_the_telescopes_heights_and_length_cannot_be_distinguished(leg):
    """Equation 36, corrected: z_z (a_z - b_z) + l, with z_z = 0.975 for all legs at the reference."""
    texts = [group.text for group in inseparable(leg_observability(["az", "bz", "l"], leg))]
    n = leg + 1
    assert texts == [f"only a_z{n} − b_z{n} + 1.03 l{n} is determined"]
    slope = directions(*poses(), DRHO_MM[:, leg], leg)[:, 2]
    (group,) = inseparable(leg_observability(["az", "bz", "l"], leg))
    assert_close(group.determined[0], [1.0, -1.0, 1.0 / slope.mean()], atol=np.ptp(1.0 / slope))
    assert f"only a_z{n} − b_z{n} + 1.03 l{n} is determined" in [
        group.text for group in inseparable(leg_observability(NINE, leg))
    ]


def test_rho0_is_the_height_of_the_base_joint_and_nothing_else():
    for leg in LEGS:
        found = inseparable(leg_observability([*NINE, "rho0"], leg))
        null = [t for group in found for t, s in zip(group.texts, group.sigma, strict=True) if np.isinf(s)]
        n = leg + 1
        assert null in (
            [f"a_z{n} : rho0_{n} = −1 : 1 is unobservable"],
            [f"a_z{n} : rho0_{n} = 1 : −1 is unobservable"],
        )


@pytest.mark.parametrize("leg", LEGS)
def test_kappa_and_the_direction_of_the_actuator_are_named_with_the_slope(leg):
    """a_x : u_x : kappa = -rho0 : 1 : slope, where the tolerances are no wider than 1.4 times what the data leave."""
    names, base = ["ax", "ux", "kappa", "l"], np.array([10.0, 1.0, 0.2, 10.0])
    labels, J = [f"{name}{leg + 1}" for name in names], rows(names, leg)
    found = observe(J * 0.7 / observe(J, base, labels).singular_values[-1], base, labels)
    (group,) = inseparable(found)
    assert group.labels == tuple(labels[:3])
    assert group.sigma[0] >= 1.0
    change = group.changes[0] / group.changes[0][1]
    z = directions(*poses(), DRHO_MM[:, leg], leg)
    trade = np.array([-10.0, 1.0, np.mean(z[:, 0] / z[:, 2]), 0.0])
    # the trade is exact for a leg that keeps its slope; what the slope's scatter makes of it moves the coefficients
    seen = np.linalg.norm(J @ trade)
    columns = np.linalg.norm(J[:, [0, 2]] - J[:, [0, 2]].mean(axis=0), axis=0)
    assert np.all(np.abs(change - trade[:3])[[0, 2]] < 2 * seen / columns)


@given(SEEDS)
def test_planted_null_vectors_come_out_as_they_were_planted(seed):
    """Of nine parameters, x1 = 2 x4 and x2 + 3 x5 - x7 do nothing; the rest is seen, and scales are arbitrary."""
    rng = np.random.default_rng(seed)
    planted = np.zeros((2, 9))
    planted[0, [1, 4]], planted[1, [2, 5, 7]] = (1.0, -2.0), (1.0, 3.0, -1.0)
    basis = np.linalg.svd(planted)[2][2:]
    J = 1e8 * rng.normal(size=(30, 7)) @ basis
    found = inseparable(observe(J, rng.uniform(0.5, 2.0, 9), [f"x{j}" for j in range(9)]))
    assert [group.labels for group in found] == [("x1", "x4"), ("x2", "x5", "x7")]
    for group, vector in zip(found, planted, strict=True):
        members = vector[vector != 0]
        assert_close(group.changes[0] / group.changes[0][0], members / members[0], atol=1e-6)
        assert np.isinf(group.sigma).all()
    assert found[0].text == "only x1 + 0.5 x4 is determined"
    assert found[1].text.replace("−", "-").endswith("is unobservable")


@given(SEEDS, st.integers(1, 4))
def test_directions_stay_unidentifiable_span_what_is_unseen_and_each_has_its_own(seed, weak):
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(8, 8)))[0]
    values = np.concatenate([rng.uniform(50.0, 100.0, 8 - weak), rng.uniform(0.0, 0.8, weak)])
    J = np.linalg.qr(rng.normal(size=(20, 8)))[0] @ np.diag(values) @ turn.T
    found = observe(J, np.ones(8), list("abcdefgh"))
    changes = sparse_directions(found)
    assert changes.shape == (weak, 8)
    assert np.all(found.sensitivity(changes.T) <= found.least)
    assert np.linalg.matrix_rank(changes, tol=1e-6) == weak
    own = [np.flatnonzero((changes != 0)[k] & (np.sum(changes != 0, axis=0) == 1)) for k in range(weak)]
    assert all(len(found) for found in own)
    for group in inseparable(found):
        assert np.all(group.sigma >= 1.0 - 1e-12)
        assert_close(
            group.determined @ group.changes.T, np.zeros((len(group.determined), len(group.changes))), atol=1e-6
        )
        used = [list("abcdefgh").index(label) for label in group.labels]
        spread = np.zeros((len(group.changes), 8))
        spread[:, used] = group.changes
        assert np.all(found.sensitivity(spread.T) <= found.least)  # in words it is as unseen as it is in full


def test_a_parameter_without_effect_is_unobservable_by_itself():
    found = inseparable(observe(np.diag([5.0, 0.0, 7.0])[:, [0, 1, 2]], np.ones(3), ["x", "y", "z"]))
    assert [group.text for group in found] == ["y is unobservable"]
    assert inseparable(observe(5.0 * np.eye(3), np.ones(3), ["x", "y", "z"])) == ()


def test_pivots_are_those_of_a_pivoted_qr():
    from scipy.linalg import qr

    rows_ = np.random.default_rng(3).normal(size=(4, 9))
    assert pivots(rows_) == list(qr(rows_, pivoting=True)[2][:4])
