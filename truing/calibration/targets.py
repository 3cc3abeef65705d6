"""Targets on legs and attachments in a calibration: what they measure, and the noise that they share with the pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from truing.calibration.measured import BodyPoses, Gathered, Measured
from truing.estimation.covariance import shared_parent_covariance
from truing.estimation.errors_in_variables.fit import Prior
from truing.estimation.measured_numbers import pose_numbers, shift_number
from truing.simulation.mechanisms.calibration_problem import AttachmentShifts, CalibrationProblem, CommonErrors
from truing.simulation.mechanisms.legs.leg_bodies import LegBodies, LegPoses, seated
from truing.simulation.mechanisms.recording import FREE_ANGLE_RAD, FREE_DIRECTION, FREE_LENGTH_M


def with_bodies(problem: CalibrationProblem, measured: Measured) -> CalibrationProblem:
    """Return the problem with the legs whose own targets give their poses, where there are any and it knows legs."""
    carrying = [leg for leg, found in measured.legs.items() if found.found.any()]
    if not carrying:
        return problem
    own = [measured.legs[leg] for leg in carrying]
    R, t, seen = (np.stack(parts, 1) for parts in zip(*((one.R, one.p, one.found) for one in own), strict=True))
    poses = LegPoses(np.array(carrying), R, t, seen)
    bodies = seated(problem.nominal.legs, problem.p, problem.R, problem.rho, poses)
    return replace(problem, leg_bodies=bodies) if bodies.fits(problem.structure, problem.nominal) else problem


def with_shifts(problem: CalibrationProblem, gathered: Gathered, measured: Measured) -> CalibrationProblem:
    """Return the problem with the shifts of attachments that carry targets, where these have been measured."""
    if measured.shifts is None or gathered.surveyed is None:
        return problem
    seen = np.flatnonzero(np.isfinite(measured.shifts.shift).any(0))
    heights = np.array([gathered.surveyed.b[gathered.surveyed.legs == leg, 2].mean() for leg in seen])
    found = AttachmentShifts(seen, np.nan_to_num(measured.shifts.shift[:, seen]), heights)
    return replace(problem, shifts=found) if len(seen) else problem


def with_common(problem: CalibrationProblem, measured: Measured) -> CalibrationProblem:
    """Return the problem with the errors that all poses have in common among its numbers, where there are any."""
    found = None if measured.network is None else _in_common(problem, measured)[1]
    return problem if found is None or not found.any() else replace(problem, common=CommonErrors(found))


def _in_common(problem: CalibrationProblem, measured: Measured) -> tuple[NDArray, NDArray]:
    """Return what a network of rays tells of the deviations: covariance (B, N, N), NaN where it tells nothing, and
    effects (B, N, K) of errors common to all poses."""
    legs, poses = measured.rho.shape[1], len(measured.rho)
    names, told = [*pose_numbers("platform"), *[""] * legs], [np.ones((poses, 6 + legs), bool)]
    if problem.leg_bodies is not None:
        for leg in problem.leg_bodies.leg:
            names += [*pose_numbers(f"leg{leg + 1}")]
            told.append(np.repeat(measured.legs[int(leg)].found[:, None], 6, 1))
    if problem.shifts is not None and measured.shifts is not None:
        names += [shift_number(int(leg) + 1) for leg in problem.shifts.leg]
        told.append(np.isfinite(measured.shifts.sigma[:, problem.shifts.leg]))
    assert measured.network is not None
    return measured.network.of(names, np.concatenate(told, 1))


def noise_of_all(problem: CalibrationProblem, measured: Measured, noise: NDArray) -> NDArray:
    """Return the covariance (B, N, N) of all deviations; ``noise`` (B, n, n) is that of platform and readings.

    Errors common to all poses are no part of it: they are numbers of the problem.
    """
    whole = np.zeros((len(noise), problem.deviations, problem.deviations))
    whole[:, : noise.shape[-1], : noise.shape[-1]] = noise
    if problem.leg_bodies is not None:
        _fill_legs(whole, problem.leg_bodies, measured, noise.shape[-1])
    if problem.shifts is not None:
        _fill_shifts(whole, problem, problem.shifts, measured)
    if measured.network is None:
        return whole
    together, effects = _in_common(problem, measured)
    own = together - effects @ np.swapaxes(effects, -1, -2)
    return np.where(np.isfinite(own), own, whole)


def _fill_legs(whole: NDArray, bodies: LegBodies, measured: Measured, first: int) -> None:
    """Fill in the legs: they are seen from the base as the platform is, whose own error moves all of them together."""
    places = np.concatenate([np.arange(6), first + np.arange(bodies.deviations)])
    common = _of_base(measured, np.concatenate([measured.platform.p[:, None], bodies.t], 1))
    platform = whole[:, :6, :6].copy()
    whole[:, places[:, None], places] = common
    whole[:, :6, :6] = platform
    for k, leg in enumerate(bodies.leg):
        own = slice(first + 6 * k, first + 6 * k + 6)
        whole[:, own, own] = _leg_noise(measured.legs[int(leg)])


def _fill_shifts(whole: NDArray, problem: CalibrationProblem, shifts: AttachmentShifts, measured: Measured) -> None:
    """Fill in the shifts, counted from the platform as it was measured: where that is too high, they are too low."""
    found = measured.shifts.sigma[:, shifts.leg] if measured.shifts is not None else np.zeros((0, 0))
    seen = np.isfinite(found)
    rows = _heights_per_twist(problem, shifts) * seen[..., None]
    platform = measured.platform.covariance - _of_base(measured, measured.platform.p[:, None])
    own = slice(whole.shape[-1] - shifts.deviations, whole.shape[-1])
    whole[:, own, :6] = -rows @ platform
    whole[:, :6, own] = np.swapaxes(whole[:, own, :6], -1, -2)
    sigma = np.where(seen, found, FREE_LENGTH_M)
    whole[:, own, own] = rows @ platform @ np.swapaxes(rows, -1, -2) + np.eye(shifts.deviations) * sigma[:, None] ** 2


def _heights_per_twist(problem: CalibrationProblem, shifts: AttachmentShifts) -> NDArray:
    """Return how far a twist (v; omega) of the platform moves each attachment along the platform's z, (B, A, 6)."""
    z = np.broadcast_to(problem.R[:, None, :, 2], (len(problem.R), len(shifts.leg), 3))
    arms = problem.nominal.legs.b[shifts.leg] @ np.swapaxes(problem.R, -1, -2)
    return np.concatenate([z, np.cross(arms, z)], -1)


def _of_base(measured: Measured, places: NDArray) -> NDArray:
    """Return what the error of the base's pose gives to bodies at places (B, K, 3) in it, (B, 6 K, 6 K)."""
    base = measured.base
    return shared_parent_covariance(base.R, np.nan_to_num(base.p), np.nan_to_num(base.covariance), places)


def _leg_noise(found: BodyPoses) -> NDArray:
    """Return the covariance (B, 6, 6) of a leg's poses; so wide that it says nothing where the leg was not found."""
    unknown = np.diag([FREE_LENGTH_M**2] * 3 + [FREE_ANGLE_RAD**2] * 3)
    return np.where(found.found[:, None, None], np.nan_to_num(found.covariance), unknown)


def prior_of_all(problem: CalibrationProblem, prior: Prior) -> Prior:
    """Return the prior of the machine's numbers with that of where legs' survey frames sit on them, which nobody knows
    beforehand, and of errors common to all poses, which are of one standard deviation."""
    size, common = len(prior.mean), len(problem.common.entries) if problem.common else 0
    own = problem.entries[size : len(problem.entries) - common]
    free = np.array([FREE_LENGTH_M if entry.name.startswith("c") else FREE_DIRECTION for entry in own])
    information = np.diag(np.concatenate([np.zeros(size), free**-2.0, np.ones(common)]))
    information[:size, :size] = prior.information
    return Prior(np.concatenate([prior.mean, problem.start[size:]]), information)
