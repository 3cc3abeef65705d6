"""Regressors over configurations: the reference's determinants, exact derivatives, any closure and number of legs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import docs.experiments
from tests.simulation.mechanisms.telescope import telescope, vector
from tests.tolerance import assert_between, assert_close
from truing.estimation.design.feasible_region import FeasibleRegion
from truing.estimation.design.pose_selection import bound_design, exchange, information_of, sum_log_det
from truing.simulation.mechanisms.legs.closures import mechanism
from truing.simulation.mechanisms.parameters import LegParameter, ParameterSet, full_set
from truing.simulation.mechanisms.pose_regressors import Placed, PoseRegressors, leg_by_leg, pose_regressors
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
from truing.simulation.mechanisms.structures.structure import Machine, poses_at

REACH = 1.3e-3
SEVEN = ("a_x", "a_y", "b_x", "b_y", "u_x", "u_y", "l")
MILLIMETRES = np.array([1.0, 1.0, 1.0, 1.0, 1e3, 1e3, 1.0])  # rows per parameter in mm and 1, residual in mm
FREE = np.full(6, np.inf)


def regressors(legs=None, names=SEVEN, pose_range=FREE, reach=REACH) -> PoseRegressors:
    machine = Machine(telescope() if legs is None else legs, np.zeros((6, 6)) if legs is None else np.zeros((8, 8)))
    count = machine.legs.count
    chosen = ParameterSet(tuple(LegParameter(name, leg, "", 1.0) for name in names for leg in range(count)))
    structure = KinematicModel(machine.legs.closure.name)
    return pose_regressors(structure, machine, chosen, pose_range, np.full(count, reach))


def octopod():
    """Eight legs of variable length on two rings."""
    leg = np.arange(8)
    about = leg // 2 * np.pi / 2 + np.where(leg % 2, 0.2, -0.2), leg // 2 * np.pi / 2 + np.where(leg % 2, 0.6, -0.6)
    a, b = (r * np.stack([np.cos(t), np.sin(t), 0 * t], -1) for r, t in zip((0.3, 0.2), about, strict=True))
    return mechanism("ups", a, b, None, np.linalg.norm(b - a + np.array([0, 0, 0.4]), axis=-1), np.zeros(8))


def rows_in_mm(levels) -> np.ndarray:
    """Rows at actuators moved by levels (N, 6) of their reach."""
    found = regressors()
    rho = found.machine.legs.rho0 + REACH * np.asarray(levels, float)
    reached = poses_at(found.structure, found.machine, rho)
    assert reached.converged.all()
    return found.rows(Placed(reached.p, reached.R, rho)) * MILLIMETRES


def table_3() -> np.ndarray:
    file = Path(docs.experiments.__path__[0]) / "published_telescope.json"
    return np.array(json.loads(file.read_text(encoding="utf-8"))["calibration_configurations"]["by_actuator"]).T


def test_a_row_is_that_of_equation_37():
    inputs, outputs = vector("eq37")
    names = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "u_x", "u_y", "l", "rho0", "kappa")
    found = regressors(names=[name for name in names if name not in ("rho0", "kappa")])
    rho = found.machine.legs.rho0 + np.array(inputs["drho_mm"]) * 1e-3
    placed = Placed(np.array([inputs["p_mm"]]) * 1e-3, np.array([inputs["R"]]), rho[None])
    expected = [outputs[name.replace("_", "")] * (1e-3 if name.startswith("u") else 1.0) for name in names[:9]]
    assert_close(found.rows(placed)[0, 0], expected, atol=1e-11)


def test_table_3_has_the_determinant_of_the_reference():
    information = information_of(rows_in_mm(table_3()))
    assert sum_log_det(information) == pytest.approx(-177.8, abs=0.05)
    # its own leg by leg, from the reference's singular values
    expected = [-29.597113426, -29.139592477, -30.120860099, -30.040189906, -29.571338353, -29.310067783]
    assert_close(np.linalg.slogdet(information)[1], expected, atol=1e-6)


def test_random_corners_of_the_actuators_are_better_than_table_3():
    levels = np.stack(np.meshgrid(*[[-1, 1]] * 6, indexing="ij"), -1).reshape(-1, 6)
    rows = rows_in_mm(levels)
    rng = np.random.default_rng(0)
    values = [sum_log_det(information_of(rows[rng.integers(0, 64, 40)])) for _ in range(150)]
    assert_between(np.mean(values), -169.7 - 4 * 1.4 / np.sqrt(150) - 0.5, -169.7 + 4 * 1.4 / np.sqrt(150) + 0.5)
    assert min(values) > -177.8


def test_exchange_from_table_3_reaches_the_reference_and_the_bound():
    levels = np.stack(np.meshgrid(*[[-1, 0, 1]] * 6, indexing="ij"), -1).reshape(-1, 6)
    rows = rows_in_mm(levels)
    start = ((table_3() + 1) @ 3 ** np.arange(6)[::-1]).astype(int)
    found = exchange(rows, start)
    assert found.log_det == pytest.approx(-164.4, abs=0.05)
    assert found.log_det < bound_design(rows, 40).upper
    assert np.all(levels[found.chosen] != 0)


@pytest.mark.parametrize(("legs", "names"), [(None, SEVEN), (octopod(), ("a_x", "a_y", "a_z", "b_x", "b_z", "l"))])
def test_derivatives_are_exact(legs, names):
    found = regressors(legs, names, reach=0.01)
    x = np.random.default_rng(1).uniform(-0.7, 0.7, (4, 6))
    rows, changes = found.rows_and_changes(x)
    assert_close(rows, found.rows(found.at(x)), atol=1e-14)
    _, slopes = found.quantities(x)
    step = 1e-5
    for i, along in enumerate(step * np.eye(6)):
        differences = (found.rows(found.at(x + along)) - found.rows(found.at(x - along))) / (2 * step)
        assert_close(changes[..., i], differences, atol=1e-9)
        values = (found.quantities(x + along)[0] - found.quantities(x - along)[0]) / (2 * step)
        assert_close(slopes[..., i], values, atol=1e-9)


def test_coordinates_are_the_inverse_of_placing():
    found = regressors()
    x = np.random.default_rng(2).uniform(-0.7, 0.7, (20, 6))
    placed = found.at(x)
    assert_close(found.coordinates(placed), x, atol=1e-9)
    again = poses_at(found.structure, found.machine, placed.rho)
    assert_close(again.p, placed.p, atol=1e-12)


def test_corners_of_actuators_without_other_limits_are_their_64_ends():
    found = regressors()
    none = np.empty((0, 12))
    region = FeasibleRegion(6, found.quantities, np.concatenate([FREE, np.full(6, REACH)]), none, none)
    ends = (found.at(region.corners()).rho - found.machine.legs.rho0) / REACH
    assert_close(np.abs(ends), np.ones((64, 6)), atol=1e-9)
    assert len(np.unique(np.sign(ends), axis=0)) == 64


def test_limits_that_leave_the_platform_free_are_refused():
    machine = Machine(telescope(), np.zeros((6, 6)))
    limits = np.array([1e-3, 1e-3, 1e-4, 0.01, 0.01, np.inf])
    with pytest.raises(ValueError, match="in all six directions"):
        pose_regressors(KinematicModel("6-pus"), machine, full_set(machine, "none"), limits, FREE)


def test_shared_parameters_are_no_leg_s_own():
    machine = Machine(telescope(), np.zeros((6, 6)))
    for entries in ((LegParameter("a_x", 0, "mm", 1e-3),), (LegParameter("flexure_axial", -1, "N", 1.0),)):
        with pytest.raises(ValueError, match="the same number of each"):
            leg_by_leg(machine, ParameterSet(entries))
