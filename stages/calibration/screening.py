"""Which poses take part in a calibration: what was grossly mismeasured is left out, counted and named."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stages.calibration.data import BodyPoses, Gathered, Measured
from stages.calibration.fits import answer
from stages.calibration.question import Case, question, with_targets
from stages.quality.check import listed
from truing.simulation.calibration_problem import CalibrationProblem
from truing.simulation.kinematics import upper_joints

# A larger share of poses is not mismeasured; then the model is wrong.
_MOST_BAD_POSES = 0.1
# A leg's joints are where they always are in its survey frame, but for so many robust standard deviations.
_OFF = 8.0
_LEAST_SCATTER_M = 1e-7


@dataclass(frozen=True)
class Screened:
    """Poses to be fitted, without the poses of single legs that are wrong; kept (B,): which of them agree."""

    measured: Measured
    kept: NDArray
    left_out: tuple[str, ...]


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
    kept = kept if np.mean(~kept) <= _MOST_BAD_POSES else np.ones_like(kept)
    bad = [str(pose) for pose, agrees in zip(fitted.poses, kept, strict=True) if not agrees]
    said = [f"poses that disagree with all others: {', '.join(bad)}"] if bad else []
    said += [f"legs whose targets put them elsewhere: {listed(legs)}"] if legs else []
    return Screened(measured, kept, tuple(said))


def _without_bad_legs(problem: CalibrationProblem, values: NDArray, measured: Measured) -> tuple[Measured, list[str]]:
    """Return the poses without those of single legs whose joints are not where they always are on the leg."""
    machine = problem.machine(values)
    if not machine.legs.closure.one_body:
        return measured, []
    rho = problem.readings(machine)
    upper = upper_joints(machine.legs, problem.p, problem.R, machine.delta_bz(rho))
    joints = (machine.legs.closure.lower(machine.legs, rho), upper)
    good, named = dict(measured.legs), []
    for leg, found in measured.legs.items():
        off = _off(found, *(joint[:, leg] for joint in joints))
        good[leg] = replace(found, p=np.where(off[:, None], np.nan, found.p))
        named += [f"leg{leg + 1} in pose {measured.poses[n]}" for n in np.flatnonzero(off)]
    return replace(measured, legs=good), named


def _off(found: BodyPoses, lower: NDArray, upper: NDArray) -> NDArray:
    """Return in which poses (B,) the joints (B, 3) lie far from their usual places in the leg's survey frame."""
    places = [np.einsum("bji,bj->bi", found.R, joint - found.p) for joint in (lower, upper)]
    own = np.where(found.found[:, None], np.concatenate(places, -1), np.nan)
    if found.found.sum() < 3:
        return np.zeros(len(own), bool)
    away = np.abs(own - np.nanmedian(own, 0))
    scatter = np.maximum(1.4826 * np.nanmedian(away, 0), _LEAST_SCATTER_M)
    return np.asarray(np.any(np.nan_to_num(away) > _OFF * scatter, -1))
