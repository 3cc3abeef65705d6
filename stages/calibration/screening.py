"""Which poses take part in a calibration: what was grossly mismeasured is left out, counted and named."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

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
_DISAGREES = "the pose disagrees with all others: its weight in a robust fit is 0"
_ELSEWHERE = "targets of the leg put its joints elsewhere than in the other poses"


@dataclass(frozen=True)
class Screened:
    """Poses to be fitted, without the poses of single legs that are wrong; kept (B,): which of them agree.

    rows: what was left out, as ``calibration_left_out`` has it.
    """

    measured: Measured
    kept: NDArray
    left_out: tuple[str, ...]
    rows: tuple[dict[str, Any], ...] = ()


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
    said += [f"legs whose targets put them elsewhere: {listed(list(legs))}"] if legs else []
    rows = [_row(pose, "platform", _DISAGREES, None, None) for pose in np.array(fitted.poses, object)[~kept]]
    return Screened(measured, kept, tuple(said), (*rows, *legs.values()))


def _row(pose: int | str, subject: str, reason: str, value: float | None, limit: float | None) -> dict[str, Any]:
    return {"pose": pose, "subject": subject, "reason": reason, "value": value, "limit": limit, "unit": "sigma"}


def _without_bad_legs(
    problem: CalibrationProblem, values: NDArray, measured: Measured
) -> tuple[Measured, dict[str, Any]]:
    """Return the poses without those of single legs whose joints are not where they always are on the leg."""
    machine = problem.machine(values)
    if not machine.legs.closure.one_body:
        return measured, {}
    rho = problem.readings(machine)
    upper = upper_joints(machine.legs, problem.p, problem.R, machine.delta_bz(rho))
    joints = (machine.legs.closure.lower(machine.legs, rho), upper)
    good, named = dict(measured.legs), {}
    for leg, found in measured.legs.items():
        away = _away(found, *(joint[:, leg] for joint in joints))
        off = away > _OFF
        good[leg] = replace(found, p=np.where(off[:, None], np.nan, found.p))
        for n in np.flatnonzero(off):
            pose, name = measured.poses[n], f"leg{leg + 1}"
            named[f"{name} in pose {pose}"] = _row(pose, name, _ELSEWHERE, float(away[n]), _OFF)
    return replace(measured, legs=good), named


def _away(found: BodyPoses, lower: NDArray, upper: NDArray) -> NDArray:
    """Return by how many robust standard deviations (B,) the joints (B, 3) lie off their usual places on the leg."""
    places = [np.einsum("bji,bj->bi", found.R, joint - found.p) for joint in (lower, upper)]
    own = np.where(found.found[:, None], np.concatenate(places, -1), np.nan)
    if found.found.sum() < 3:
        return np.zeros(len(own))
    away = np.abs(own - np.nanmedian(own, 0))
    scatter = np.maximum(1.4826 * np.nanmedian(away, 0), _LEAST_SCATTER_M)
    return np.asarray(np.max(np.nan_to_num(away) / scatter, -1))
