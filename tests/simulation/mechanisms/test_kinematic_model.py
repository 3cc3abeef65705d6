"""The closure of rigid legs, a laboratory's own closure, and the linear model: reference values and derivatives."""

from __future__ import annotations

from dataclasses import replace
from importlib.metadata import EntryPoint

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.simulation.mechanisms.telescope import KAPPA, REFERENCE, K, readings, telescope, vector
from tests.tolerance import assert_between, assert_close
from truing.estimation.rotation import exp_so3, log_so3
from truing.schemas import installed
from truing.simulation.change import Change
from truing.simulation.mechanisms.calibration_problem import CalibrationProblem
from truing.simulation.mechanisms.legs.closures import Legs, Ups, closures, mechanism
from truing.simulation.mechanisms.legs.kinematics import forward, inverse
from truing.simulation.mechanisms.parameters import full_set, report_set
from truing.simulation.mechanisms.structures.catalogue import departure
from truing.simulation.mechanisms.structures.kinematic_model import JacobianModel, KinematicModel
from truing.simulation.mechanisms.structures.structure import NO_CHANGE, Machine, poses_at, readings_at

NONE = Change({}, 0)
FIELDS = {"a": (6, 3), "b": (6, 3), "u": (6, 3), "l": (6,), "rho0": (6,), "deformation": (6, 6)}


class Pulley(Ups):
    """A cable over a pulley of some size that swivels about z: along its rim, then straight to the platform."""

    name = "pulley"
    radius = 0.02

    def invert(self, legs: Legs, h: NDArray) -> NDArray:
        """The cable's length less the offset."""
        return self._cable(h)[0] - legs.l

    def close(self, legs: Legs, upper: NDArray, rho: NDArray) -> tuple[NDArray, NDArray]:
        """Cable paid out, less the length of its path."""
        way, along = self._cable(upper - legs.a)  # the pulley swivels and turns freely: no work but along the cable
        return legs.l + rho - way, -along

    def close_change(self, legs: Legs, upper: NDArray, rho: NDArray, change: Change) -> NDArray:
        """The entry moves with a."""
        along = self._cable(upper - legs.a)[1]
        moved = np.einsum("...li,...lip->...lp", along, change.get("a", (legs.count, 3)))
        return moved + change.get("l", (legs.count,)) + change.get("rho", (legs.count,))

    def _cable(self, h: NDArray) -> tuple[NDArray, NDArray]:
        """Length (..., L) from the entry, and direction (..., L, 3) of the free part, in the pulley's upright plane.

        The cable leaves the pulley at r (cos, sin) of an angle from the horizontal, where it came on at pi.
        """
        r = self.radius
        out = np.sqrt(h[..., 0] ** 2 + h[..., 1] ** 2)
        x, z = out - r, h[..., 2]
        free = np.sqrt(x**2 + z**2 - r**2)
        sine, cosine = (r * z + free * x) / (r**2 + free**2), (r * x - free * z) / (r**2 + free**2)
        arc = r * (np.pi / 2 + np.arctan(cosine / sine))
        radial = h[..., :2] / out[..., None]
        return free + arc, np.concatenate([radial * sine[..., None], -cosine[..., None]], -1)


def _machine(kind: str = "6-pus", deformation: NDArray = K) -> Machine:
    return Machine(telescope(kind), deformation)


def _pulleys() -> Machine:
    legs = telescope("ups")
    return Machine(legs.replace(closure=Pulley()), K)


def _pose(inputs: dict[str, object]) -> tuple[NDArray, NDArray]:
    return np.array(inputs["p_mm"])[None] * 1e-3, np.array(inputs["R"])[None]


def _shifted(machine: Machine, field: str, nudge: NDArray) -> Machine:
    if field == "deformation":
        return replace(machine, deformation=machine.deformation + nudge)
    return replace(machine, legs=machine.legs.replace(**{field: getattr(machine.legs, field) + nudge}))


def test_closing_with_perturbed_parameters_is_that_of_the_reference() -> None:
    inputs, outputs = vector("eq30")
    legs = telescope()
    given_mm = {name: np.array(inputs[name]) * (1.0 if name == "u" else 1e-3) for name in "abul"}
    legs = legs.replace(**{name: np.broadcast_to(value, getattr(legs, name).shape) for name, value in given_mm.items()})
    rho = np.full((1, 6), inputs["rho_mm"] * 1e-3)
    closing = KinematicModel("6-pus").close(Machine(legs, np.zeros((6, 6))), *_pose(inputs), rho, NONE)
    assert_close(closing.value[0] * 1e3, np.full(6, outputs["f_mm"]), atol=1e-9 * 0.5e3, what="f, mm")


def test_closing_on_a_deforming_platform_is_that_of_the_reference() -> None:
    inputs, outputs = vector("eq40")
    machine = _machine(deformation=KAPPA * np.eye(6))
    rho = machine.legs.rho0[None] + inputs["drho_mm"] * 1e-3
    closing = KinematicModel("6-pus").close(machine, *_pose(inputs), rho, NONE)
    assert_close(closing.value[0, 0] * 1e3, outputs["f_eq38_mm"], atol=1e-9, what="f, mm")


def test_derivatives_are_the_corrected_row_of_the_observability_jacobian() -> None:
    inputs, outputs = vector("eq37")
    machine = _machine(deformation=np.zeros((6, 6)))
    rho = machine.legs.rho0[None] + np.array(inputs["drho_mm"]) * 1e-3
    leg, eye = np.zeros((6, 1)), np.eye(3)
    leg[0] = 1.0
    found = {}
    for name, field in {
        "a": leg[:, None] * eye,
        "b": leg[:, None] * eye,
        "l": leg,
        "deformation": leg[:, None],
    }.items():
        padded = field * np.eye(6)[:, :1, None] if name == "deformation" else field
        closing = KinematicModel("6-pus").close(machine, *_pose(inputs), rho, Change({name: padded}, padded.shape[-1]))
        found[name] = closing.by_parameter[0, 0]
    expected = [outputs[f"{name}{axis}"] for name in "ab" for axis in "xyz"]
    assert_close(np.concatenate([found["a"], found["b"]]), expected, atol=1e-9, what="a, b")
    assert_close(found["l"], [outputs["l"]], atol=1e-12, what="l")
    assert_close(closing.by_rho[0, 0, 0], outputs["rho0"], atol=1e-9, what="reading")


MACHINES = {"6-pus": _machine, "ups": lambda: _machine("ups"), "pulley": _pulleys}


@pytest.mark.parametrize("kind", MACHINES)
@pytest.mark.parametrize("field", [*FIELDS, "rho", "p", "R"])
def test_derivatives_agree_with_a_complex_step(kind: str, field: str) -> None:
    rng = np.random.default_rng(3)
    machine, model, step = MACHINES[kind](), KinematicModel(kind), 1e-30
    rho = readings(rng, 4)
    p, R = np.array([0.0, 0.0, 0.497]) + rng.normal(0.0, 1e-3, (4, 3)), exp_so3(rng.normal(0.0, 0.01, (4, 3)))
    shape = FIELDS.get(field, (6,) if field == "rho" else (3,))
    count = int(np.prod(shape))
    change = Change({field: np.eye(count).reshape(*shape, count)}, count) if field in FIELDS else NONE
    closing = model.close(machine, p, R, rho, change)
    found = {"rho": closing.by_rho, "p": closing.by_twist[..., :3], "R": closing.by_twist[..., 3:]}
    for j in range(count):
        nudge = (1j * step * np.eye(count)[j]).reshape(shape)
        moved = model.close(
            _shifted(machine, field, nudge) if field in FIELDS else machine,
            p + nudge if field == "p" else p,
            exp_so3(nudge) @ R if field == "R" else R,
            rho + nudge if field == "rho" else rho,
            NONE,
        )
        expected = moved.value.imag / step
        size = max(np.abs(expected).max(), 1e-3)
        assert_close(found.get(field, closing.by_parameter)[..., j], expected, atol=1e-12 * size, what=f"{field} {j}")


@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(list(MACHINES)))
def test_poses_from_readings_give_the_readings_back_on_a_deforming_platform(seed: int, kind: str) -> None:
    rng = np.random.default_rng(seed)
    machine, model = MACHINES[kind](), KinematicModel(kind)
    p = np.array([0.0, 0.0, 0.497]) + rng.uniform(-1e-3, 1e-3, (4, 3))
    R = exp_so3(rng.uniform(-0.01, 0.01, (4, 3)))
    found = readings_at(model, machine, p, R)
    reached = poses_at(model, machine, found.rho)
    assert found.converged.all()
    assert reached.converged.all()
    assert_close(reached.p, p, atol=1e-12, what="p, m")
    assert_close(reached.R, R, atol=1e-11, what="R")


def test_a_pulley_of_a_lab_closes_as_any_other_leg() -> None:
    legs = _pulleys().legs
    p, R = np.array([[1e-3, 0.0, 0.497]]), exp_so3(np.array([[0.01, 0.0, 0.02]]))
    rho = inverse(legs, p, R)
    reached = forward(legs, rho)
    assert_close(reached.p, p, atol=1e-12, what="p, m")
    straight = inverse(telescope("ups"), p, R)
    assert (rho - straight > 1e-5).all(), "the way along the rim is longer than the straight one"


def _installed(monkeypatch: pytest.MonkeyPatch, closure: str) -> None:
    point = EntryPoint(name="lab", value=closure, group="truing.closures")
    monkeypatch.setattr(installed, "entry_points", lambda group: [point] if group == point.group else [])


def test_a_closure_of_an_installed_package_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    _installed(monkeypatch, f"{__name__}:Pulley")
    legs = telescope("ups")
    assert isinstance(mechanism("pulley", legs.a, legs.b, None, legs.l, legs.rho0).closure, Pulley)


def test_two_closures_of_one_name_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    _installed(monkeypatch, "truing.simulation.mechanisms.legs.closures:SixPus")
    with pytest.raises(ValueError, match="closure 6-pus: found in two places"):
        closures()


MODEL = JacobianModel()


def _rigid(legs: Legs | None = None) -> Machine:
    return Machine(legs or telescope(), np.zeros((6, 6)))


def _turned_legs(rng: np.random.Generator) -> tuple[Legs, np.ndarray]:
    """The telescope seen from another base frame, with its platform frame turned by yet another rotation."""
    base, platform = exp_so3(rng.normal(0.0, 0.5, (2, 3)))
    legs = telescope()
    return legs.replace(a=legs.a @ base.T, u=legs.u @ base.T, b=legs.b @ platform), base


def test_readings_are_those_of_the_reference() -> None:
    inputs, outputs = vector("eq9")
    p, R = np.array(inputs["p_mm"])[None] * 1e-3, exp_so3(np.array(inputs["rotvec_rad"]))[None]
    found = readings_at(MODEL, _rigid(), p, R)
    assert found.converged.all()
    assert_close(found.rho[0] * 1e3, outputs["rho_mm"], atol=1e-9 * 10.0, what="rho, mm")


def test_closing_is_that_of_the_reference() -> None:
    inputs, outputs = vector("eq31")
    rho = telescope().rho0[None] + np.array(inputs["drho_mm"]) * 1e-3
    p, R = np.array(inputs["p_mm"])[None] * 1e-3, np.array(inputs["R"])[None]
    found = MODEL.close(_rigid(), p, R, rho, NO_CHANGE).value[0] * 1e3
    assert_close(found, outputs["f_mm"], atol=1e-9 * 1.3, what="f, mm")


def test_linearity_costs_what_the_reference_says_over_the_report_s_configurations() -> None:
    rho = telescope().rho0 + 1.3e-3 * np.array(REFERENCE["configurations"])
    error_um = departure(JacobianModel(), _rigid(), rho) * 1e6
    assert_between(np.sqrt(np.mean(error_um**2)), 29.55, 29.65, what="rms, um")
    assert_between(np.abs(error_um).max(), 83.5, 84.5, what="maximum, um")


def test_the_error_of_linearity_grows_with_the_square_of_the_travel() -> None:
    moves = readings(np.random.default_rng(0), 20) - telescope().rho0
    near, far = (departure(JacobianModel(), _rigid(), telescope().rho0 + reach * moves) for reach in (1e-3, 2e-3))
    assert_between(np.sqrt(np.sum(far**2) / np.sum(near**2)), 3.999, 4.001, what="ratio")


def test_a_linear_deformation_scales_the_readings_of_actuators_along_z() -> None:
    rho = readings(np.random.default_rng(1), 5)
    reached = forward(telescope(), rho)
    rigid = MODEL.close(_rigid(), reached.p, reached.R, rho, NO_CHANGE)
    bent = MODEL.close(Machine(telescope(), KAPPA * np.eye(6)), reached.p, reached.R, rho, NO_CHANGE)
    assert_close(bent.value, rigid.value - KAPPA * (rho - telescope().rho0), atol=1e-15, what="f, m")


def test_any_frames_give_the_same_closing() -> None:
    legs, base = _turned_legs(np.random.default_rng(2))
    rho = readings(np.random.default_rng(3), 4)
    straight = MODEL.close(_rigid(), *_at(telescope(), rho), rho, NO_CHANGE).value
    p, R = _at(telescope(), rho)
    reference = _at(legs, legs.rho0[None])[1]
    assert np.abs(log_so3(reference[0])).max() > 0.1, "the reference pose is turned"
    level = _at(telescope(), telescope().rho0[None])[1]
    turned = MODEL.close(
        _rigid(legs), p @ base.T, base @ R @ level.swapaxes(1, 2) @ base.T @ reference, rho, NO_CHANGE
    ).value
    assert_close(turned, straight, atol=1e-14, what="f, m")


def _at(legs: Legs, rho: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    reached = forward(legs, rho)
    assert reached.converged.all()
    return reached.p, reached.R


@pytest.mark.parametrize("kind", ["6-pus", "ups"])
def test_derivatives_agree_with_a_complex_step_through_the_forward_kinematics(kind: str) -> None:
    machine, step = Machine(telescope(kind), K), 1e-30
    rho = readings(np.random.default_rng(4), 3)
    p, R = _at(machine.legs, rho)
    everything = full_set(machine, "matrix", rho0=True)
    start = everything.values(machine) + np.random.default_rng(5).normal(0.0, 1e-4, len(everything))
    moved = everything.machine(machine, start)
    closing = MODEL.close(moved, p, R, rho, everything.change(moved))
    for j, label in enumerate(everything.labels):
        there = everything.machine(machine, start + 1j * step * np.eye(len(start))[j])
        expected = MODEL.close(there, p, R, rho, NO_CHANGE).value.imag / step
        assert_close(closing.by_parameter[..., j], expected, atol=1e-11, what=label)
    for j in range(6):
        nudge = 1j * step * np.eye(6)[j]
        shifted = MODEL.close(moved, p + nudge[:3], exp_so3(nudge[3:]) @ R, rho, NO_CHANGE).value.imag / step
        assert_close(closing.by_twist[..., j], shifted, atol=1e-12, what=f"twist {j}")
        driven = MODEL.close(moved, p, R, rho + nudge, NO_CHANGE).value.imag / step
        assert_close(closing.by_rho[..., j], driven, atol=1e-12, what=f"reading {j}")


def test_poses_from_readings_give_the_readings_back() -> None:
    machine = Machine(telescope(), K)
    rho = readings(np.random.default_rng(6), 5)
    reached = poses_at(MODEL, machine, rho)
    found = readings_at(MODEL, machine, reached.p, reached.R)
    assert reached.converged.all()
    assert_close(found.rho, rho, atol=1e-14, what="readings, m")


def test_fewer_than_six_legs_have_no_home() -> None:
    legs = telescope("ups")
    three = legs.replace(**{name: getattr(legs, name)[:3] for name in ("a", "b", "u", "l", "rho0")})
    assert MODEL.fits(_rigid())
    assert not MODEL.fits(Machine(three, np.zeros((3, 3))))


def test_a_machine_without_a_home_has_no_closing_and_leaves_the_others_alone() -> None:
    """A solver's trial may leave the sphere of directions, or tear the legs apart: NaN, without error or warning."""
    rng = np.random.default_rng(7)
    machine, rho = _rigid(), readings(rng, 3)
    problem = CalibrationProblem(MODEL, machine, report_set(machine, "none"), *_at(machine.legs, rho), rho)
    values = np.stack([problem.start] * 3)
    values[0, problem.parameters.labels.index("u_x2")] = 1.2
    values[1, [problem.parameters.labels.index(f"l{leg}") for leg in (1, 3, 5)]] = 0.05
    found = problem.constrain(values, np.zeros((3, 3, 12)))
    assert not np.isfinite(found.value[0]).all()
    assert not np.isfinite(found.value[1]).all()
    alone = problem.constrain(problem.start, np.zeros((3, 12)))
    assert_close(found.value[2], alone.value, atol=1e-15, what="f, m")
    assert_close(found.by_values[2], alone.by_values, atol=1e-13, what="derivatives")
