"""Rank, singular values, indices and predicted sigmas: the telescope's reference values, and laws that hold for all."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.estimation.telescope_rows import COLUMNS, DRHO_MM, LEGS, REFERENCE, directions, gaps, leg_rows, poses, rows
from tests.simulation.mechanisms.telescope import KAPPA, telescope
from tests.tolerance import assert_between, assert_close
from truing.estimation.design.observability import indices, observe
from truing.simulation.mechanisms.calibration_problem import CalibrationProblem
from truing.simulation.mechanisms.parameters import LegParameter, ParameterSet
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
from truing.simulation.mechanisms.structures.structure import Machine

EPS = np.finfo(float).eps
ANYTHING = 1e12  # tolerances: only what is null to rounding counts as unidentifiable
SEVEN = ["ax", "ay", "bx", "by", "ux", "uy", "l"]
SEEDS = st.integers(0, 2**32 - 1)
PRINTED = 5e-6  # relative, of the reference's six digits


def plain(names, leg):
    """The observability of a leg in mm, neither whitened nor scaled."""
    return observe(rows(names, leg), np.ones(len(names)), names, unidentifiable=ANYTHING)


def draw(seed, count=20, size=5):
    rng = np.random.default_rng(seed)
    return rng, rng.normal(size=(count, size)), rng.uniform(0.1, 10.0, size), [f"x{j}" for j in range(size)]


@pytest.mark.parametrize("leg", LEGS)
@pytest.mark.parametrize("name", REFERENCE["sets"])
def test_singular_values_of_every_leg_and_set(name, leg):
    expected = REFERENCE["sets"][name]
    found = plain(expected["parameters"], leg)
    values = np.array(expected["legs"][leg]["singular_values"])
    null = values < found.rounding
    assert_close(found.singular_values[~null] / values[~null], np.ones(np.sum(~null)), atol=PRINTED)
    assert np.all(found.singular_values[null] < found.rounding)


@pytest.mark.parametrize("leg", LEGS)
@pytest.mark.parametrize("name", REFERENCE["sets"])
def test_weakest_directions_of_every_leg_and_set(name, leg):
    expected = REFERENCE["sets"][name]
    found, weakest = plain(expected["parameters"], leg), np.array(expected["legs"][leg]["weakest_directions"])
    for k, direction in enumerate(weakest):
        assert 1.0 - abs(direction @ found.directions[:, -1 - k]) < 5e-6 * np.sqrt(len(direction))  # five decimals


def test_rho0_is_null_to_rounding_and_costs_one_rank():
    names = REFERENCE["sets"]["a3 b3 ux uy l rho0"]["parameters"]
    for leg in LEGS:
        found = plain(names, leg)
        assert found.rank == len(names) - 1
        assert found.condition == np.inf
        null = found.directions[:, -1] * np.sign(found.directions[2, -1])
        turned = found.rounding / found.singular_values[-2]
        assert_close(null, (np.isin(names, "az") * 1.0 - np.isin(names, "rho0")) / np.sqrt(2), atol=turned)
        hidden = np.isin(names, ["az", "rho0"])
        assert np.array_equal(np.isinf(found.sigma), hidden)
        without = plain([name for name in names if name != "rho0"], leg)
        kept = [j for j, name in enumerate(names) if not hidden[j]]
        assert_close(found.sigma[kept] / without.sigma[[j for j in kept if j < 9]], np.ones(8), atol=turned)


def test_a_row_is_equation_37_without_the_factor_one_half():
    given_at, expected = REFERENCE["eq37"]["inputs"], REFERENCE["eq37"]["outputs"]
    p, R = np.array([given_at["p_mm"]]), np.array([given_at["R"]])
    row = leg_rows(p, R, np.array([given_at["drho_mm"][0]]), 0)[0]
    assert_close(row, [expected[name] for name in COLUMNS], atol=1e-9 * max(map(abs, expected.values())))


@pytest.mark.parametrize("leg", LEGS)
def test_the_rows_are_those_of_the_kinematic_model(leg):
    names = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "u_x", "u_y", "l", "kappa")
    entries = tuple(LegParameter(name, leg, "", 1.0 if name[0] in "uk" else 1e-3) for name in names)
    p, R = poses()
    machine = Machine(telescope(), np.zeros((6, 6)))
    model = CalibrationProblem(
        KinematicModel("6-pus"), machine, ParameterSet(entries), 1e-3 * p, R, 1e-3 * (DRHO_MM + 10)
    )
    found = model.constrain(model.start, np.zeros((len(p), model.deviations))).by_values[:, leg]
    own = rows([name.replace("_", "") for name in names], leg)
    assert_close(1e3 * found * model.parameters.units, own, atol=1e-12 * np.abs(own).max())


def test_the_gap_closes_over_kappa_as_equations_38_to_40_have_it():
    inputs, expected = REFERENCE["eq40"]["inputs"], REFERENCE["eq40"]["outputs"]
    p, R, drho = np.array([inputs["p_mm"]]), np.array([inputs["R"]]), np.array([inputs["drho_mm"]])
    along_platform, along_base = R[:, :, 2] * KAPPA * drho, np.array([[0.0, 0.0, 1.0]]) * KAPPA * drho
    rigid = gaps(p, R, drho, 0)
    for shift, name in ((along_platform, "f_eq38_mm"), (along_base, "f_eq40_mm")):
        assert_close(500.0 - np.linalg.norm(rigid + shift), expected[name], atol=1e-12 * 500.0, what=name)
    first_order = 500.0 - np.linalg.norm(rigid) + KAPPA * leg_rows(p, R, drho, 0)[0, -1]
    assert_close(first_order, expected["f_eq38_mm"], atol=(KAPPA * drho[0]) ** 2 / (2 * 500.0))


@pytest.mark.parametrize("leg", LEGS)
def test_kappa_trades_against_the_direction_of_the_actuator(leg):
    """u_x, kappa and a_x change as 1 : slope : -rho0, as far as the slope of the leg is the same in all poses."""
    names = ["ax", "ay", "bx", "by", "ux", "l", "kappa"]
    z, R = directions(*poses(), DRHO_MM[:, leg], leg), poses()[1]
    slope = z[:, 0] / np.einsum("bi,bi->b", z, R[:, :, 2])
    trade = np.array([-10.0, 0, 0, 0, 1.0, 0, slope.mean()])
    largest = np.sqrt(np.sum((np.abs(slope - slope.mean()) * np.abs(DRHO_MM[:, leg])) ** 2))
    assert_between(
        np.linalg.norm(rows(names, leg) @ trade), plain(names, leg).singular_values[-1] * 10.0, largest, what="trade"
    )
    assert plain(names, leg).singular_values[-1] < 0.7 * plain(names[:-1], leg).singular_values[-1]


def test_log_determinants_of_the_reference():
    for key, names in (
        ("seven_parameters", SEVEN),
        ("six_parameters_ux", ["ax", "ay", "bx", "by", "ux", "l"]),
        ("six_parameters_kappa", ["ax", "ay", "bx", "by", "kappa", "l"]),
    ):
        found = [indices(plain(names, leg).singular_values, len(DRHO_MM)).log_determinant for leg in LEGS]
        assert_close(found, REFERENCE["log_determinant"][key], atol=1e-6 * 30, what=key)
    values = REFERENCE["log_determinant"]["singular_values_leg1_seven"]
    assert_close(plain(SEVEN, 0).singular_values / values, np.ones(7), atol=1e-6)


@given(SEEDS)
def test_o1_orders_pose_sets_alike_in_all_units_and_after_column_operations(seed):
    rng, first, scale, _ = draw(seed)
    second, mix = rng.normal(size=first.shape), rng.normal(size=(5, 5)) + 3.0 * np.eye(5)
    difference = [
        indices(np.linalg.svd(A, compute_uv=False), 20).log_determinant
        - indices(np.linalg.svd(B, compute_uv=False), 20).log_determinant
        for A, B in ((first, second), (first * scale, second * scale), (first @ mix, second @ mix))
    ]
    rounding = 1e3 * EPS * np.linalg.cond(first @ mix) * np.linalg.cond(second @ mix)
    assert_close(difference, np.full(3, difference[0]), atol=rounding)


def test_rho0_leaves_o1_as_it_is_since_it_only_moves_the_columns_of_u():
    """rho enters the columns of u alone; another rho0 adds to them z_x and z_y, which are the columns of a."""
    for leg in LEGS:
        J, names = rows(SEVEN, leg), SEVEN
        moved = J.copy()
        moved[:, names.index("ux")] += 25.0 * J[:, names.index("ax")]
        moved[:, names.index("uy")] += 25.0 * J[:, names.index("ay")]
        logs = [indices(np.linalg.svd(A, compute_uv=False), 40).log_determinant for A in (J, moved)]
        assert_close(logs[1], logs[0], atol=100 * EPS * np.linalg.cond(moved))


def test_indices_are_those_of_the_literature():
    s = np.array([8.0, 4.0, 2.0])
    found = indices(s, poses=16)
    assert_close(found.o1, 4.0 / 4.0, atol=4 * EPS)
    assert (found.o2, found.o3, found.o4) == (0.25, 2.0, 0.5)
    assert_close(found.o5, 8.0 / 7.0, atol=4 * EPS)
    assert_close(found.log_determinant, np.log(64.0**2), atol=32 * EPS)
    assert indices(np.array([1.0, 0.0]), 4).o1 == indices(np.array([1.0, 0.0]), 4).o5 == 0.0


@given(SEEDS)
def test_indices_scale_as_they_should(seed):
    rng, J, _, _ = draw(seed)
    s, factor = np.linalg.svd(J, compute_uv=False), rng.uniform(0.1, 10.0)
    one, other = indices(s, 20), indices(factor * s, 20)
    for name in ("o1", "o3", "o4", "o5"):
        assert getattr(other, name) == pytest.approx(factor * getattr(one, name), rel=1e-13)
    assert other.o2 == pytest.approx(one.o2, rel=1e-13)
    assert one.o4 <= one.o3 <= one.o1 * np.sqrt(20) <= s[0] * (1 + 1e-13)
    assert s[-1] / 5 * (1 - 1e-13) <= one.o5 <= s[-1] * (1 + 1e-13)


@given(SEEDS)
def test_results_are_independent_of_units_rows_and_order(seed):
    rng, J, scale, labels = draw(seed)
    unit, order = 10.0 ** rng.integers(-3, 4, 5), rng.permutation(5)
    turn = np.linalg.qr(rng.normal(size=(20, 20)))[0]
    found = observe(J, scale, labels)
    other = observe((turn @ J / unit)[:, order], (scale * unit)[order], [labels[j] for j in order])
    assert found.rank == other.rank
    assert_close(other.singular_values, found.singular_values, atol=100 * found.rounding)
    relative = 100 * EPS * found.condition
    assert_close(other.sigma / unit[order] / found.sigma[order], np.ones(5), atol=relative)
    assert_close(other.sigma_with_prior / unit[order] / found.sigma_with_prior[order], np.ones(5), atol=relative)


@given(SEEDS)
def test_sigmas_are_those_of_the_normal_equations(seed):
    _, J, scale, labels = draw(seed)
    found, normal = observe(J, scale, labels), J.T @ J
    relative = 100 * EPS * np.linalg.cond(normal)
    assert_close(found.sigma / np.sqrt(np.diag(np.linalg.inv(normal))), np.ones(5), atol=relative)
    both = np.sqrt(np.diag(np.linalg.inv(normal + np.diag(scale**-2))))
    assert_close(found.sigma_with_prior / both, np.ones(5), atol=relative)
    assert np.all(found.sigma_with_prior <= np.minimum(found.sigma, scale) * (1 + 1e-12))


def test_predicted_sigma_is_the_scatter_of_repeated_measurements():
    rng, names, leg = np.random.default_rng(1), ["ax", "ay", "bx", "by", "ux", "l"], 0
    J, runs = rows(names, leg) / 0.005, 2000
    fitted = np.linalg.lstsq(J, rng.normal(size=(40, runs)))[0]
    for ratio in fitted.std(axis=1) / observe(J, np.ones(6), names).sigma:
        assert_between(ratio, 1 - 4 / np.sqrt(2 * runs), 1 + 4 / np.sqrt(2 * runs), what="scatter")


def test_a_direction_is_unidentifiable_where_the_data_show_less_than_the_drawing():
    J = np.diag([10.0, 0.5])
    found = observe(J, [1.0, 1.0], ["strong", "weak"])
    assert found.rank == 1
    assert list(found.identifiable) == [True, False]
    assert observe(J, [1.0, 3.0], ["strong", "weak"]).rank == 2  # a looser drawing makes the same data worth having
    assert observe(J, [1.0, 1.0], ["strong", "weak"], unidentifiable=3.0).rank == 2


def test_fewer_measurements_than_parameters_leave_null_directions():
    found = observe(np.array([[3.0, 4.0, 0.0]]), np.ones(3), ["x", "y", "z"])
    assert found.rank == 1
    assert_close(found.singular_values, [5.0, 0.0, 0.0], atol=found.rounding)
    assert np.isinf(found.sigma).all()
    assert_close(found.sigma_with_prior, [np.sqrt(1 - 9 / 26), np.sqrt(1 - 16 / 26), 1.0], atol=8 * EPS)
    nothing = observe(np.zeros((4, 2)), np.ones(2), ["x", "y"])
    assert nothing.rank == 0
    assert np.isinf(nothing.sigma).all()


@pytest.mark.parametrize(
    ("jacobian", "scales", "message"),
    [
        (np.ones((4, 3)), np.ones(2), "scales"),
        (np.ones(4), np.ones(4), "jacobian"),
        (np.ones((4, 3)), [1.0, 0.0, 1.0], "positive"),
        (np.full((4, 3), np.nan), np.ones(3), "finite"),
    ],
)
def test_bad_input_is_refused(jacobian, scales, message):
    with pytest.raises(ValueError, match=message):
        observe(jacobian, scales, ["x", "y", "z"])
