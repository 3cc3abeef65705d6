"""Implicit models that the tests of errors in variables share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tests.simulation.mechanisms.telescope import readings, telescope
from truing.estimation.errors_in_variables.fit import Prior
from truing.estimation.rotation import exp_so3
from truing.simulation.mechanisms.calibration_problem import CalibrationProblem
from truing.simulation.mechanisms.parameters import ParameterSet, full_set
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
from truing.simulation.mechanisms.structures.structure import Machine, poses_at


@dataclass(frozen=True)
class Equations:
    """Result of a model."""

    value: NDArray
    by_deviation: NDArray
    by_values: NDArray


@dataclass(frozen=True)
class Line:
    """y = intercept + slope x through points (B, 2)."""

    points: NDArray

    def constrain(self, values: NDArray, deviation: NDArray) -> Equations:
        x, y = (self.points + deviation).T
        by_deviation = np.broadcast_to([-values[1], 1.0], (len(x), 1, 2))
        by_values = np.stack([-np.ones_like(x), -x], -1)[:, None]
        return Equations((y - values[0] - values[1] * x)[:, None], by_deviation, by_values)


@dataclass(frozen=True)
class Circle:
    """Points (B, 2) at a distance from a centre; values: centre, radius."""

    points: NDArray

    def constrain(self, values: NDArray, deviation: NDArray) -> Equations:
        arm = self.points + deviation - values[:2]
        distance = np.sqrt(np.sum(arm**2, -1))
        out = arm / distance[:, None]
        by_values = np.concatenate([-out, -np.ones((len(arm), 1))], 1)[:, None]
        return Equations((distance - values[2])[:, None], out[:, None], by_values)


@dataclass(frozen=True)
class Linear:
    """design x - (measured + d) = 0 with covariance (B, m, m); the truth (P,) was drawn from the prior."""

    design: NDArray  # (B, m, P)
    measured: NDArray  # (B, m)
    covariance: NDArray
    prior: Prior
    truth: NDArray

    def constrain(self, values: NDArray, deviation: NDArray) -> Equations:
        by_deviation = np.broadcast_to(-np.eye(deviation.shape[1]), (len(deviation), *(deviation.shape[1],) * 2))
        return Equations(self.design @ values - self.measured - deviation, by_deviation, self.design)

    def normal(self) -> tuple[NDArray, NDArray]:
        """The normal equations of weighted least squares with the prior."""
        W = np.linalg.inv(self.covariance)
        H = np.einsum("bmp,bmn,bnq->pq", self.design, W, self.design) + self.prior.information
        right = np.einsum("bmp,bmn,bn->p", self.design, W, self.measured)
        return H, right + self.prior.information @ self.prior.mean

    def only(self, kept: NDArray) -> Linear:
        """The problem of some of the poses."""
        return replace(self, design=self.design[kept], measured=self.measured[kept], covariance=self.covariance[kept])


def linear(rng: np.random.Generator, poses: int = 9, noise: float = 1.0) -> Linear:
    """Four values, three equations per pose, and noise that is this many times what is declared."""
    design = rng.normal(size=(poses, 3, 4))
    square = rng.normal(size=(poses, 3, 3))
    C = square @ np.swapaxes(square, 1, 2) + 0.1 * np.eye(3)
    prior = Prior(rng.normal(size=4), np.eye(4))
    truth = prior.mean + rng.normal(size=4)
    error = noise * np.linalg.cholesky(C) @ rng.normal(size=(poses, 3, 1))
    return Linear(design, design @ truth + error[..., 0], C, prior, truth)


TOLERANCE = {"a": 5e-4, "b": 5e-4, "u": 2e-3, "l": 5e-4}  # one sigma, m and 1
POSE_SIGMA = np.array([2e-6] * 3 + [1e-5] * 3)  # m, rad
READING_SIGMA = 1e-6  # m


@dataclass(frozen=True)
class Campaign:
    """A simulated campaign of a telescope with legs off their nominal ones by their tolerances."""

    problem: CalibrationProblem
    covariance: NDArray  # (B, 12, 12)
    prior: Prior
    truth: NDArray  # (P,)

    def only(self, kept: NDArray) -> Campaign:
        """The campaign with some of its poses."""
        problem = self.problem
        part = replace(problem, p=problem.p[kept], R=problem.R[kept], rho=problem.rho[kept])
        return replace(self, problem=part, covariance=self.covariance[kept])


def identified(machine: Machine) -> ParameterSet:
    """a_x a_y b_x b_y u_x u_y l of every leg."""
    return ParameterSet(tuple(p for p in full_set(machine, "none").entries if not p.name.endswith("_z")))


def campaign(
    rng: np.random.Generator, poses: int, reading_sigma: float = READING_SIGMA, scatter: float = 0.0
) -> Campaign:
    """A campaign at random readings, poses with correlated noise whose sizes scatter by so many powers of e."""
    nominal = Machine(telescope(), np.zeros((6, 6)))
    parameters = identified(nominal)
    prior = _prior(parameters, nominal)
    truth = prior.mean + rng.normal(size=len(prior.mean)) / np.sqrt(np.diag(prior.information))
    rho = readings(rng, poses)
    reached = poses_at(KinematicModel("6-pus"), parameters.machine(nominal, truth), rho)
    C = np.zeros((poses, 12, 12))
    C[:, :6, :6] = _pose_covariance(rng, poses) * np.exp(2 * scatter * rng.normal(size=(poses, 1, 1)))
    C[:, 6:, 6:] = reading_sigma**2 * np.eye(6)
    error = (np.linalg.cholesky(C[:, :6, :6]) @ rng.normal(size=(poses, 6, 1)))[..., 0]
    p, R = reached.p + error[:, :3], exp_so3(error[:, 3:]) @ reached.R
    read = rho + reading_sigma * rng.normal(size=rho.shape)
    return Campaign(CalibrationProblem(KinematicModel("6-pus"), nominal, parameters, p, R, read), C, prior, truth)


def spoiled(found: Campaign, rng: np.random.Generator, poses: Sequence[int], sigmas: float) -> Campaign:
    """The campaign with some poses this many sigmas off, as a rule, in every component."""
    p, R = found.problem.p.copy(), found.problem.R.copy()
    off = sigmas * POSE_SIGMA * rng.normal(size=(len(poses), 6))
    p[poses] += off[:, :3]
    R[poses] = exp_so3(off[:, 3:]) @ R[poses]
    return replace(found, problem=replace(found.problem, p=p, R=R))


def _prior(parameters: ParameterSet, nominal: Machine) -> Prior:
    sigma = np.array([TOLERANCE[entry.name[0]] for entry in parameters.entries])
    return Prior(parameters.values(nominal), np.diag(sigma**-2.0))


def _pose_covariance(rng: np.random.Generator, poses: int) -> NDArray:
    square = rng.normal(size=(poses, 6, 6)) / 3
    return np.outer(POSE_SIGMA, POSE_SIGMA) * (np.eye(6) + square @ np.swapaxes(square, 1, 2))
