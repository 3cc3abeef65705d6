"""Legs with targets of their own in a calibration: where they are, and what noise they share with the platform."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.calibration_data import BodyPoses, Measured
from truing.estimation.covariance import shared_parent_covariance
from truing.estimation.errors_in_variables import Prior
from truing.simulation.calibration_problem import CalibrationProblem
from truing.simulation.leg_bodies import LegBodies, LegPoses, seated
from truing.simulation.point_model import FREE_ANGLE_RAD, FREE_DIRECTION, FREE_LENGTH_M


def leg_bodies(problem: CalibrationProblem, measured: Measured) -> LegBodies | None:
    """Return the legs whose own targets give their poses; None where there are none, or the model knows no legs."""
    carrying = [leg for leg, found in measured.legs.items() if found.found.any()]
    if not carrying:
        return None
    own = [measured.legs[leg] for leg in carrying]
    R, t, seen = (np.stack(parts, 1) for parts in zip(*((one.R, one.p, one.found) for one in own), strict=True))
    poses = LegPoses(np.array(carrying), R, t, seen)
    bodies = seated(problem.nominal.legs, problem.p, problem.R, problem.rho, poses)
    return bodies if bodies.fits(problem.structure, problem.nominal) else None


def noise_with_legs(measured: Measured, bodies: LegBodies, noise: NDArray) -> NDArray:
    """Return the covariance (B, n + 6 K, n + 6 K) of platform and readings, ``noise`` (B, n, n), and of K legs.

    Platform and legs are seen from the base, whose own error moves all of them together.
    """
    size = noise.shape[-1]
    places = np.concatenate([np.arange(6), size + np.arange(bodies.deviations)])
    common = shared_parent_covariance(
        measured.base.R,
        np.nan_to_num(measured.base.p),
        np.nan_to_num(measured.base.covariance),
        np.concatenate([measured.platform.p[:, None], bodies.t], 1),
    )
    whole = np.zeros((len(noise), size + bodies.deviations, size + bodies.deviations))
    whole[:, places[:, None], places] = common
    whole[:, :size, :size] = noise
    for k, leg in enumerate(bodies.leg):
        own = slice(size + 6 * k, size + 6 * k + 6)
        whole[:, own, own] = _leg_noise(measured.legs[int(leg)])
    return whole


def _leg_noise(found: BodyPoses) -> NDArray:
    """Return the covariance (B, 6, 6) of a leg's poses; so wide that it says nothing where the leg was not found."""
    unknown = np.diag([FREE_LENGTH_M**2] * 3 + [FREE_ANGLE_RAD**2] * 3)
    return np.where(found.found[:, None, None], np.nan_to_num(found.covariance), unknown)


def prior_with_legs(bodies: LegBodies, prior: Prior) -> Prior:
    """Return the prior with that of where each leg's survey frame sits on it, which nobody knows beforehand."""
    free = np.array([FREE_LENGTH_M if entry.name.startswith("c") else FREE_DIRECTION for entry in bodies.entries])
    size = len(prior.mean)
    information = np.diag(np.concatenate([np.zeros(size), free**-2.0]))
    information[:size, :size] = prior.information
    return Prior(np.concatenate([prior.mean, bodies.start]), information)
