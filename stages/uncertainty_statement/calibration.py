"""The numbers of the mechanism by the chosen calibration: targets, readings and every kind of tolerance apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.common.calibration_data import gather
from stages.uncertainty_statement.found_causes import DEFORMATION, found_causes
from stages.uncertainty_statement.statement import Statement
from truing.calibration.every_case import screened_poses
from truing.calibration.fits import answer
from truing.calibration.measured import Gathered
from truing.calibration.question import Question, cases, is_deformation, question, survey_rows, with_targets
from truing.estimation.errors_in_variables.fit import ErrorsInVariablesFit
from truing.estimation.uncertainty_budget import NOT_HELD, Budget, Source, beyond_declared, budget, linear_estimate
from truing.simulation.mechanisms.parameters import SHARED, Parameter
from truing.simulation.mechanisms.structures.catalogue import structures

if TYPE_CHECKING:
    import pyarrow as pa

    from schemas.campaign import Campaign

Array = NDArray[np.float64]

TARGETS = Source("targets and their survey, through the poses", "B")
READINGS = Source("readings of the actuators", "B")
SURVEYED = Source("survey of the attachments", "B")
WIDE = Source("numbers of which nothing is declared", "B")
COMMON = Source("cameras, scale bars and frames of the survey, common to all poses", "B")
_TOLERANCES = {"a": "lower joints", "b": "upper joints", "u": "directions of the actuators", "l": "lengths of the legs"}
_TOLERANCES |= {"rho0": "reference readings"}
_CLOSES = 1e-3  # relative: a fit from where the first one ended ends there again, within its own tolerance


@dataclass(frozen=True)
class _Answered:
    """The chosen calibration, fitted once more from where it stood."""

    gathered: Gathered
    asked: Question
    fit: ErrorsInVariablesFit


def state_calibration(statement: Statement, tables: Mapping[str, pa.Table], settings: Campaign) -> None:
    """State every identified number of the chosen calibration."""
    key = _chosen(tables)
    if not settings.mechanism.is_legged:
        return
    if key is None:
        statement.not_evaluated("calibration", "all", "no calibration was made, or none could be chosen")
        return
    rows = [row for row in tables["calibration"].to_pylist() if (row["model"], row["deformation"]) == key]
    names = [_name(row["parameter"], row["leg"]) for row in rows]
    told = [row["sigma"] is not None and row["identified"] is not None for row in rows]
    whole = np.array([row["sigma"] if known else 0.0 for row, known in zip(rows, told, strict=True)], float)
    parts = _budget(tables, settings, key, rows)
    if parts is None or not np.allclose(parts.standard, whole, rtol=_CLOSES):
        parts = Budget((Source("fit as a whole: poses, readings and tolerances", "B"),), whole[None])
    subject = f"{key[0]}, {key[1]} deformation"
    kept = np.flatnonzero(told)
    statement.state(
        "calibration",
        subject,
        [names[i] for i in kept],
        np.array([rows[i]["identified"] for i in kept], float),
        [rows[i]["unit"] for i in kept],
        Budget(parts.sources, parts.contributions[:, kept]),
    )
    for i in np.flatnonzero(~np.array(told, bool)):
        statement.not_evaluated("calibration", names[i], "the data do not determine it", subject)
    statement.omitted("calibration", "the choice of the model", "each budget holds for the model that was chosen")
    for name, cause in found_causes(tables).items():
        if not (cause.startswith(DEFORMATION) and key[1] != "none"):
            statement.omitted("calibration", name, NOT_HELD)


def _chosen(tables: Mapping[str, pa.Table]) -> tuple[str, str] | None:
    if "model_choice" not in tables or "calibration" not in tables:
        return None
    wanted = ("errors-in-variables", "chosen", 1.0)
    rows = tables["model_choice"].to_pylist()
    keys = [(r["model"], r["deformation"]) for r in rows if (r["estimator"], r["figure"], r["value"]) == wanted]
    return keys[0] if keys else None


def _name(parameter: str, leg: int | None) -> str:
    return parameter if leg is None else f"{parameter} of leg {leg}"


def _budget(
    tables: Mapping[str, pa.Table], settings: Campaign, key: tuple[str, str], rows: list[dict[str, object]]
) -> Budget | None:
    """The budget of the numbers in the units of the tables; None where the calibration cannot be made once more."""
    try:
        answered = _answered(tables, settings, key, rows)
        if answered is None:
            return None
        found = _parts(answered)
    except (ValueError, np.linalg.LinAlgError):
        return None
    own = answered.asked.problem.parameters
    return budget(found, np.eye(len(own), len(answered.fit.values))).scaled(1.0 / own.units)


def _answered(
    tables: Mapping[str, pa.Table], settings: Campaign, key: tuple[str, str], rows: list[dict[str, object]]
) -> _Answered | None:
    gathered = gather(tables, settings)
    every = list(cases(gathered, structures(gathered.machine)))
    case = next((case for case in every if case.key == key), None)
    if case is None:
        return None
    clean = screened_poses(gathered, gathered.measured.roles != "verification", every)
    used = clean.measured.chosen(clean.kept)
    asked = question(gathered, used, case)
    asked = with_targets(asked, gathered, used, case.deformation != "none") or asked
    parameters = asked.problem.parameters
    stood = {(row["parameter"], row["leg"]): row["identified"] for row in rows}
    start = np.array([stood[entry.name, _leg(entry)] for entry in parameters.entries], float) * parameters.units
    fit = answer(asked, start, robust=False)
    return _Answered(gathered, asked, fit) if fit.ok else None


def _leg(entry: Parameter) -> int | None:
    return None if entry.leg == SHARED else entry.leg + 1


def _parts(answered: _Answered) -> dict[Source, Array]:
    """The covariance (P, P), SI, that each source gives to all values of the fit.

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


def _prior(answered: _Answered, ratio: float) -> tuple[dict[Source, Array], tuple[Source, ...]]:
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
