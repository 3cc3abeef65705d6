"""Error curves of joints: laws of their basis functions, and recovery of a curve from poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from truing.simulation.mechanisms.chains.joint_curves import JointErrorCurve
from truing.simulation.mechanisms.chains.nonparametric import HISTORY, NonparametricChainEffect
from truing.simulation.nonparametric import POLYNOMIAL

_TURN = 2.0 * np.pi
CURVE = JointErrorCurve(joints=("j",), starts=(0.0,), periods=(_TURN,), knots=(36,))


def test_a_bump_has_neither_mean_nor_trend() -> None:
    readings = np.linspace(0.0, _TURN, 3600, endpoint=False)
    basis = CURVE.basis(readings, 0)
    step = readings[1]
    np.testing.assert_allclose(basis.sum(0) * step, 0.0, atol=1e-12)
    inner = basis[:, 18]  # the others reach over the end of the turn
    np.testing.assert_allclose(readings @ inner * step, 0.0, atol=1e-12)
    assert readings**2 @ inner * step == pytest.approx(-2.0 * (_TURN / 36) ** 3, rel=1e-6)


def test_a_curve_repeats_with_every_turn() -> None:
    readings = np.random.default_rng(0).uniform(-9.0, 9.0, 50)
    np.testing.assert_allclose(CURVE.basis(readings + _TURN, 0), CURVE.basis(readings, 0), atol=1e-9)


def test_a_curve_of_a_joint_that_slides_is_held_at_the_ends_of_its_travel() -> None:
    curve = JointErrorCurve(joints=("j",), starts=(0.5,), periods=(1.2,), knots=(36,), is_angle=False)
    low, high = curve.basis(np.array([0.5, 1.5]), 0)
    np.testing.assert_allclose(curve.basis(np.array([0.1, 9.0]), 0), [low, high])


def test_curves_return_their_values_and_show_where_nothing_is_known() -> None:
    values = np.zeros(36)
    values[9] = 1e-4
    covariance = np.diag(np.where(np.arange(36) < 18, 1e-12, (CURVE.reach * 1e-4) ** 2))
    (found,) = CURVE.curves(values, covariance)
    top = int(np.argmax(found.deviation))
    assert found.readings[top] == pytest.approx(_TURN / 4)
    assert found.deviation[top] == pytest.approx(1e-4)  # 2 x 2/3 - 2 x 1/6 of the height
    known, near = found.is_determined, 3 * _TURN / 36  # a bump reaches three knots to either side
    assert known[(found.readings > near) & (found.readings < _TURN / 2 - near)].all()
    assert not known[(found.readings > _TURN / 2 + near) & (found.readings < _TURN - near)].any()


def test_curves_of_a_joint_exclude_each_other() -> None:
    both = JointErrorCurve(joints=("j", "k"), starts=(0.0, 0.0), periods=(_TURN, _TURN), knots=(72, 36))
    assert both.excludes(CURVE)
    assert CURVE.excludes(both)
    assert not CURVE.excludes(JointErrorCurve(joints=("k",), starts=(0.0,), periods=(_TURN,), knots=(72,)))


def test_a_curve_excludes_a_smooth_effect_of_its_joints_own_reading() -> None:
    curve = JointErrorCurve(joints=("j1", "j2"), starts=(0.0, 0.0), periods=(6.28, 6.28), knots=(36, 36))
    own = NonparametricChainEffect(columns=("j2_rad",), form=POLYNOMIAL, joint="j2")
    assert curve.excludes(own)
    assert not curve.excludes(replace(own, columns=("j1_rad",)))  # a dependence on another joint is no curve
    assert not curve.excludes(replace(own, joint="j3", columns=("j3_rad",)))
    assert not curve.excludes(replace(own, form=HISTORY))
