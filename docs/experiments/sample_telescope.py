"""The nominal telescope of sample_data/telescope, and its leg closures at Table 3 of its report."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from docs.experiments.telescope_report_data import published
from truing.estimation.design.observability import Observability, observe
from truing.schemas.campaign import read_campaign
from truing.simulation.mechanisms.calibration_problem import CalibrationProblem
from truing.simulation.mechanisms.parameters import LegParameter, ParameterSet
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
from truing.simulation.mechanisms.structures.structure import Machine, Structure, poses_at
from truing.stages.common.nominal_mechanism import nominal_machine

if TYPE_CHECKING:
    from truing.schemas.mechanism import LeggedMechanism

PROJECT = Path(__file__).resolve().parents[2]
CAMPAIGN = PROJECT / "sample_data" / "telescope" / "campaign.toml"
NOISE_M = 5e-6  # of a leg's closing in one pose
SIX = ("a_x", "a_y", "b_x", "b_y", "u_x", "l")
RIGID = KinematicModel("6-pus")
LEGS = range(6)


@cache
def nominal() -> Machine:
    """The telescope of the sample campaign, with a rigid platform."""
    section = read_campaign(tomllib.loads(CAMPAIGN.read_text(encoding="utf-8"))).mechanism
    return nominal_machine(cast("LeggedMechanism", section))


@cache
def tolerances() -> dict[str, float]:
    """Tolerances of a, b, l (m) and u by their first letter; of kappa the scatter of the published K."""
    given = tomllib.loads(CAMPAIGN.read_text(encoding="utf-8"))["mechanism"]["tolerance"]
    length = 1e-3 * given["length_mm"]
    return {"a": 1e-3 * given["a_mm"], "b": 1e-3 * given["b_mm"], "l": length, "r": length, "u": given["u"], "k": 0.01}


def parameters(names: tuple[str, ...]) -> ParameterSet:
    """Parameters of every leg, leg by leg."""
    units = {"u": ("1", 1.0), "k": ("1", 1.0)}
    return ParameterSet(
        tuple(LegParameter(name, leg, *units.get(name[0], ("mm", 1e-3))) for leg in LEGS for name in names)
    )


def readings() -> NDArray:
    """Actuators (40, 6) at Table 3, m."""
    return nominal().legs.rho0 + published().calibration


def problem(names: tuple[str, ...], truth: Machine | None = None, model: Structure = RIGID) -> CalibrationProblem:
    """The calibration of the rigid telescope on exact poses of a true one."""
    found = poses_at(model, nominal() if truth is None else truth, readings())
    if not found.converged.all():
        raise ArithmeticError("a configuration of Table 3 does not close")
    return CalibrationProblem(RIGID, nominal(), parameters(names), found.p, found.R, readings())


def closings(of: CalibrationProblem) -> tuple[NDArray, NDArray]:
    """Closings (40, 6), m, at nominal values and derivatives (40, 6, P), per unit of the tables: mm and 1."""
    at = of.constrain(of.start, np.zeros((len(of.rho), of.deviations)))
    return at.value, at.by_values * of.parameters.units


def leg_jacobian(names: tuple[str, ...], leg: int) -> NDArray:
    """Whitened derivatives (40, P) of a leg's closings by its own parameters."""
    own = slice(leg * len(names), (leg + 1) * len(names))
    return closings(problem(names))[1][:, leg, own] / NOISE_M


def scales(names: tuple[str, ...], wide: float = 1.0) -> NDArray:
    """Tolerances (P,) of one leg's parameters in the tables' units, or this many times as wide ones."""
    return wide * np.array([tolerances()[name[0]] for name in names]) / parameters(names).units[: len(names)]


def leg_observability(names: tuple[str, ...], leg: int, wide: float = 1.0) -> Observability:
    """Measured values of a leg."""
    labels = [LegParameter(name, leg, "", 1.0).label for name in names]
    return observe(leg_jacobian(names, leg), scales(names, wide), labels)
