"""Which calibration suits the campaign, and the figures by which it is chosen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.calibration.accuracy import ARCSEC, PoseErrors
from truing.calibration.fits import MAXIMUM_LIKELIHOOD, Calibration
from truing.calibration.question import is_deformation
from truing.estimation.held_out import Choice, Contender, choose_model

Figure = tuple[str, float, str]
_UNLIKELY = 1e-3  # that a right model has a misfit, or pulls, as large


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
    figures = {name: value for name, value, _ in fit_figures(one)}
    said = []
    if figures.get("misfit_p_value", 1.0) < _UNLIKELY:
        said.append(f"misfit {np.sqrt(figures['chi_square'] / figures['freedom']):.1f} times the declared noise")
    if figures.get("pull_p_value", 1.0) < _UNLIKELY:
        said.append(f"parts {figures['rms_pull']:.1f} times further from nominal than their tolerances let expect")
    return "; ".join(said)


def error_figures(errors: PoseErrors | None, roles: NDArray) -> list[Figure]:
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


def fit_figures(one: Judged) -> list[Figure]:
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
