"""Which calibration suits the campaign, and the figures by which it is chosen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages.calibration.accuracy import ARCSEC, PoseErrors
from stages.calibration.extended import ESTIMATOR, MODEL, Extended, extended_figures
from stages.calibration.fits import MAXIMUM_LIKELIHOOD, Calibration
from stages.calibration.question import is_deformation
from stages.common.rows import Rows
from truing.estimation.held_out import Choice, Contender, choose_model
from truing.simulation.structure import Machine
from truing.simulation.structures import departure, structures


@dataclass(frozen=True)
class Judged:
    """A calibration with its errors at all poses and the held-out poses' chi-square (B,), M expected of each."""

    calibration: Calibration
    errors: PoseErrors | None
    squares: NDArray
    equations: int


def choice(judged: Sequence[Judged]) -> Choice:
    """Return which of the maximum-likelihood calibrations is chosen."""
    return choose_model(
        [
            Contender(
                one.squares,
                one.equations,
                one.calibration.log_evidence,
                len(one.calibration.values),
                one.calibration.status == "ok",
            )
            for one in judged
        ]
    )


def choice_rows(judged: Sequence[Judged], roles: NDArray, made: Choice) -> Rows:
    """Return the figures of every calibration; ``made`` concerns those by maximum likelihood, which come first."""
    rows = Rows("model_choice")
    for i, one in enumerate(judged):
        likely = one.calibration.estimator == MAXIMUM_LIKELIHOOD
        figures = [*_error_figures(one.errors, roles), *_fit_figures(one)]
        if likely:
            figures.append(("chosen", float(i == made.chosen), "1"))
            figures.append(("indistinguishable", float(made.indistinguishable[i]), "1"))
        _add(
            rows,
            one.calibration.case.structure.name,
            one.calibration.case.deformation,
            one.calibration.estimator,
            figures,
        )
    return rows


def nominal_rows(model: str, errors: PoseErrors, roles: NDArray) -> Rows:
    """Return the figures of the machine before any calibration."""
    rows = Rows("model_choice")
    _add(rows, model, "none", "nominal", _error_figures(errors, roles))
    return rows


def extended_choice_rows(extended: Extended, roles: NDArray) -> Rows:
    """Return the figures of the extended model, which was fitted to other data and is not among those chosen from."""
    rows = Rows("model_choice")
    figures = [*_error_figures(extended.errors, roles), *extended_figures(extended)]
    _add(rows, MODEL, extended.deformation, ESTIMATOR, figures)
    return rows


def departure_rows(machine: Machine, readings: NDArray) -> Rows:
    """Return how far every other model of the structure departs from rigid legs, over the campaign's own readings."""
    rows = Rows("model_choice")
    for structure in structures(machine)[1:]:
        found = departure(structure, machine, readings) * 1e6
        told = found[np.isfinite(found)]
        if len(told):
            figures = [
                ("reading_rms_from_rigid_legs", float(np.sqrt(np.mean(told**2))), "um"),
                ("reading_max_from_rigid_legs", float(np.max(np.abs(told))), "um"),
            ]
            _add(rows, structure.name, "none", "nominal", figures)
    return rows


def _pull_p_value(calibration: Calibration, own: NDArray) -> float:
    """Return the probability of shifts as large of the parameters (P,) chosen, where tolerances are honest.

    Identified less nominal has the covariance of the tolerances less that of the parameters, which correlates them.
    """
    from scipy.special import chdtrc

    spread = np.diag(calibration.tolerance[own] ** 2) - calibration.declared[np.ix_(own, own)]
    shift = (calibration.values - calibration.nominal)[own]
    return float(chdtrc(len(shift), max(float(shift @ np.linalg.solve(spread, shift)), 0.0)))


def doubts(one: Judged) -> str:
    """Return what speaks against a calibration itself, in short; nothing where its misfit and its pulls are likely."""
    figures = {name: value for name, value, _ in _fit_figures(one)}
    said = []
    if figures.get("misfit_p_value", 1.0) < _UNLIKELY:
        said.append(f"misfit {np.sqrt(figures['chi_square'] / figures['freedom']):.1f} times the declared noise")
    if figures.get("pull_p_value", 1.0) < _UNLIKELY:
        said.append(f"parts {figures['rms_pull']:.1f} times further from nominal than their tolerances let expect")
    return "; ".join(said)


Figure = tuple[str, float, str]
_UNLIKELY = 1e-3  # that a right model has a misfit, or pulls, as large


def _add(rows: Rows, model: str, deformation: str, estimator: str, figures: Sequence[Figure]) -> None:
    for name, value, unit in figures:
        rows.add(model=model, deformation=deformation, estimator=estimator, figure=name, value=value, unit=unit)


def _error_figures(errors: PoseErrors | None, roles: NDArray) -> list[Figure]:
    if errors is None:
        return []
    figures: list[Figure] = []
    for part, values, unit, si in (
        ("position", errors.position, "um", 1e-6),
        ("orientation", errors.orientation, "arcsec", ARCSEC),
    ):
        for name, rows in (("calibration", roles != "verification"), ("verification", roles == "verification")):
            told = values[rows][np.isfinite(values[rows])] / si
            if len(told):
                figures.append((f"{part}_mean_{name}", float(told.mean()), unit))
                figures.append((f"{part}_max_{name}", float(told.max()), unit))
                floor = errors.expected(0 if part == "position" else 3)[rows] / si
                figures.append((f"{part}_noise_{name}", float(np.sqrt(np.mean(floor**2))), unit))
    return figures


def _fit_figures(one: Judged) -> list[Figure]:
    from scipy.special import chdtrc

    calibration = one.calibration
    geometry = [not is_deformation(entry) for entry in calibration.parameters.entries]
    told = calibration.pull[np.isfinite(calibration.pull) & geometry]
    figures: list[Figure] = [
        ("parameters", float(len(calibration.values)), "1"),
        ("poses", float(calibration.kept.sum()), "1"),
        ("poses_downweighted", float((~calibration.kept).sum()), "1"),
        ("chi_square", calibration.chi_square, "1"),
        ("freedom", calibration.freedom, "1"),
        ("pull_freedom", float(len(told)), "1"),
    ]
    if np.isfinite(calibration.chi_square) and calibration.freedom > 0:
        figures.append(("misfit_p_value", float(chdtrc(calibration.freedom, calibration.chi_square)), "1"))
    if len(told):
        figures.append(("rms_pull", float(np.sqrt(np.mean(told**2))), "1"))
    if len(told) and calibration.estimator == MAXIMUM_LIKELIHOOD:
        figures.append(("pull_p_value", _pull_p_value(calibration, np.isfinite(calibration.pull) & geometry), "1"))
    if np.isfinite(calibration.log_evidence):
        figures.append(("log_evidence", calibration.log_evidence, "1"))
    if len(one.squares):
        expected = one.equations * len(one.squares)
        figures.append(("heldout_ratio", float(np.sqrt(one.squares.sum() / expected)), "1"))
        figures.append(("p_value", float(chdtrc(expected, one.squares.sum())), "1"))
    return figures
