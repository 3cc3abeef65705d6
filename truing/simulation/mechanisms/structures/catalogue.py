"""Available models of a mechanism's structure, simplest first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.simulation.mechanisms.legs.kinematics import forward
from truing.simulation.mechanisms.structures.beam_model import BeamModel
from truing.simulation.mechanisms.structures.kinematic_model import JacobianModel, KinematicModel
from truing.simulation.mechanisms.structures.stiffness_model import StiffnessModel
from truing.simulation.mechanisms.structures.structure import Machine, Structure, readings_at

ALONG = 0.5  # of a leg's turn: its mean direction during a motion from the reference


def structures(machine: Machine) -> tuple[Structure, ...]:
    """Return the models whose numbers the machine has; the model of rigid legs comes first."""
    rigid = KinematicModel(machine.legs.closure.name)
    elastic: tuple[Structure, ...] = (JacobianModel(), BeamModel(), StiffnessModel())
    if machine.follows_motion:
        elastic = (*elastic, StiffnessModel("stiffness-along", ALONG))
    return (rigid, *(model for model in elastic if model.fits(machine)))


def departure(structure: Structure, machine: Machine, rho: NDArray) -> NDArray:
    """Return the readings (B, L), m, of a model minus those of rigid legs, at the poses that rigid legs reach at rho.

    NaN if either does not close. It is the error by neglecting the model over a range of readings.
    """
    reached = forward(machine.legs, rho)
    asked = readings_at(structure, machine, reached.p, reached.R)
    return np.where((reached.converged & asked.converged)[..., None], asked.rho - rho, np.nan)
