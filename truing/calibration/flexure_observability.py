"""Observability of the design parameters of flexures and legs: beta, lengths, stiffnesses (telescope report, 7.1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.calibration.calibration_input import CalibrationData, MeasuredPlatform
from truing.calibration.estimation_problem import (
    OF_FLEXURES,
    Case,
    cases,
    kind,
    observation_covariance,
    problem_of,
    tolerances,
    widest,
)
from truing.simulation.mechanisms.parameters import SHARED, LegParameter, ParameterSet, full_set
from truing.simulation.mechanisms.structures.catalogue import structures

_OF_DESIGN = ("beta", "flexure", "flexure_length", "tube")
_ROUNDING = 1e-9  # share of the information of the tolerance


@dataclass(frozen=True)
class DesignParameter:
    """One design parameter in one model, SI.

    tolerance: declared, else as large as the nominal value; sensitivity: rms change of the closure of its leg by one
    tolerance, m; noise: rms noise of this closure, m; sigma: standard deviation by the data alone, in tolerances,
    infinite without information; other parameters are known to their tolerances, and held if of design and without one.
    """

    model: str
    entry: LegParameter
    nominal: float
    tolerance: float
    sensitivity: float
    noise: float
    sigma: float

    @property
    def identifiable(self) -> bool:
        """True if the data determine the parameter better than its tolerance."""
        return self.sigma < 1.0


def flexure_design_parameters(data: CalibrationData, fitted: MeasuredPlatform) -> list[DesignParameter]:
    """Return the design parameters of every model of flexures, each leg's own first; none without such a model."""
    every = list(cases(data, structures(data.machine)))
    parameters = []
    for name in OF_FLEXURES:
        cases_of_name = [case for case in every if case.structure.name == name]
        parameters += _parameters_of_model(data, fitted, cases_of_name[-1]) if cases_of_name else []
    return parameters


def _parameters_of_model(data: CalibrationData, fitted: MeasuredPlatform, case: Case) -> list[DesignParameter]:
    parameters = _parameters(data.tolerance, case)
    problem = problem_of(case, parameters, fitted)
    at = problem.constrain(problem.start, np.zeros((len(fitted.rho), problem.deviations)))
    noise = observation_covariance(fitted, data.reading_sigma)
    closure = at.by_deviation @ noise @ np.swapaxes(at.by_deviation, -1, -2)
    scale = _scales(data, case, parameters, problem.start)
    rows = np.linalg.solve(np.linalg.cholesky(closure), at.by_values * scale).reshape(-1, len(scale))
    left = _left(rows, [kind(entry) for entry in parameters.entries], set(data.tolerance))
    size = np.sqrt(np.mean((at.by_values * scale) ** 2, 0))  # of every closure by every parameter
    spread = np.sqrt(np.mean(np.diagonal(closure, axis1=1, axis2=2), 0))
    result = []
    for i, entry in enumerate(parameters.entries):
        if kind(entry) in _OF_DESIGN:
            entries = (
                slice(None)
                if entry.leg == SHARED or case.structure.name != OF_FLEXURES[0]
                else slice(entry.leg, entry.leg + 1)
            )
            information = 1.0 / left[i] - 1.0
            sigma = information**-0.5 if information > _ROUNDING else np.inf
            sensitivity, floor = (float(np.sqrt(np.mean(part[entries] ** 2))) for part in (size[:, i], spread))
            nominal = float(problem.start[i])
            result.append(
                DesignParameter(case.key[0], entry, nominal, float(scale[i]), sensitivity, floor, float(sigma))
            )
    return result


def _left(rows: NDArray, kinds: list[str], declared: set[str]) -> NDArray:
    """Return the share (P,) of each variance that the data leave of that of the tolerance; 1 for other than design.

    Design parameters of another kind are held if they have no declared tolerance, as in the calibration.
    """
    left = np.ones(len(kinds))
    for name in set(kinds) & set(_OF_DESIGN):
        free = np.array([kind == name or kind not in _OF_DESIGN or kind in declared for kind in kinds])
        is_of_name = np.array([kind == name for kind in kinds])
        spread = np.linalg.inv(rows[:, free].T @ rows[:, free] + np.eye(int(free.sum())))
        left[is_of_name] = np.diag(spread)[is_of_name[free]]
    return left


def _parameters(tolerance: Mapping[str, float], case: Case) -> ParameterSet:
    """Return the geometry and the design parameters of a model, without those declared exact."""
    is_beam = case.structure.name == OF_FLEXURES[0]
    every = full_set(
        case.nominal,
        "none",
        rho0="rho0" in tolerance,
        flexure_length=True,
        beta=is_beam and case.nominal.beta is not None,
        sections=not is_beam,
    )
    exact = {name for name, sigma in tolerance.items() if sigma == 0.0}
    return ParameterSet(tuple(entry for entry in every.entries if kind(entry) not in exact))


def _scales(data: CalibrationData, case: Case, parameters: ParameterSet, nominal: NDArray) -> NDArray:
    """Return one sigma (P,) of each parameter: its tolerance, the nominal value of a design parameter without any, or a
    wide one."""
    declared, of_design = (
        tolerances(data, case, parameters),
        [kind(entry) in _OF_DESIGN for entry in parameters.entries],
    )
    wide = np.where(of_design, np.where(nominal > 0.0, nominal, 1.0), widest(parameters))
    return np.asarray(np.where(np.isfinite(declared), declared, wide))
