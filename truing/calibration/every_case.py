"""The calibrations of a campaign: every model of its structure and deformation, by both estimators."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.calibration.accuracy import misfit, pose_errors
from truing.calibration.choice import Judged
from truing.calibration.fits import Calibration, implicit, maximum_likelihood
from truing.calibration.measured import Gathered
from truing.calibration.question import Case, nothing_open
from truing.calibration.screening import Screened, screened

LEAST_LEGS = 6  # with fewer, readings do not say where the platform is
ESTIMATORS = {maximum_likelihood: "by errors in variables", implicit: "by the closure alone"}


@dataclass(frozen=True)
class Failure:
    """A case that could not be calibrated; by: the estimator whose equations became singular, empty where every number
    is declared exact."""

    case: Case
    by: str = ""

    @property
    def why(self) -> str:
        """Return why, in words."""
        return "the equations became singular" if self.by else "every number is declared exact"


@dataclass(frozen=True)
class Both:
    """The calibrations of every case by both estimators, and why any could not be made."""

    likely: tuple[Calibration, ...]
    implicit: tuple[Calibration, ...]
    failed: tuple[Failure, ...]


def screened_poses(gathered: Gathered, fitted: NDArray, every: Sequence[Case]) -> Screened:
    """Return the poses to be fitted as the rigid legs find them, under all that is known of the deformation."""
    used = gathered.measured.chosen(fitted)
    richest = [case for case in every if case.structure.name == every[0].structure.name][-1]
    everything = Screened(used, np.ones(len(used.poses), bool))
    try:
        return everything if nothing_open(gathered, richest) else screened(gathered, used, richest)
    except np.linalg.LinAlgError:
        return everything


def calibrations(
    gathered: Gathered, clean: Screened, every: Sequence[Case], progress: Callable[[int, int, Case], None]
) -> Both:
    """Return all calibrations of the poses that were not grossly mismeasured; progress: done, total, next."""
    likely: list[Calibration] = []
    closed: list[Calibration] = []
    failed: list[Failure] = []
    for done, case in enumerate(every):
        progress(done, len(every), case)
        for made, how in ((likely, maximum_likelihood), (closed, implicit)):
            if nothing_open(gathered, case):
                failed.append(Failure(case))
                break
            try:
                made.append(how(gathered, clean.measured, case, clean.kept))
            except np.linalg.LinAlgError:
                failed.append(Failure(case, ESTIMATORS[how]))
    return Both(tuple(likely), tuple(closed), tuple(failed))


def judged(gathered: Gathered, calibration: Calibration, fitted: NDArray) -> Judged:
    """Return a calibration with its errors at all poses, where readings fix them, and its misfit at held-out ones."""
    measured, legs = gathered.measured, gathered.machine.legs.count
    held = measured.chosen(~fitted)
    squares = misfit(calibration, held, gathered.reading_sigma) if len(held.poses) else np.zeros(0)
    errors = pose_errors(calibration, measured, gathered.reading_sigma, fitted) if legs >= LEAST_LEGS else None
    return Judged(calibration, errors, squares, legs)
