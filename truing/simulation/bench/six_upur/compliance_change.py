"""How a sensor's compliance follows what is not known of it: the five length errors of each leg, and its elasticity.

Derivatives are those of the sensor as it is assembled: a length error moves the platform to where its legs close, turns
all six of them, and moves what lies in between. `dC = -C dK C` for all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.estimation.rotation import skew
from truing.simulation.bench.six_upur.assembly import SOURCES, closed_loop_map
from truing.simulation.bench.six_upur.geometry import JointCentres, leg_axes, outward
from truing.simulation.bench.six_upur.stiffness import ElasticSensor

_UPPER, _BASE, _MIDDLE, _INSTALLED = (SOURCES.index(name) for name in (
    "platform_radius", "base_radius", "middle_clearance", "sensor_installation"))  # fmt: skip


@dataclass(frozen=True)
class ComplianceChange:
    """Derivatives of a platform's compliance.

    by_source: (6, 5, 6, 6), by leg and error source, per m; by_stiffness: (6, P, 6, 6), by leg and the logarithm of
    the elastic parameter of each part: where it is the same in all legs, their sum is the derivative.
    """

    by_source: NDArray
    by_stiffness: NDArray


@dataclass(frozen=True)
class JointMotion:
    """How joint centres move with P parameters, m per unit: lower and arm (6, 3, P), origin (3, P)."""

    lower: NDArray
    arm: NDArray
    origin: NDArray


def compliance_change(sensor: ElasticSensor) -> ComplianceChange:
    """Return the derivatives of an unloaded sensor's compliance."""
    motion = motion_of_sources(sensor.joints)
    by_source = _by_motion(sensor, motion) + _by_length(sensor)
    by_stiffness = _with_leg_compliance(sensor, -sensor.parts.compliance)
    return ComplianceChange(by_source.reshape(6, len(SOURCES), 6, 6), by_stiffness)


def motion_of_sources(joints: JointCentres) -> JointMotion:
    """Return how the joints of an assembled sensor move with the error sources (P = 30, leg by leg)."""
    legs, sources = 6, len(SOURCES)
    moved = closed_loop_map(joints).reshape(6, legs * sources)
    lower, arm = np.zeros((2, legs, 3, legs, sources))
    own = np.arange(legs)
    lower[own, :, own, _BASE] = outward(joints.lower)
    arm[own, :, own, _UPPER] = outward(joints.arm)
    turned = -skew(joints.arm) @ moved[3:]
    flat = (legs, 3, legs * sources)
    return JointMotion(lower.reshape(flat), arm.reshape(flat) + turned, moved[:3])


def influence_change(joints: JointCentres, motion: JointMotion) -> NDArray:
    """Return the derivative (P, 6, 6) of G by what moves the joints."""
    S, turn = joints.direction, _turn_across(joints, motion)
    moved = np.cross(turn, S[..., None], axis=-2)
    moment = np.cross(motion.arm, S[..., None], axis=-2) + np.cross(joints.arm[..., None], moved, axis=-2)
    return np.moveaxis(np.concatenate([moved, moment], -2), (0, 1, 2), (2, 1, 0))


def common_to_legs(change: NDArray) -> NDArray:
    """Return derivatives (P, 6, 6) by parameters that all legs share, of those leg by leg (6, P, 6, 6)."""
    return change.sum(0)


def change_as_a_whole(compliance: NDArray) -> NDArray:
    """Return the derivative (1, 6, 6) of a given compliance by the logarithm of one stiffness for all of it."""
    return -compliance[None]


def compliance_covariance(change: NDArray, sigma: ArrayLike) -> NDArray:
    """Return the covariance (36, 36) of a compliance, row by row, by independent parameters.

    change: derivatives (..., 6, 6), any number of axes of parameters first; sigma: their standard deviations, of those
    axes' shape.
    """
    weighed = np.broadcast_to(np.asarray(sigma, float)[..., None, None], change.shape) * change
    flat = weighed.reshape(-1, 36)
    return flat.T @ flat


def _by_motion(sensor: ElasticSensor, motion: JointMotion) -> NDArray:
    """Return the derivative (P, 6, 6) by motions of the joints, the legs' own compliance as it is.

    A wrench's transport changes like the axes it is a transport between: dJ_F = X J_F with X of the twist (w; v) of the
    leg's end, v as seen from the origin.
    """
    turn = _leg_turns(sensor.joints, motion)
    shift = motion.arm - np.cross(turn, sensor.joints.arm[..., None], axis=-2)
    X = _twist_matrix(np.moveaxis(turn, -1, 0), np.moveaxis(shift, -1, 0))
    half = np.sum(X @ sensor.leg_stiffness, -3)
    return _through(sensor, half + np.swapaxes(half, -1, -2))


def _by_length(sensor: ElasticSensor) -> NDArray:
    """Return the derivative (30, 6, 6) by what lengthens the legs between their parts."""
    found = np.zeros((6, len(SOURCES), 6, 6))
    changes = np.stack([sensor.parts.by_middle.sum(-3), sensor.parts.by_installed.sum(-3)], -3)
    found[:, [_MIDDLE, _INSTALLED]] = _with_leg_compliance(sensor, changes)
    return found.reshape(-1, 6, 6)


def _with_leg_compliance(sensor: ElasticSensor, change: NDArray) -> NDArray:
    """Return the derivative (6, Q, 6, 6) of the platform's compliance by changes (6, Q, 6, 6) of each leg's own."""
    inverse = np.linalg.inv(sensor.parts.compliance.sum(-3))
    through = inverse @ np.swapaxes(sensor.leg_transport, -1, -2) @ sensor.compliance
    return np.swapaxes(through, -1, -2)[:, None] @ change @ through[:, None]


def _through(sensor: ElasticSensor, stiffness_change: NDArray) -> NDArray:
    return -sensor.compliance @ stiffness_change @ sensor.compliance


def _twist_matrix(turn: NDArray, shift: NDArray) -> NDArray:
    """Return [[ [w]x, 0 ], [ [v]x, [w]x ]] (..., 6, 6) of turns w and shifts v (..., 3)."""
    w, v = skew(turn), skew(shift)
    upper = np.concatenate([w, np.zeros_like(w)], -1)
    return np.concatenate([upper, np.concatenate([v, w], -1)], -2)


def _turn_across(joints: JointCentres, motion: JointMotion) -> NDArray:
    """Return the legs' turns (6, 3, P), rad per unit, across themselves."""
    apart = (motion.origin + motion.arm - motion.lower) / joints.length[:, None, None]
    return np.cross(joints.direction[..., None], apart, axis=-2)


def _leg_turns(joints: JointCentres, motion: JointMotion) -> NDArray:
    """Return the turns (6, 3, P), rad per unit, of the legs' axes, whose x stays horizontal.

    An azimuth about the vertical and a tilt about x; a vertical leg keeps its x, and tilts about both.
    """
    across = _turn_across(joints, motion)
    axes = leg_axes(joints.direction)
    x, y, z = axes[..., 0], axes[..., 1], axes[..., 2]
    lean = np.sqrt(z[:, 0] ** 2 + z[:, 1] ** 2)
    about_x, about_y = (np.einsum("li,lip->lp", axis, across) for axis in (x, y))
    upright = lean == 0.0
    spin = np.where(upright, 0.0, z[:, 2] / np.where(upright, 1.0, lean))[:, None] * about_y
    return x[..., None] * about_x[:, None] + y[..., None] * about_y[:, None] + z[..., None] * spin[:, None]
