"""Named parameters of a machine: conversion in both directions, and the exact derivative of the machine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.mechanisms.telescope import K, telescope
from tests.tolerance import assert_close
from truing.estimation.rotation import exp_so3
from truing.simulation.mechanisms.parameters import LegParameter, ParameterSet, deformation_set, full_set, report_set
from truing.simulation.mechanisms.structures.structure import BeamSection, Machine


def _machine(kind: str = "6-pus") -> Machine:
    sections = BeamSection(0.09, 3.6e5, 0.07), BeamSection(50.0, 1.7e7, 40.0)
    return Machine(telescope(kind), K, np.full(6, 0.01), *sections)


def _tilted() -> Machine:
    """Actuators in three directions, one of them reversed, none along an axis."""
    machine = _machine()
    u = np.repeat([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]], 2, 0) @ exp_so3(np.array([0.2, 0.1, -0.3])).T
    return replace(machine, legs=machine.legs.replace(u=u))


EVERYTHING = {"rho0": True, "flexure_length": True, "sections": True}


@pytest.mark.parametrize("machine", [_machine(), _tilted(), _machine("ups")])
@pytest.mark.parametrize("deformation", ["none", "linear", "matrix"])
def test_values_determine_the_machine(machine: Machine, deformation: str) -> None:
    parameters = full_set(machine, deformation, **EVERYTHING)
    values = parameters.values(machine) + 1e-3 * np.random.default_rng(0).normal(size=len(parameters))
    moved = parameters.machine(machine, values)
    assert_close(parameters.values(moved), values, atol=0.0, what="values")
    assert_close(np.sum(moved.legs.u**2, -1), np.ones(6), atol=1e-15, what="|u|^2")
    assert (np.sum(moved.legs.u * machine.legs.u, -1) > 0.99).all()


@pytest.mark.parametrize("machine", [_machine(), _tilted()])
def test_the_change_of_a_machine_agrees_with_a_complex_step(machine: Machine) -> None:
    parameters, step = full_set(machine, "matrix", **EVERYTHING), 1e-30
    start = parameters.machine(machine, parameters.values(machine))
    change = parameters.change(start)
    stepped = parameters.machine(machine, parameters.values(machine) + 1j * step * np.eye(len(parameters)))
    for field in ("a", "b", "u", "l", "rho0"):
        expected = np.moveaxis(getattr(stepped.legs, field).imag, 0, -1) / step
        assert_close(change.fields[field], expected, atol=1e-14, what=field)
    for field in ("deformation", "flexure_length"):
        assert_close(
            change.fields[field], np.moveaxis(getattr(stepped, field).imag, 0, -1) / step, atol=0.0, what=field
        )
    for field in ("flexure", "tube"):
        section = getattr(stepped, field)
        expected = np.stack([section.bending, section.axial, section.torsion]).imag / step
        assert_close(change.fields[field], expected, atol=0.0, what=field)


def test_values_may_have_leading_batch_axes() -> None:
    machine = _machine()
    chosen = report_set(machine, "linear")
    batch = chosen.values(machine) + np.random.default_rng(1).normal(0.0, 1e-4, (3, 1, len(chosen)))
    moved = chosen.machine(machine, batch)
    assert moved.legs.a.shape == (3, 1, 6, 3)
    assert moved.deformation.shape == (3, 1, 6, 6)
    single = chosen.machine(machine, batch[1, 0])
    assert_close(moved.legs.b[1, 0], single.legs.b, atol=0.0, what="b")
    assert_close(chosen.values(moved), batch, atol=0.0, what="values")


def test_the_sets_of_the_report_hold_its_parameters() -> None:
    machine = _machine()
    leg = [entry.name for entry in report_set(machine, "none").entries if entry.leg == 2]
    assert leg == ["a_x", "a_y", "b_x", "b_y", "u_x", "l"]
    for deformation in ("linear", "matrix"):
        leg = [entry.name for entry in report_set(machine, deformation).entries if entry.leg == 2]
        assert leg == ["a_x", "a_y", "b_x", "b_y", "kappa", "l"]
    assert {entry.name for entry in report_set(_machine("ups"), "none").entries} == {"a_x", "a_y", "b_x", "b_y", "l"}


def test_the_diagonal_moves_while_the_rest_of_the_matrix_stays() -> None:
    machine = _machine()
    moved = report_set(machine, "matrix")
    values = np.where([entry.name == "kappa" for entry in moved.entries], 0.5, moved.values(machine))
    found = moved.machine(machine, values).deformation
    assert_close(found, np.where(np.eye(6, dtype=bool), 0.5, K), atol=0.0, what="K")


def test_parameter_names_are_those_of_the_tables() -> None:
    machine = _machine()
    assert full_set(machine, "none").labels[:3] == ("a_x1", "a_x2", "a_x3")
    assert [entry.name for entry in deformation_set(machine, "matrix").entries][5:8] == ["K16", "K21", "K22"]
    sections = full_set(machine, "none", sections=True).labels[-6:]
    assert sections == tuple(f"{body}_{k}" for body in ("flexure", "tube") for k in ("bending", "axial", "torsion"))


def test_entries_of_a_matrix_of_many_legs_have_distinct_names() -> None:
    legs = telescope("ups")
    twelve = legs.replace(**{name: np.concatenate([getattr(legs, name)] * 2) for name in ("a", "b", "u", "l", "rho0")})
    rng = np.random.default_rng(2)
    machine = Machine(twelve, rng.normal(size=(12, 12)))
    assert_close(deformation_set(machine, "matrix").values(machine), machine.deformation.ravel(), atol=0.0, what="K")


def test_an_unknown_deformation_or_parameter_is_refused() -> None:
    machine = _machine()
    with pytest.raises(ValueError, match="deformation: found 'cubic', expected none, linear, matrix or in-plane"):
        report_set(machine, "cubic")
    with pytest.raises(ValueError, match="found 'kapa', expected a number of the machine"):
        ParameterSet((LegParameter("kapa", 0, "1", 1.0),)).values(machine)
    with pytest.raises(ValueError, match="found no flexure_length"):
        full_set(machine, "none", flexure_length=True).values(replace(machine, flexure_length=None))
    upright = ParameterSet((LegParameter("u_z", 0, "1", 1.0),))
    with pytest.raises(ValueError, match="expected the two smallest"):
        upright.machine(machine, upright.values(machine))
