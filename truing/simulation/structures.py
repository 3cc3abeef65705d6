"""The models of a mechanism's structure that there are, simplest first."""

from __future__ import annotations

from truing.simulation.beam_model import BeamModel
from truing.simulation.jacobian_model import JacobianModel
from truing.simulation.kinematic_model import KinematicModel
from truing.simulation.stiffness_model import StiffnessModel
from truing.simulation.structure import Machine, Structure


def structures(machine: Machine) -> tuple[Structure, ...]:
    """Return the models that the machine holds the numbers for; that of its rigid legs comes first."""
    rigid = KinematicModel(machine.legs.closure.name)
    others: tuple[Structure, ...] = (JacobianModel(), BeamModel(), StiffnessModel())
    return (rigid, *(model for model in others if model.fits(machine)))
