"""Which poses take part in a calibration: what was grossly mismeasured is left out, counted and named."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.calibration.fits import answer
from truing.calibration.measured import BodyPoses, Gathered, Measured
from truing.calibration.question import Case, question, with_targets
from truing.simulation.mechanisms.calibration_problem import CalibrationProblem
from truing.simulation.mechanisms.legs.kinematics import upper_joints

# A larger share of poses is not mismeasured; then the model is wrong.
_MOST_BAD_POSES = 0.1
# A leg's joints are where they always are in its survey frame, but for so many robust standard deviations.
OFF = 8.0
_LEAST_SCATTER_M = 1e-7


@dataclass(frozen=True)
class OffLeg:
    """A leg, counted from 0, whose targets put its joints elsewhere in a pose; off: by how many robust sigmas."""

    pose: int | str
    leg: int
    off: float


@dataclass(frozen=True)
class Screened:
    """Poses to be fitted, without the poses of single legs that are wrong; kept (B,): which of them agree."""

    measured: Measured
    kept: NDArray
    legs_out: tuple[OffLeg, ...] = ()

    @property
    def poses_out(self) -> list[int | str]:
        """Return the poses that disagree with all others: their weight in a robust fit is 0."""
        return [pose for pose, agrees in zip(self.measured.poses, self.kept, strict=True) if not agrees]


def screened(gathered: Gathered, fitted: Measured, case: Case) -> Screened:
    """Return what agrees with the others under a model.

    A pose that was mismeasured is a rare one: where many seem to be, the model is wrong and all of them are kept.
    """
    asked = question(gathered, fitted, case)
    fit = answer(asked, robust=True)
    measured, legs = _without_bad_legs(asked.problem, fit.values, fitted)
    if (more := with_targets(asked, gathered, measured, case.deformation != "none")) is not None:
        fit = answer(more, fit.values[: asked.count], robust=True)
    kept = fit.weight > 0
    return Screened(measured, kept if np.mean(~kept) <= _MOST_BAD_POSES else np.ones_like(kept), legs)


def _without_bad_legs(
    problem: CalibrationProblem, values: NDArray, measured: Measured
) -> tuple[Measured, tuple[OffLeg, ...]]:
    """Return the poses without those of single legs whose joints are not where they always are on the leg."""
    machine = problem.machine(values)
    if not machine.legs.closure.one_body:
        return measured, ()
    rho = problem.readings(machine)
    upper = upper_joints(machine.legs, problem.p, problem.R, machine.delta_bz(rho))
    joints = (machine.legs.closure.lower(machine.legs, rho), upper)
    good, out = dict(measured.legs), []
    for leg, found in measured.legs.items():
        away = _away(found, *(joint[:, leg] for joint in joints))
        off = away > OFF
        good[leg] = replace(found, p=np.where(off[:, None], np.nan, found.p))
        out += [OffLeg(measured.poses[n], leg, float(away[n])) for n in np.flatnonzero(off)]
    return replace(measured, legs=good), tuple(out)


def _away(found: BodyPoses, lower: NDArray, upper: NDArray) -> NDArray:
    """Return by how many robust standard deviations (B,) the joints (B, 3) lie off their usual places on the leg."""
    places = [np.einsum("bji,bj->bi", found.R, joint - found.p) for joint in (lower, upper)]
    own = np.where(found.found[:, None], np.concatenate(places, -1), np.nan)
    if found.found.sum() < 3:
        return np.zeros(len(own))
    away = np.abs(own - np.nanmedian(own, 0))
    scatter = np.maximum(1.4826 * np.nanmedian(away, 0), _LEAST_SCATTER_M)
    return np.asarray(np.max(np.nan_to_num(away) / scatter, -1))
