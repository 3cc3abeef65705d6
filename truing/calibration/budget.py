"""What each source gives to the numbers of a calibration: targets, readings and every kind of tolerance apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.calibration.measured import Gathered
from truing.calibration.question import Question, is_deformation, survey_rows
from truing.estimation.errors_in_variables.fit import ErrorsInVariablesFit
from truing.estimation.uncertainty_budget import Source, beyond_declared, linear_estimate
from truing.simulation.mechanisms.parameters import Parameter

Array = NDArray[np.float64]
TARGETS = Source("targets and their survey, through the poses", "B")
READINGS = Source("readings of the actuators", "B")
SURVEYED = Source("survey of the attachments", "B")
WIDE = Source("numbers of which nothing is declared", "B")
COMMON = Source("cameras, scale bars and frames of the survey, common to all poses", "B")
_TOLERANCES = {"a": "lower joints", "b": "upper joints", "u": "directions of the actuators", "l": "lengths of the legs"}
_TOLERANCES |= {"rho0": "reference readings"}


@dataclass(frozen=True)
class Answered:
    """The chosen calibration, fitted once more from where it stood."""

    gathered: Gathered
    asked: Question
    fit: ErrorsInVariablesFit


def budget_of_answer(answered: Answered) -> dict[Source, Array]:
    """Return the covariance (P, P), SI, that each source gives to all values of the fit.

    Where more noise was found than declared, that of the poses, the readings and the survey is as much larger, and
    weighs as much less against the tolerances.
    """
    asked, fit = answered.asked, answered.fit
    at = asked.problem.constrain(fit.values, fit.deviations)
    ratio = max(fit.noise_ratio, 1.0) if np.isfinite(fit.noise_ratio) else 1.0
    legs = slice(6, 6 + asked.problem.rho.shape[-1])
    readings = np.zeros_like(asked.noise)
    readings[:, legs, legs] = asked.noise[:, legs, legs]
    noise = {TARGETS: (asked.noise - readings) * ratio**2, READINGS: readings * ratio**2}
    prior, surveyed = _prior(answered, ratio)
    found = linear_estimate(at.by_values, noise, prior, at.by_deviation)
    if ratio == 1.0:
        return found
    beyond = Source("scatter of the closing beyond the declared noise", "A", float(fit.judgement.freedom))
    total = np.zeros_like(found[TARGETS])
    for source in (TARGETS, READINGS, *surveyed):
        split = beyond_declared({source: found[source]}, source, ratio, beyond)
        found[source], total = split[source], total + split[beyond]
    return found | {beyond: total}


def _prior(answered: Answered, ratio: float) -> tuple[dict[Source, Array], tuple[Source, ...]]:
    """The precision (P, P) of what was known before, by source; and which of them are measurements."""
    gathered, asked = answered.gathered, answered.asked
    left, found = asked.prior.information.copy(), {}
    if gathered.surveyed is not None:
        rows = survey_rows(gathered.surveyed, asked.problem.parameters)
        own = np.zeros_like(left)
        own[: asked.count, : asked.count] = rows.T @ np.linalg.solve(gathered.surveyed.covariance, rows)
        left, found[SURVEYED] = left - own, own / ratio**2
    for source, places in _kinds(asked).items():
        found[source] = np.diag(np.where(np.isin(np.arange(len(left)), places), np.diag(left), 0.0))
    return found, tuple(source for source in found if source is SURVEYED)


def _kinds(asked: Question) -> dict[Source, list[int]]:
    """Which values each kind of knowledge is of: tolerances by kind, deformation as seen, and what is merely wide."""
    places: dict[Source, list[int]] = {}
    for i in range(len(asked.problem.start)):
        source = WIDE if i < len(asked.problem.start) - asked.common else COMMON
        if i < asked.count and np.isfinite(asked.tolerance[i]):
            entry = asked.problem.parameters.entries[i]
            source = _tolerance(entry)
        places.setdefault(source, []).append(i)
    return places


def _tolerance(entry: Parameter) -> Source:
    if is_deformation(entry):
        return Source("deformation, as the targets on the attachments showed it", "B")
    return Source(f"tolerance of the {_TOLERANCES.get(entry.name.partition('_')[0], entry.name)}", "B")
