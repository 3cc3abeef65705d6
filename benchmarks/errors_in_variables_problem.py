"""The calibration problem that `benchmarks.errors_in_variables` gives to every library, with one common derivative.

Unknowns are 42 values {a_x, a_y, b_x, b_y, u_x, u_y, l} of six legs on linear actuators, and 6 deviations per pose.
Values count in tolerances from the nominal, deviations in sigmas. Residuals are those deviations, decorrelated, the
readings that the legs ask for against what was read, and the values themselves, all in sigmas.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace

import numpy as np

from truing.estimation.rotation import exp_so3, skew
from truing.simulation.mechanisms.legs.closures import Legs, mechanism
from truing.simulation.mechanisms.legs.kinematics import forward

TOLERANCE = np.tile([5e-4, 5e-4, 5e-4, 5e-4, 2e-3, 2e-3, 5e-4], 6)  # m, 1
POSE_SIGMA = np.array([2e-6] * 3 + [1e-5] * 3)  # m, rad
READING_SIGMA = 1e-6  # m
_LEG = np.arange(6)


def nominal() -> Legs:
    """Return six inclined legs of half a metre on actuators along z, on circles of 0.3 and 0.2 m."""
    around = np.deg2rad([0.0, 60.0, 120.0, 180.0, 240.0, 300.0])
    turn = np.deg2rad([25.0, -25.0] * 3)
    base = np.stack([0.3 * np.cos(around), 0.3 * np.sin(around), np.zeros(6)], 1)
    top = np.stack([0.2 * np.cos(around + turn), 0.2 * np.sin(around + turn), np.zeros(6)], 1)
    return mechanism("6-pus", base, top, None, np.full(6, 0.5), np.full(6, 0.01))


@dataclass(frozen=True)
class Joint:
    """Measured poses p (B, 3), R (B, 3, 3), readings rho (B, 6), and the poses' covariance (B, 6, 6); m, rad."""

    legs: Legs
    p: np.ndarray
    R: np.ndarray
    rho: np.ndarray
    covariance: np.ndarray

    @property
    def start(self) -> np.ndarray:
        """Return the nominal values (42,)."""
        legs = self.legs
        return np.column_stack([legs.a[:, :2], legs.b[:, :2], legs.u[:, :2], legs.l]).ravel()

    @cached_property
    def whitener(self) -> np.ndarray:
        """Return the whitening matrices (B, 6, 6) of the poses' deviations, which count in sigmas."""
        return np.linalg.inv(np.linalg.cholesky(self.covariance)) * POSE_SIGMA

    def machine(self, values: np.ndarray) -> Legs:
        """Return the legs with other values (42,)."""
        v = values.reshape(6, 7)
        u = np.column_stack([v[:, 4:6], np.sqrt(1.0 - v[:, 4] ** 2 - v[:, 5] ** 2)])
        a, b = (np.column_stack([v[:, k : k + 2], z]) for k, z in ((0, self.legs.a[:, 2]), (2, self.legs.b[:, 2])))
        return self.legs.replace(a=a, b=b, u=u, l=v[:, 6])


def turned(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rotations and left Jacobians (B, 3, 3), to rounding, of vectors (B, 3) of less than 1e-2 rad."""
    K, x = skew(theta), np.einsum("bi,bi->b", theta, theta)[:, None, None]
    K2, I = K @ K, np.eye(3)  # noqa: E741
    half = 0.5 - x / 24 + x**2 / 720
    return I + (1 - x / 6 + x**2 / 120) * K + half * K2, I + half * K + (1 / 6 - x / 120 + x**2 / 5040) * K2


def placed(problem: Joint, legs: Legs, twist: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the rotations R (B, 3, 3) after a twist (B, 6), and the twist's left Jacobians (B, 3, 3).

    Then the arms R b (B, 6, 3) and p + R b - a (B, 6, 3), m.
    """
    turn, left = turned(twist[:, 3:])
    R = turn @ problem.R
    arms = legs.b @ np.swapaxes(R, 1, 2)
    return R, left, arms, (problem.p + twist[:, :3])[:, None] + arms - legs.a


def required_readings(legs: Legs, h: np.ndarray) -> np.ndarray:
    """Return the readings (B, 6) that legs ask for, h = p + R b - a."""
    along = np.einsum("bli,li->bl", h, legs.u)
    return along - np.sqrt(along**2 - np.einsum("bli,bli->bl", h, h) + legs.l**2)


def slopes(
    legs: Legs, R: np.ndarray, left: np.ndarray, arms: np.ndarray, z: np.ndarray, rho: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Return the derivatives of l minus each leg's length, the one by twist (B, 6, 6) with its sign reversed.

    Then by the leg's seven values (B, 6, 7) and by its reading (B, 6). z (B, 6, 3): unit vectors along the legs.
    """
    by_twist = np.empty((*rho.shape, 6))
    by_twist[..., :3] = z
    by_twist[..., 3:] = _crossed(arms, z) @ left
    own = np.empty((*rho.shape, 7))
    own[..., :2], own[..., 6] = z[..., :2], 1.0
    own[..., 2:4] = -(z @ R)[..., :2]
    own[..., 4:6] = rho[..., None] * (z[..., :2] - z[..., 2:] * (legs.u[:, :2] / legs.u[:, 2:]))
    return by_twist, own, np.einsum("bli,li->bl", z, legs.u)


def _crossed(v: np.ndarray, w: np.ndarray) -> np.ndarray:
    (a, b, c), (d, e, f) = np.moveaxis(v, -1, 0), np.moveaxis(w, -1, 0)
    return np.stack([b * f - c * e, c * d - a * f, a * e - b * d], -1)


def spread_legs(own: np.ndarray) -> np.ndarray:
    """Return derivatives (B, 6, 42) by all values from those by each leg's own (B, 6, 7)."""
    out = np.zeros((len(own), 6, 6, 7))
    out[:, _LEG, _LEG] = own
    return out.reshape(len(own), 6, 42)


def constrain(problem: Joint, values: np.ndarray, deviation: np.ndarray) -> SimpleNamespace:
    """Return the implicit equations l - |p + R b - a - rho u| and their derivatives, as our fit takes them."""
    legs, rho = problem.machine(values), problem.rho + deviation[:, 6:]
    R, left, arms, h = placed(problem, legs, deviation[:, :6])
    g = h - rho[..., None] * legs.u
    length = np.sqrt(np.einsum("bli,bli->bl", g, g))
    by_twist, own, by_rho = slopes(legs, R, left, arms, g / length[..., None], rho)
    A = np.zeros((len(rho), 6, 12))
    A[..., :6] = -by_twist
    A[:, _LEG, 6 + _LEG] = by_rho
    return SimpleNamespace(value=legs.l - length, by_deviation=A, by_values=spread_legs(own))


def residuals(problem: Joint, x: np.ndarray, e: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the residuals of poses (B, 6), of readings (B, 6) and of values (42,) at unknowns x (42,), e (B, 6)."""
    legs = problem.machine(problem.start + TOLERANCE * x)
    rho = required_readings(legs, placed(problem, legs, POSE_SIGMA * e)[3])
    return (problem.whitener @ e[..., None])[..., 0], (rho - problem.rho) / READING_SIGMA, x


def reading_slopes(problem: Joint, x: np.ndarray, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of the readings' residuals by the values (B, 6, 42) and by the pose's own e (B, 6, 6)."""
    legs = problem.machine(problem.start + TOLERANCE * x)
    R, left, arms, h = placed(problem, legs, POSE_SIGMA * e)
    rho = required_readings(legs, h)
    by_twist, own, by_rho = slopes(legs, R, left, arms, (h - rho[..., None] * legs.u) / legs.l[:, None], rho)
    factor = 1 / (READING_SIGMA * by_rho)[..., None]
    return -spread_legs(factor * own) * TOLERANCE, factor * by_twist * POSE_SIGMA


def cost(problem: Joint, x: np.ndarray, e: np.ndarray) -> float:
    """Return the sum of all squares."""
    return float(sum(np.sum(part**2) for part in residuals(problem, x, e)))


def draw(poses: int, seed: int) -> Joint:
    """Return a campaign of a machine off its nominal by its tolerances, at random readings within 1.3 mm."""
    rng = np.random.default_rng(seed)
    legs = nominal()
    empty = Joint(legs, *np.zeros((4, 0)))
    machine = empty.machine(empty.start + TOLERANCE * rng.normal(size=42))
    rho = legs.rho0 + rng.uniform(-1.3e-3, 1.3e-3, (poses, 6))
    reached = forward(machine, rho)
    square = rng.normal(size=(poses, 6, 6)) / 3
    C = np.outer(POSE_SIGMA, POSE_SIGMA) * (np.eye(6) + square @ np.swapaxes(square, 1, 2))
    error = (np.linalg.cholesky(C) @ rng.normal(size=(poses, 6, 1)))[..., 0]
    read = rho + READING_SIGMA * rng.normal(size=rho.shape)
    return Joint(legs, reached.p + error[:, :3], exp_so3(error[:, 3:]) @ reached.R, read, C)
