"""How far a calibrated machine's poses are from the measured ones, and how far noise alone would put them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.calibration.fits import Calibration
from truing.calibration.measured import Measured
from truing.calibration.question import common_effects, own_covariance
from truing.calibration.targets import with_common
from truing.estimation.held_out import held_out_misfit
from truing.estimation.rotation import log_so3
from truing.simulation.change import Change
from truing.simulation.mechanisms.parameters import ParameterSet
from truing.simulation.mechanisms.structures.structure import Machine, Structure, reached_poses

ARCSEC = np.pi / 180 / 3600


@dataclass(frozen=True)
class PoseErrors:
    """Measured minus predicted poses, error (B, 6): m and rad, base frame; noise (B, 6, 6): what is expected of it."""

    error: NDArray
    noise: NDArray

    @property
    def position(self) -> NDArray:
        """Return the distances (B,), m."""
        return np.sqrt(np.sum(self.error[:, :3] ** 2, -1))

    @property
    def orientation(self) -> NDArray:
        """Return the angles (B,), rad."""
        return np.sqrt(np.sum(self.error[:, 3:] ** 2, -1))

    def expected(self, first: int) -> NDArray:
        """Return the rms (B,) that noise leaves in the three components from ``first`` on."""
        variances = np.diagonal(self.noise, axis1=1, axis2=2)[:, first : first + 3]
        return np.sqrt(np.maximum(variances.sum(-1), 0.0))


def pose_errors(calibration: Calibration, measured: Measured, reading_sigma: float, fitted: NDArray) -> PoseErrors:
    """Return the errors at all measured poses; fitted (B,): poses that took part, whose error the parameters share."""
    change, count = calibration.parameters.change(calibration.machine), len(calibration.values)
    return _errors(
        calibration.case.structure,
        calibration.machine,
        change,
        measured,
        reading_sigma,
        np.where(fitted[:, None, None], -calibration.declared, calibration.covariance),
        np.where(fitted[:, None, None], 0.0, calibration.joint[:count, count:]),
    )


def nominal_errors(structure: Structure, machine: Machine, measured: Measured) -> PoseErrors:
    """Return the errors of a machine that nobody has calibrated."""
    none = ParameterSet(()).change(machine)
    poses, common = len(measured.rho), common_effects(measured).shape[-1]
    return _errors(structure, machine, none, measured, 0.0, np.zeros((poses, 0, 0)), np.zeros((poses, 0, common)))


def _errors(
    structure: Structure,
    machine: Machine,
    change: Change,
    measured: Measured,
    reading_sigma: float,
    parameters: NDArray,
    with_common: NDArray,
) -> PoseErrors:
    """Errors with parameters (B, P, P), whose errors go with those of cameras and bars (B, P, K), as poses' do."""
    found = reached_poses(structure, machine, measured.rho, change)
    turned = log_so3(measured.platform.R @ np.swapaxes(found.R, -1, -2))
    error = np.concatenate([measured.platform.p - found.p, turned], -1)
    shared = found.by_parameter @ with_common @ np.swapaxes(common_effects(measured), -1, -2)
    noise = measured.platform.covariance + found.covariance(reading_sigma, parameters)
    noise = noise + shared + np.swapaxes(shared, -1, -2)
    return PoseErrors(np.where(found.converged[:, None], error, np.nan), noise)


def misfit(calibration: Calibration, measured: Measured, reading_sigma: float) -> NDArray:
    """Return per pose (B,) the chi-square of the closing at poses that took no part in the calibration."""
    problem = with_common(calibration.problem_at(measured), measured)
    values = np.concatenate([calibration.values, calibration.common]) if problem.common else calibration.values
    at = problem.constrain(values, np.zeros((len(measured.rho), problem.deviations)))
    noise, known = own_covariance(measured, reading_sigma), calibration.joint[: len(values), : len(values)]
    return held_out_misfit(at.value, at.by_deviation, at.by_values, noise, known)
