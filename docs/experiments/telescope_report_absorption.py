"""Fits of the telescope that ignore part of K: bias to first order, and by full calibrations."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from docs.experiments.telescope_report_data import published
from docs.experiments.telescope_report_machine import MODEL, Stand, stand, with_deformation
from truing.estimation.least_squares.solver import Method, Solution, least_squares
from truing.simulation.mechanisms.calibration_problem import CalibrationProblem
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.parameters import ParameterSet, deformation_set, report_set
from truing.simulation.mechanisms.structures.structure import Machine, Structure

# Table of the report, and the deformation that its fit knows.
KNOWS = {"5a": "none", "6a": "linear"}


@dataclass(frozen=True)
class Calibration:
    """Least-squares fit of the report's kind, with residuals (N, M), m."""

    parameters: ParameterSet
    nominal: NDArray  # (P,) SI
    solution: Solution
    residual: NDArray

    @property
    def rows(self) -> dict[str, NDArray]:
        """Return identified minus nominal by row, (6,) legs 1 to 6, in the units of the tables."""
        return by_row(self.parameters, self.solution.x[0] - self.nominal)


def by_row(parameters: ParameterSet, values: NDArray) -> dict[str, NDArray]:
    """Return values (P,) in SI as rows of the tables, legs 1 to 6, mm or 1."""
    shown = values / parameters.units
    names = np.array([entry.name for entry in parameters.entries])
    return {name: shown[names == name] for name in dict.fromkeys(names.tolist())}


def ignorant(truth: Machine, table: str) -> Machine:
    """Return the machine as a fit of Table 5 or 6 starts: without K, or with its diagonal alone."""
    return with_deformation(truth, published().own if KNOWS[table] == "linear" else np.zeros((6, 6)))


def calibrate(
    nominal: Machine,
    parameters: ParameterSet,
    at: Stand,
    structure: Structure = MODEL,
    start: NDArray | None = None,
    method: Method = "levenberg-marquardt",
) -> Calibration:
    """Return the fit of the report, least squares of the closing at measured poses (eq. 30-32)."""

    problem = CalibrationProblem(structure, nominal, parameters, at.p, at.R, at.rho)
    none = np.zeros((len(at.rho), problem.deviations))

    def closing(x: NDArray) -> tuple[NDArray, NDArray]:
        found = problem.constrain(x, none)
        return found.value.reshape(len(x), -1), found.by_values.reshape(len(x), -1, len(parameters))

    solution = least_squares(closing, problem.start if start is None else start, method=method)
    return Calibration(parameters, problem.start, solution, problem.constrain(solution.x[0], none).value)


def simulated(truth: Machine, table: str) -> Calibration:
    """Return the full calibration, without noise, that Table 5a or 6a reports of the real machine."""
    nominal = ignorant(truth, table)
    return calibrate(nominal, report_set(nominal, KNOWS[table]), stand(truth))


@dataclass(frozen=True)
class LegFits:
    """First-order fits leg by leg, any batch (...): each leg of a 6-pus is fitted alone."""

    jacobian: NDArray  # (..., 6, N, 6) closing of leg i by its own six parameters, tables' order, SI
    effect: NDArray  # (..., 6, N) what the fit does not know, m

    @property
    def shift(self) -> NDArray:
        """Return the bias of the fitted parameters (..., 6 rows, 6 legs) due to the effect, SI."""
        return np.swapaxes(-(np.linalg.pinv(self.jacobian) @ self.effect[..., None])[..., 0], -1, -2)


def leg_fits(truth: Machine, table: str) -> LegFits:
    """Return the first-order fits that know what a fit of the table knows, of machines with any batch shape."""
    batch, moves = truth.legs.a.shape[:-2], published().calibration
    spread = _spread(truth, len(moves))
    at = stand(spread, np.tile(moves, (len(spread.legs.a) // len(moves), 1)))
    one = replace(truth, legs=_taken(truth.legs, (0,) * len(batch)))
    closing = MODEL.close(ignorant(spread, table), at.p, at.R, at.rho, report_set(one, KNOWS[table]).change(one))
    own = _own(closing.by_parameter).reshape(*batch, len(moves), 6, 6)
    return LegFits(np.moveaxis(own, -3, -2), np.moveaxis(closing.value.reshape(*batch, len(moves), 6), -1, -2))


def shift_by_K(truth: Machine, table: str) -> NDArray:
    """Return the derivative of one machine's first-order shift, leg i by its row of K (6 legs, 6 rows, 6), SI."""
    at = stand(truth)
    change = deformation_set(truth, "matrix").change(truth)
    by_K = MODEL.close(truth, at.p, at.R, at.rho, change).by_parameter.reshape(len(at.rho), 6, 6, 6)
    # the nominal machine's closing moves against that of the true one
    return np.linalg.pinv(leg_fits(truth, table).jacobian) @ np.einsum("niij->inj", by_K)


def _own(by_parameter: NDArray) -> NDArray:
    """Return each leg's closing by its own parameters (n, 6 legs, 6 rows), where parameters come row by row."""
    return np.einsum("niri->nir", by_parameter.reshape(-1, 6, 6, 6))


def _spread(truth: Machine, count: int) -> Machine:
    """Return machines (B count) in one row, each of a batch repeated for its poses."""
    legs = truth.legs
    flat = {name: getattr(legs, name) for name in ("a", "b", "u", "l", "rho0")}
    flat = {n: np.repeat(v.reshape(-1, *v.shape[-1 - (v.ndim > legs.l.ndim) :]), count, 0) for n, v in flat.items()}
    return replace(truth, legs=legs.replace(**flat))


def _taken(legs: Legs, which: tuple[int, ...]) -> Legs:
    return legs.replace(**{name: getattr(legs, name)[which] for name in ("a", "b", "u", "l", "rho0")})
