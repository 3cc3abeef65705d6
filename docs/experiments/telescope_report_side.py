"""The report's side results, repeated on the simulated telescope (sections 7, 7.1.1, 7.1.2, 7.1.4 and 7.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from docs.experiments.telescope_report_absorption import Calibration, calibrate
from docs.experiments.telescope_report_data import published
from docs.experiments.telescope_report_machine import MODEL, Stand
from docs.experiments.telescope_report_models import (
    DEFORMATIONS,
    STRUCTURES,
    Errors,
    errors,
    known,
    measured,
    truth,
    verified,
)
from truing.estimation.design.observability import Observability, observe
from truing.estimation.least_squares.solver import Method, Minima, Solution, distinct_minima, least_squares
from truing.simulation.mechanisms.calibration_problem import CalibrationProblem
from truing.simulation.mechanisms.legs.kinematics import forward
from truing.simulation.mechanisms.parameters import LegParameter, ParameterSet, deformation_set, report_set
from truing.simulation.mechanisms.structures.structure import Machine, Structure

# What the report's matrix model leaves of the measured shifts, on average (section 3.3).
SHIFT_NOISE = 5e-6
# Starts are drawn as section 6.3.2 draws the parameters.
START_MM = 0.5


def noisy(seed: int, moves: NDArray) -> Stand:
    """Return the poses of the telescope if attachments shift by K plus 5 um, at displacements (N, 6)."""
    machine, rng = truth(), np.random.default_rng(seed)
    rho = machine.legs.rho0 + moves
    found = forward(machine.legs, rho, machine.delta_bz(rho) + SHIFT_NOISE * rng.normal(size=moves.shape))
    return Stand(found.p, found.R, rho)


@dataclass(frozen=True)
class Fitted:
    """A calibration and what it predicts at Table 4."""

    calibration: Calibration
    machine: Machine
    verification: Errors

    @property
    def left(self) -> float:
        """Return the rms of what the fit left, m."""
        return float(np.sqrt(np.mean(self.calibration.residual**2)))


def fit(nominal: Machine, parameters: ParameterSet, structure: Structure = MODEL, at: Stand | None = None) -> Fitted:
    """Return a calibration at Table 3 with what it predicts at Table 4."""
    found = calibrate(nominal, parameters, at or measured(), structure)
    machine, there = parameters.machine(nominal, found.solution.x[0]), verified()
    # readings count from the reference reading, wherever the fit puts that
    rho = there.rho + (machine.legs.rho0 - nominal.legs.rho0)
    return Fitted(found, machine, errors(machine, structure, replace(there, rho=rho)))


def directions() -> dict[str, Fitted]:
    """Return Table 5a's fit with one, the other, or both components of u identified (7.1.1)."""
    nominal, report = known("none"), report_set(known("none"), "none")
    rest = [entry for entry in report.entries if entry.name != "u_x"]
    components = {"u_x": ["u_x"], "u_y": ["u_y"], "u_x and u_y": ["u_x", "u_y"]}
    sets = {
        name: ParameterSet((*rest, *(LegParameter(which, leg, "1", 1.0) for which in wanted for leg in range(6))))
        for name, wanted in components.items()
    }
    return {name: fit(nominal, parameters) for name, parameters in sets.items()}


def with_reference() -> tuple[Fitted, Fitted]:
    """Return the Jacobian model's fit without and with rho0 among the parameters (7.1.2)."""
    nominal, report = known("none"), report_set(known("none"), "none")
    more = ParameterSet((*report.entries, *(LegParameter("rho0", leg, "mm", 1e-3) for leg in range(6))))
    return tuple(fit(nominal, parameters, STRUCTURES["b"]) for parameters in (report, more))  # type: ignore[return-value]


def squared_singular_values(of: Calibration, structure: Structure) -> NDArray:
    """Return the singular values (P,) of J'J at the nominal parameters, mm and 1, descending."""
    nominal = known("none")
    jacobian = _jacobian(nominal, of.parameters, structure)
    return np.linalg.svd(jacobian * of.parameters.units * 1e3, compute_uv=False) ** 2


def _jacobian(nominal: Machine, parameters: ParameterSet, structure: Structure) -> NDArray:
    at = measured()
    problem = CalibrationProblem(structure, nominal, parameters, at.p, at.R, at.rho)
    found = problem.constrain(problem.start, np.zeros((len(at.rho), problem.deviations)))
    return found.by_values.reshape(-1, len(parameters))


def stiffness_parameters() -> Observability:
    """Return the joint information of Table 3's poses on geometry and six stiffnesses (7.1.4), 5 um per equation.

    Scales: 0.5 mm, 0.01, and each stiffness itself.
    """
    nominal = known("none")
    report = report_set(nominal, "none")
    names = [f"{body}_{kind}" for body in ("flexure", "tube") for kind in ("bending", "axial", "torsion")]
    parameters = ParameterSet((*report.entries, *(LegParameter(name, -1, "SI", 1.0) for name in names)))
    kind = np.array([entry.name for entry in parameters.entries])
    scales = np.where(kind == "u_x", 0.01, 0.5e-3)
    scales = np.where(np.isin(kind, names), parameters.values(nominal), scales)
    jacobian = _jacobian(nominal, parameters, STRUCTURES["d"])
    return observe(jacobian / SHIFT_NOISE, scales, parameters.labels)


def rows_of_K() -> list[Observability]:
    """Return, leg by leg, the information of poses alone on a_x a_y b_x b_y l and the leg's row of K (7.3), 5 um noise.

    Scales: 0.5 mm and 0.01, about the largest that K has.
    """
    nominal = known("matrix")
    found = []
    for leg in range(6):
        geometry = [e for e in report_set(nominal, "matrix").entries if e.leg == leg and e.name != "kappa"]
        row = [e for e in deformation_set(nominal, "matrix").entries if e.leg == leg]
        parameters = ParameterSet((*geometry, *row))
        scales = np.array([0.5e-3] * len(geometry) + [0.01] * len(row))
        found.append(observe(_jacobian(nominal, parameters, MODEL) / SHIFT_NOISE, scales, parameters.labels))
    return found


@dataclass(frozen=True)
class Starts:
    """Fits of one calibration from many starts by two methods."""

    minima: dict[str, Minima]
    between: float  # um, largest difference of the residuals of the two methods' lowest minima


def starts(table: str, ratio: float, count: int = 40) -> Starts:
    """Return the minima of a calibration with noise from many starts, by both methods (7).

    ratio: one sigma of the starts of u_x or kappa.
    """
    nominal, structure = known(DEFORMATIONS[table[0]]), STRUCTURES[table[1]]
    parameters = report_set(nominal, DEFORMATIONS[table[0]])
    at = noisy(1, published().calibration)
    problem = CalibrationProblem(structure, nominal, parameters, at.p, at.R, at.rho)
    spread = np.where(parameters.units < 1.0, 1e-3 * START_MM, ratio)
    first = problem.start + spread * np.random.default_rng(2).normal(size=(count, len(parameters)))
    methods: Sequence[Method] = ("levenberg-marquardt", "trust-region")
    found = {method: distinct_minima(_solved(problem, first, method)) for method in methods}
    lowest = np.stack([minima.x[0] for minima in found.values()])
    values = problem.constrain(lowest, np.zeros((len(at.rho), problem.deviations))).value
    return Starts(
        {str(method): minima for method, minima in found.items()}, 1e6 * float(np.abs(values[0] - values[1]).max())
    )


def _solved(problem: CalibrationProblem, first: NDArray, method: Method) -> Solution:
    none = np.zeros((len(problem.rho), problem.deviations))

    def closing(x: NDArray) -> tuple[NDArray, NDArray]:
        found = problem.constrain(x, none)
        return found.value.reshape(len(x), -1), found.by_values.reshape(len(x), -1, x.shape[1])

    return least_squares(closing, first, method=method)


@dataclass(frozen=True)
class Choice:
    """Errors of a model at Table 4 if the telescope shifts by 5 um besides K: um and arcsec, mean over the draws."""

    position_mean: float
    position_max: float
    orientation_mean: float
    orientation_max: float
    spread: float  # standard deviation of the mean position error over the draws, um


def choice(letter: str, deformation: str, draws: int = 20) -> Choice:
    """Return the errors at Table 4, measured there as well, of calibrations of one kind at Table 3."""
    nominal = known(deformation)
    parameters, shown = report_set(nominal, deformation), []
    for seed in range(draws):
        found = calibrate(nominal, parameters, noisy(seed, published().calibration), STRUCTURES[letter])
        machine = parameters.machine(nominal, found.solution.x[0])
        at = noisy(draws + seed, published().verification)
        shown.append(errors(machine, STRUCTURES[letter], at).shown())
    mean, spread = np.mean(shown, 0), np.std(shown, 0, ddof=1)
    position, position_max, orientation, orientation_max = map(float, mean)
    return Choice(position, position_max, orientation, orientation_max, float(spread[0]))
