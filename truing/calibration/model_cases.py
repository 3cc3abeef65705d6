"""Calibrations of a campaign: every model of structure and deformation, fitted to the poses that pass screening."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.calibration.accuracy import AssessedCalibration, misfit, pose_errors
from truing.calibration.calibration_input import CalibrationData, MeasuredPlatform, PosesWithCovariance
from truing.calibration.estimation_problem import Case, nothing_open, problem_with_all_parameters, with_targets
from truing.calibration.fits import MachineCalibration, fit_problem, implicit, maximum_likelihood
from truing.simulation.mechanisms.calibration_problem import CalibrationProblem
from truing.simulation.mechanisms.legs.kinematics import upper_joints

# If more than this share of poses disagrees, the model is wrong, not the poses.
_MOST_BAD_POSES = 0.1
# Largest deviation of a leg's joints from their median place in its survey frame, in robust standard deviations.
OFF = 8.0
_LEAST_SCATTER_M = 1e-7
LEAST_LEGS = 6  # with fewer, readings do not determine the pose of the platform
ESTIMATORS = {maximum_likelihood: "by errors in variables", implicit: "by the closure alone"}


@dataclass(frozen=True)
class OffLeg:
    """A pose in which a leg's targets contradict its joints: pose, leg counted from 0, deviation in robust sigmas."""

    pose: int | str
    leg: int
    off: float


@dataclass(frozen=True)
class ScreenedPoses:
    """Poses to be fitted, without wrong poses of single legs; kept (B,) marks those that agree with the others."""

    measured: MeasuredPlatform
    kept: NDArray
    legs_out: tuple[OffLeg, ...] = ()

    @property
    def rejected_poses(self) -> list[int | str]:
        """Poses that disagree with all others: their weight in a robust fit is 0."""
        return [pose for pose, agrees in zip(self.measured.poses, self.kept, strict=True) if not agrees]


def screened(data: CalibrationData, fitted: MeasuredPlatform, case: Case) -> ScreenedPoses:
    """Return the poses that agree with the others under a model.

    Mismeasured poses are rare: if many disagree, the model is wrong and all poses are kept.
    """
    estimation = problem_with_all_parameters(data, fitted, case)
    fit = fit_problem(estimation, robust=True)
    measured, legs = _without_bad_legs(estimation.problem, fit.values, fitted)
    if (more := with_targets(estimation, data, measured, case)) is not None:
        fit = fit_problem(more, fit.values[: estimation.count], robust=True)
    is_used = fit.weight > 0
    return ScreenedPoses(measured, is_used if np.mean(~is_used) <= _MOST_BAD_POSES else np.ones_like(is_used), legs)


def _without_bad_legs(
    problem: CalibrationProblem, values: NDArray, measured: MeasuredPlatform
) -> tuple[MeasuredPlatform, tuple[OffLeg, ...]]:
    """Return the poses without those of single legs whose joints deviate from their usual places on the leg."""
    machine = problem.machine(values)
    if not machine.legs.closure.one_body:
        return measured, ()
    rho = problem.readings(machine)
    upper = upper_joints(machine.bent_legs(rho), problem.p, problem.R, machine.delta_bz(rho))
    joints = (machine.legs.closure.lower(machine.legs, rho), upper)
    good, out = dict(measured.legs), []
    for leg, poses_of_leg in measured.legs.items():
        away = _joint_deviation(poses_of_leg, *(joint[:, leg] for joint in joints))
        off = away > OFF
        good[leg] = replace(poses_of_leg, p=np.where(off[:, None], np.nan, poses_of_leg.p))
        out += [OffLeg(measured.poses[n], leg, float(away[n])) for n in np.flatnonzero(off)]
    return replace(measured, legs=good), tuple(out)


def _joint_deviation(poses: PosesWithCovariance, lower: NDArray, upper: NDArray) -> NDArray:
    """Return the deviation (B,) of the joints (B, 3) from their usual places on the leg, in robust standard
    deviations."""
    positions = [np.einsum("bji,bj->bi", poses.R, joint - poses.p) for joint in (lower, upper)]
    deviation = np.where(poses.found[:, None], np.concatenate(positions, -1), np.nan)
    if poses.found.sum() < 3:
        return np.zeros(len(deviation))
    away = np.abs(deviation - np.nanmedian(deviation, 0))
    scatter = np.maximum(1.4826 * np.nanmedian(away, 0), _LEAST_SCATTER_M)
    return np.asarray(np.max(np.nan_to_num(away) / scatter, -1))


@dataclass(frozen=True)
class Failure:
    """A case that could not be calibrated; by: the estimator with singular equations, empty if all parameters are
    exact."""

    case: Case
    by: str = ""

    @property
    def why(self) -> str:
        """Reason, in words."""
        return "the equations became singular" if self.by else "every number is declared exact"


@dataclass(frozen=True)
class CalibrationsByEstimator:
    """Calibrations of every case by both estimators, and the failures."""

    likely: tuple[MachineCalibration, ...]
    implicit: tuple[MachineCalibration, ...]
    failed: tuple[Failure, ...]


def screened_poses(data: CalibrationData, fitted: NDArray, every: Sequence[Case]) -> ScreenedPoses:
    """Return the poses to be fitted, screened with rigid legs and the richest model of deformation."""
    used = data.measured.subset(fitted)
    richest = [case for case in every if case.structure.name == every[0].structure.name][-1]
    everything = ScreenedPoses(used, np.ones(len(used.poses), bool))
    try:
        return everything if nothing_open(data, richest) else screened(data, used, richest)
    except np.linalg.LinAlgError:
        return everything


def calibrations(
    data: CalibrationData, clean: ScreenedPoses, every: Sequence[Case], progress: Callable[[int, int, Case], None]
) -> CalibrationsByEstimator:
    """Return the calibrations of all cases from screened poses; progress: done, total, next."""
    likely: list[MachineCalibration] = []
    closed: list[MachineCalibration] = []
    failed: list[Failure] = []
    for done, case in enumerate(every):
        progress(done, len(every), case)
        for made, how in ((likely, maximum_likelihood), (closed, implicit)):
            if nothing_open(data, case):
                failed.append(Failure(case))
                break
            try:
                made.append(how(data, clean.measured, case, clean.kept))
            except np.linalg.LinAlgError:
                failed.append(Failure(case, ESTIMATORS[how]))
    return CalibrationsByEstimator(tuple(likely), tuple(closed), tuple(failed))


def assessed_calibration(
    data: CalibrationData, calibration: MachineCalibration, fitted: NDArray
) -> AssessedCalibration:
    """Return a calibration with its errors at all poses, where readings determine them, and its misfit at held-out
    poses."""
    measured, legs = data.measured, data.machine.legs.count
    subset = measured.subset(~fitted)
    squares = misfit(calibration, subset, data.reading_sigma) if len(subset.poses) else np.zeros(0)
    errors = pose_errors(calibration, measured, data.reading_sigma, fitted) if legs >= LEAST_LEGS else None
    return AssessedCalibration(calibration, errors, squares, legs)
