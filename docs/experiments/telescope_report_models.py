"""The twelve calibrations of the report on a simulated telescope: 6-PUS legs, a platform that follows K of eq. 4."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from docs.experiments.telescope_report_absorption import Calibration, calibrate
from docs.experiments.telescope_report_data import published
from docs.experiments.telescope_report_geometry import best_shape
from docs.experiments.telescope_report_machine import MODEL, Stand, flexible, stand, with_deformation
from truing.estimation.rotation import log_so3
from truing.simulation.mechanisms.parameters import report_set
from truing.simulation.mechanisms.structures.beam_model import BeamModel
from truing.simulation.mechanisms.structures.kinematic_model import JacobianModel
from truing.simulation.mechanisms.structures.stiffness_model import StiffnessModel
from truing.simulation.mechanisms.structures.structure import Machine, Structure, poses_at, readings_at

STRUCTURES: dict[str, Structure] = {
    "a": MODEL,
    "b": JacobianModel(),
    "c": BeamModel(),
    "d": StiffnessModel(),
}
DEFORMATIONS = {"5": "none", "6": "linear", "7": "matrix"}


@cache
def truth() -> Machine:
    """Return the inferred machine with K, and with flexures for the models that want some."""
    return flexible(best_shape().machine)


@cache
def measured() -> Stand:
    """Return the poses of the inferred machine at Table 3."""
    return stand(truth())


@cache
def verified() -> Stand:
    """Return the poses of the inferred machine at Table 4."""
    return stand(truth(), published().verification)


def known(deformation: str) -> Machine:
    """Return the machine as far as a fit knows it at its start."""
    K = published().K
    return with_deformation(truth(), {"none": 0.0 * K, "linear": published().own, "matrix": K}[deformation])


@cache
def calibration(table: str) -> Calibration:
    """Return the calibration of a table of the report, 5a to 7d, without noise."""
    nominal = known(DEFORMATIONS[table[0]])
    parameters = report_set(nominal, DEFORMATIONS[table[0]])
    return calibrate(nominal, parameters, measured(), STRUCTURES[table[1]])


@dataclass(frozen=True)
class Errors:
    """Poses that a calibrated machine predicts less the true ones, over B configurations."""

    away: NDArray  # (B, 3) m
    orientation: NDArray  # (B,) rad

    @property
    def position(self) -> NDArray:
        """Return the distances (B,), m."""
        return np.linalg.norm(self.away, axis=-1)

    def shown(self) -> tuple[float, float, float, float]:
        """Return mean and largest position error in um, mean and largest orientation error in arcsec."""
        arcsec = np.degrees(self.orientation) * 3600
        position = 1e6 * self.position
        return float(position.mean()), float(position.max()), float(arcsec.mean()), float(arcsec.max())


def errors(machine: Machine, structure: Structure, at: Stand) -> Errors:
    """Return the pose errors of the machine; raises ArithmeticError where poses did not converge."""
    found = poses_at(structure, machine, at.rho)
    if not found.converged.all():
        raise ArithmeticError(f"{structure.name}: {np.sum(~found.converged)} poses did not converge")
    turned = log_so3(found.R @ np.swapaxes(at.R, -1, -2))
    return Errors(found.p - at.p, np.linalg.norm(turned, axis=-1))


def calibrated(table: str) -> Machine:
    """Return the machine that the calibration of a table found."""
    found = calibration(table)
    return found.parameters.machine(known(DEFORMATIONS[table[0]]), found.solution.x[0])


def accuracy(table: str) -> tuple[Errors, Errors]:
    """Return the errors at calibration and at verification configurations."""
    machine, structure = calibrated(table), STRUCTURES[table[1]]
    return errors(machine, structure, measured()), errors(machine, structure, verified())


@dataclass(frozen=True)
class Misfit:
    """Readings that a model asks for at Table 3 less those of the 6-PUS model, m: same geometry, and as calibrated."""

    nominal: NDArray  # (40, 6)
    calibrated: NDArray


def misfit(letter: str) -> Misfit:
    """Return the reading errors of a model (b, c or d) at Table 3 where the truth is 6-PUS with a rigid platform."""
    machine = known("none")
    at = stand(machine)
    structure, parameters = STRUCTURES[letter], report_set(machine, "none")
    found = calibrate(machine, parameters, at, structure)
    fitted = parameters.machine(machine, found.solution.x[0])
    return Misfit(*(readings_at(structure, one, at.p, at.R).rho - at.rho for one in (machine, fitted)))
