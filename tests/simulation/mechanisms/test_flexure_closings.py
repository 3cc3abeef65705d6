"""Laws that the beam and the stiffness model share: exact derivatives, and those of any structure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.simulation.mechanisms.flexure_telescope import (
    SECTIONS,
    SHAPES,
    crooked,
    flexure_telescope,
    nudged,
    one_field,
    stepped,
)
from tests.simulation.mechanisms.telescope import K, readings
from tests.tolerance import assert_close
from truing.estimation.rotation import exp_so3, log_so3
from truing.simulation.mechanisms.legs.kinematics import forward, reference_change, reference_pose
from truing.simulation.mechanisms.parameters import full_set
from truing.simulation.mechanisms.structures.beam_model import BeamModel, arc_distance
from truing.simulation.mechanisms.structures.stiffness_model import StiffnessModel
from truing.simulation.mechanisms.structures.structure import NO_CHANGE, Machine, Structure, poses_at, readings_at

BEAM, ARC, STIFFNESS = BeamModel(), BeamModel("beam, exact arc", arc_distance), StiffnessModel()
ALONG, AT_POSE = StiffnessModel("along", 0.5), StiffnessModel("at the pose", 1.0)
MODELS = [BEAM, STIFFNESS, ALONG]
KINDS = ["6-pus", "ups"]


def _poses(machine: Machine, rng: np.random.Generator, count: int = 3) -> tuple[NDArray, NDArray, NDArray]:
    """Poses off those that readings lead to, so that nothing closes, and the readings."""
    rho = machine.legs.rho0 + rng.uniform(-1.3e-3, 1.3e-3, (count, 6))
    reached = forward(machine.legs, rho)
    return reached.p + rng.normal(0.0, 1e-5, (count, 3)), exp_so3(rng.normal(0.0, 1e-4, (count, 3))) @ reached.R, rho


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("model", "field"),
    [
        *((model, field) for model in (BEAM, ARC) for field in SHAPES),
        *((model, field) for model in (STIFFNESS, ALONG, AT_POSE) for field in (*SHAPES, *SECTIONS)),
    ],
    ids=lambda part: getattr(part, "name", part),
)
def test_derivatives_agree_with_a_complex_step(model: Structure, field: str, kind: str) -> None:
    rng = np.random.default_rng(5)
    machine = crooked(rng, kind)
    p, R, rho = _poses(machine, rng)
    found, expected = model.close(machine, p, R, rho, one_field(field)), stepped(model, machine, p, R, rho, field)
    assert_close(found.by_twist, expected.by_twist, atol=1e-12, what="by twist")
    assert_close(found.by_rho, expected.by_rho, atol=1e-12, what="by readings")
    # what stiffness changes is the small rest of large forces; sections are in N and N m2
    share = 1e-12 if field in SHAPES else 1e-10
    scale = max(np.abs(expected.by_parameter).max(), 0.1 if field in SHAPES else 0.0)
    assert_close(found.by_parameter, expected.by_parameter, atol=share * scale, what=field)


@pytest.mark.parametrize("kind", KINDS)
def test_the_reference_pose_follows_as_a_complex_step_says(kind: str) -> None:
    machine = crooked(np.random.default_rng(6), kind)
    reference = reference_pose(machine.legs)
    assert np.abs(log_so3(reference.R)).max() > 0.1, "the reference pose is turned"
    for field in ("a", "b", "u", "l", "rho0"):
        change, tiny = one_field(field), 1j * 1e-30
        found = reference_change(machine.legs, reference, change)
        for j, entry in enumerate(np.eye(change.size)):
            moved = reference_pose(nudged(machine, field, tiny * entry.reshape(change.fields[field].shape[:-1])).legs)
            turned = log_so3(moved.R @ np.swapaxes(reference.R, -1, -2))
            twist = np.concatenate([moved.p, turned], -1).imag / 1e-30
            assert_close(found.twist[..., j], twist, atol=1e-11, what=f"twist by {field}")
            assert_close(found.z[..., j], moved.z.imag / 1e-30, atol=1e-11, what=f"z0 by {field}")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_readings_from_poses_give_the_poses_back(model: Structure, kind: str) -> None:
    machine = replace(crooked(np.random.default_rng(7), kind), deformation=K)
    rho = machine.legs.rho0 + (readings(np.random.default_rng(8), 5) - flexure_telescope().legs.rho0)
    reached = poses_at(model, machine, rho)
    asked = readings_at(model, machine, reached.p, reached.R)
    assert reached.converged.all()
    assert asked.converged.all()
    assert_close(asked.rho, rho, atol=1e-12, what="rho, m")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_all_flexures_are_straight_at_the_reference_pose(model: Structure, kind: str) -> None:
    machine = replace(crooked(np.random.default_rng(9), kind), load=np.zeros(6))
    reference = reference_pose(machine.legs)
    found = model.close(machine, reference.p, reference.R, machine.legs.rho0[None], NO_CHANGE)
    assert_close(found.value, np.zeros((1, 6)), atol=1e-14, what="closing, m")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_results_are_independent_of_frames_and_leg_order(model: Structure, kind: str) -> None:
    rng = np.random.default_rng(10)
    machine = crooked(rng, kind)
    p, R, rho = _poses(machine, rng)
    plain = model.close(machine, p, R, rho, NO_CHANGE)
    turn, order = exp_so3(rng.normal(size=3)), rng.permutation(6)
    legs = machine.legs
    arrays = {"a": legs.a @ turn.T, "u": legs.u @ turn.T, "b": legs.b, "l": legs.l, "rho0": legs.rho0}
    other = replace(
        machine,
        legs=legs.replace(**{name: array[order] for name, array in arrays.items()}),
        deformation=machine.deformation[np.ix_(order, order)],
        flexure_length=np.asarray(machine.flexure_length)[order],
        beta=np.asarray(machine.beta)[order],
        load=np.concatenate([turn @ machine.load[:3], turn @ machine.load[3:]]),
    )
    found = model.close(other, p @ turn.T, turn @ R, rho[:, order], NO_CHANGE)
    assert_close(found.value, plain.value[:, order], atol=1e-14, what="closing, m")


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_a_batch_of_machines_gives_the_results_of_single_machines(model: Structure) -> None:
    rng = np.random.default_rng(11)
    plain = crooked(rng, "6-pus")
    parameters = full_set(plain, "matrix", rho0=True, flexure_length=True, sections=model is STIFFNESS)
    p, R, rho = _poses(plain, rng)
    values = parameters.values(plain) * (1 + rng.normal(0.0, 1e-4, (4, 1, len(parameters))))
    batch = parameters.machine(plain, values)
    found = model.close(batch, p, R, rho, parameters.change(batch))
    for place in range(4):
        machine = parameters.machine(plain, values[place, 0])
        alone = model.close(machine, p, R, rho, parameters.change(machine))
        assert_close(found.value[place], alone.value, atol=1e-14, what="closing")
        assert_close(found.by_twist[place], alone.by_twist, atol=1e-13, what="by twist")
        assert_close(found.by_parameter[place], alone.by_parameter, atol=1e-13, what="by parameter")


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_compiled_closing_refuses_a_machine_without_flexures(model: Structure) -> None:
    machine = replace(flexure_telescope(), flexure_length=None)
    assert model.fits(flexure_telescope())
    assert not model.fits(machine)
    with pytest.raises(ValueError, match="found a machine without flexure_length"):
        model.close(machine, *_poses(machine, np.random.default_rng(0)), NO_CHANGE)


def _with_legs(count: int) -> Machine:
    plain = flexure_telescope()
    chosen = np.arange(count) % 6
    names = ("a", "b", "u", "l", "rho0")
    legs = plain.legs.replace(**{name: getattr(plain.legs, name)[chosen] for name in names})
    return replace(plain, legs=legs, flexure_length=np.full(count, 0.01), deformation=np.zeros((count, count)))


@pytest.mark.parametrize(("model", "fitting"), [(BEAM, (6, 7)), (STIFFNESS, (6,))])
def test_compiled_closing_refuses_legs_that_leave_reference_pose_or_readings_open(
    model: Structure, fitting: tuple[int, ...]
) -> None:
    assert tuple(count for count in (3, 5, 6, 7) if model.fits(_with_legs(count))) == fitting
