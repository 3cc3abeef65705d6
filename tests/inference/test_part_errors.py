"""Errors of single parts: their information agrees with a dense fit, and their scatter lowers all weights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from truing.inference.part_errors import PartProblem

EPOCHS, ROWS, PARTS, SHARED = 30, 6, 3, 4


def problem(rng: np.random.Generator, errors: np.ndarray, epochs: int = EPOCHS) -> PartProblem:
    """Noise, unknowns that all epochs share, and errors (B, n) of parts along directions that differ by epoch."""
    moved = rng.standard_normal((epochs, ROWS, PARTS))
    moved /= np.sqrt(np.mean(np.sum(moved**2, 1), 0))
    by_shared, shared = rng.standard_normal((epochs, ROWS, SHARED)), rng.standard_normal(SHARED)
    noise = rng.standard_normal((epochs, ROWS))
    residual = by_shared @ shared + (moved @ errors[..., None])[..., 0] + noise
    return PartProblem(moved, by_shared, residual, np.eye(SHARED), np.zeros(SHARED))


def _dense_rest(own: PartProblem, index: int, course: np.ndarray) -> tuple[float, float]:
    """Squares left by a fit of all rows without and with a course (B,) of one part's error."""
    rows = np.concatenate([own.by_shared.reshape(-1, SHARED), own.prior_by_shared])
    values = np.concatenate([own.residual.ravel(), own.prior_residual])
    effect = np.concatenate([(own.moved[:, :, index] * course[:, None]).ravel(), np.zeros(SHARED)])
    constant = np.concatenate([own.moved[:, :, index].ravel(), np.zeros(SHARED)])
    left = []
    for columns in (constant[:, None], np.column_stack([constant, effect])):
        design = np.concatenate([rows, columns], 1)
        left.append(float(np.sum((values - design @ np.linalg.lstsq(design, values)[0]) ** 2)))
    return left[0], left[1]


def test_a_function_explains_as_much_as_a_dense_fit_with_it() -> None:
    rng = np.random.default_rng(1)
    course = rng.standard_normal(EPOCHS)
    errors = np.zeros((EPOCHS, PARTS))
    errors[:, 1] = 3.0 * course
    own = problem(rng, errors)
    found = own.weighted(np.full((EPOCHS, PARTS), 1e-12))
    along, _, _ = found.along(1, course[:, None])
    before, after = _dense_rest(own, 1, course)
    np.testing.assert_allclose(float(along @ along), before - after, rtol=1e-6)


def test_scatter_of_one_part_leaves_less_information_on_it_alone() -> None:
    rng = np.random.default_rng(2)
    errors = np.zeros((EPOCHS, PARTS))
    errors[:, 0] = 5.0 * rng.standard_normal(EPOCHS)
    weight = problem(rng, errors).estimated().weight.mean(0)
    assert weight[0] < 0.15
    assert weight[1:].min() > 3.0 * weight[0]


def test_a_function_that_is_held_explains_nothing_more() -> None:
    rng = np.random.default_rng(3)
    course = rng.standard_normal((EPOCHS, 1))
    errors = np.zeros((EPOCHS, PARTS))
    errors[:, 2] = 4.0 * course[:, 0]
    own = problem(rng, errors)
    quiet = np.full((EPOCHS, PARTS), 1e-12)
    before, _, _ = own.weighted(quiet).along(2, course)
    after, _, _ = own.beyond(2, 100.0 * course).weighted(quiet).along(2, course)
    assert float(before @ before) > 100.0
    assert float(after @ after) < 0.1


def test_no_functions_to_hold_change_nothing() -> None:
    own = problem(np.random.default_rng(4), np.zeros((EPOCHS, PARTS)))
    same = own.beyond(0, np.zeros((EPOCHS, 0)))
    np.testing.assert_array_equal(same.prior_by_shared, own.prior_by_shared)
    np.testing.assert_array_equal(same.by_shared, own.by_shared)


def test_squares_of_any_error_are_those_along_all_unit_vectors() -> None:
    rng = np.random.default_rng(5)
    own = problem(rng, 2.0 * rng.standard_normal((EPOCHS, PARTS)))
    unseen = own.moved.copy()
    unseen[:4, :, 0] = 0.0  # the first part moves nothing in four epochs
    for moved in (own.moved, unseen):
        errors = replace(own, moved=moved).estimated()
        squares, freedom = errors.squares
        for index in range(PARTS):
            along, _, _ = errors.along(index, np.eye(EPOCHS))
            np.testing.assert_allclose(squares[index], along @ along, rtol=1e-6)
            assert freedom[index] == len(along)


def test_an_error_that_an_unknown_takes_has_no_degree_of_freedom() -> None:
    rng = np.random.default_rng(6)
    own = problem(rng, rng.standard_normal((EPOCHS, PARTS)))
    taken = np.zeros((EPOCHS, 1))
    taken[3] = 1e4  # an unknown of any size is the error of the second part in the fourth epoch
    errors = own.beyond(1, taken).weighted(np.full((EPOCHS, PARTS), 1e-12))
    along, _, _ = errors.along(1, np.eye(EPOCHS))
    assert errors.squares[1][1] == len(along) == EPOCHS - 2
    np.testing.assert_allclose(errors.squares[0][1], along @ along, rtol=1e-4)
