"""Least number of configurations: as many determine all parameters, one fewer do not."""

from __future__ import annotations

import numpy as np

from tests.simulation.mechanisms.telescope import telescope
from truing.calibration.needed_configurations import model_set, needed_configurations
from truing.simulation.mechanisms.legs.kinematics import forward
from truing.simulation.mechanisms.pose_regressors import Placed
from truing.simulation.mechanisms.structures.catalogue import structures
from truing.simulation.mechanisms.structures.structure import Machine, readings_at


def machine() -> Machine:
    return Machine(telescope(), np.zeros((6, 6)), np.full(6, 0.01))


def placed(count: int = 60) -> Placed:
    rho = telescope().rho0 + np.random.default_rng(2).uniform(-1.3e-3, 1.3e-3, (count, 6))
    reached = forward(telescope(), rho)
    return Placed(reached.p, reached.R, rho)


def test_as_many_configurations_determine_the_parameters_and_one_fewer_do_not() -> None:
    other = placed(40)
    for structure in structures(machine()):
        needed = needed_configurations(structure, machine(), placed())
        assert needed is not None
        parameters = model_set(structure, machine())
        own = [k for k, entry in enumerate(parameters.entries) if entry.name in needed.names]
        assert len(own) == needed.parameters
        rho = readings_at(structure, machine(), other.p, other.R).rho
        rows = structure.close(machine(), other.p, other.R, rho, parameters.change(machine())).by_parameter[..., own]
        rows = rows / np.sqrt(np.sum(rows**2, (0, 1)))
        ranks = [
            np.linalg.matrix_rank(rows[:n].reshape(-1, len(own)), tol=1e-8)
            for n in (needed.configurations - 1, needed.configurations)
        ]
        assert ranks[0] < needed.parameters == ranks[1], structure.name


def test_the_report_s_seven_parameters_of_a_leg_need_seven_configurations() -> None:
    rigid = structures(machine())[0]
    needed = needed_configurations(rigid, machine(), placed())
    assert needed is not None
    assert (needed.configurations, needed.parameters, needed.shared) == (7, 42, 0)
