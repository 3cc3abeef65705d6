"""Elimination pose by pose with one QR decomposition agrees with one dense least-squares problem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.tolerance import assert_between, assert_close
from truing.inference.linear_problem import Whitened, whiten
from truing.inference.linearised_model import LinearisedModel, columns_of
from truing.inference.shared_rows import SharedRows
from truing.inference.variance_sources import rows_by_source

POSES, ROWS, LOCAL, SHARED, EXTRA = 5, 12, 3, 4, 2


def draw(seed: int, missing: bool = False) -> LinearisedModel:
    rng = np.random.default_rng(seed)
    present = rng.random((POSES, ROWS)) > 0.2 * missing
    kept = present.astype(float)
    return LinearisedModel(
        residual=rng.normal(size=(POSES, ROWS)) * kept,
        by_local=rng.normal(size=(POSES, ROWS, LOCAL)) * kept[..., None],
        by_shared=rng.normal(size=(POSES, ROWS, SHARED)) * kept[..., None],
        local_value=rng.normal(size=(POSES, LOCAL)),
        shared_value=rng.normal(size=SHARED),
        extra_residual=rng.normal(size=EXTRA),
        extra_by_shared=rng.normal(size=(EXTRA, SHARED)),
        present=present,
        local_known=np.ones(LOCAL, bool),
        shared_known=np.ones(SHARED, bool),
    )


def dense(problem: LinearisedModel) -> tuple[NDArray, NDArray]:
    """The whole problem as one matrix, unknowns: shared, then each pose's local ones."""
    rows, right = [], []
    for pose in range(POSES):
        place = np.zeros((LOCAL, POSES * LOCAL))
        place[:, pose * LOCAL : (pose + 1) * LOCAL] = np.eye(LOCAL)
        rows.append(np.hstack([problem.by_shared[pose], problem.by_local[pose] @ place]))
        rows.append(np.hstack([np.zeros((LOCAL, SHARED)), place]))
        right += [problem.residual[pose], -problem.local_value[pose]]
    rows.append(np.hstack([problem.extra_by_shared, np.zeros((EXTRA, POSES * LOCAL))]))
    rows.append(np.hstack([np.eye(SHARED), np.zeros((SHARED, POSES * LOCAL))]))
    return np.vstack(rows), np.concatenate([*right, problem.extra_residual, -problem.shared_value])


def of_few_poses(problem: LinearisedModel) -> LinearisedModel:
    """The problem with unknowns that only one pose, or none, contains."""
    by_shared = problem.by_shared.copy()
    by_shared[np.arange(POSES) != 3, :, 0] = 0.0
    by_shared[np.arange(POSES) != 1, :, 2] = 0.0
    by_shared[..., 1] = 0.0
    return replace(problem, by_shared=by_shared)


def compact(problem: LinearisedModel) -> LinearisedModel:
    """The same problem, of which every pose keeps the unknowns that act there."""
    kept = columns_of(problem.by_shared.any(1))
    assert kept is not None
    wide = np.concatenate([problem.by_shared, np.zeros((POSES, ROWS, 1))], 2)
    return replace(problem, by_shared=np.take_along_axis(wide, kept[0][:, None], 2), columns=kept[0], common=kept[1])


@pytest.mark.parametrize("few", [False, True])
@pytest.mark.parametrize("missing", [False, True])
def test_step_and_covariance_are_those_of_the_dense_problem(missing: bool, few: bool) -> None:
    problem = of_few_poses(draw(1, missing)) if few else draw(1, missing)
    matrix, right = dense(problem)
    solution = np.linalg.lstsq(matrix, right)[0]
    problem = compact(problem) if few else problem
    shared, local = whiten(problem).step()
    assert_close(shared, solution[:SHARED], atol=1e-12, what="shared step")
    assert_close(local.ravel(), solution[SHARED:], atol=1e-12, what="local step")
    covariance = np.linalg.inv(matrix.T @ matrix)[:SHARED, :SHARED]
    assert_close(whiten(problem).covariance(), covariance, atol=1e-12, what="covariance")


def test_a_compact_problem_leaves_what_the_same_one_at_full_width_leaves() -> None:
    problem = of_few_poses(draw(4, missing=True))
    wide, own = whiten(problem), whiten(compact(problem))
    assert_close(own.rows, wide.rows, atol=1e-12, what="rows")
    assert_close(own.rest, wide.rest, atol=1e-12, what="rest")
    assert_close(own.leverage, wide.leverage, atol=1e-12, what="leverage")
    assert_close(own.explained, wide.explained, atol=1e-12, what="explained")
    steps = np.random.default_rng(5).normal(size=(SHARED, 3))
    assert_close(own.problem.moved(steps), wide.problem.moved(steps), atol=1e-12, what="moved")


@pytest.mark.parametrize("few", [False, True])
def test_draws_exclude_the_space_of_the_shared_unknowns(few: bool) -> None:
    problem = of_few_poses(draw(8, missing=True))
    whitened = whiten(compact(problem) if few else problem)
    drawn = np.random.default_rng(9).standard_normal((3, len(whitened.residual)), np.float32)
    free = np.array([row - whitened.rows @ np.linalg.lstsq(whitened.rows, row)[0] for row in drawn.astype(float)])
    found = whitened.without_shared_roughly(drawn)
    assert found.dtype == np.float32
    assert_close(found, free, atol=1e-5)


def test_unknowns_none_of_which_act_in_most_poses_are_solved_for() -> None:
    problem = of_few_poses(draw(6))
    problem = replace(problem, by_shared=problem.by_shared * (np.arange(SHARED) != 3))
    assert compact(problem).common == 0
    matrix, right = dense(problem)
    assert_close(whiten(compact(problem)).step()[0], np.linalg.lstsq(matrix, right)[0][:SHARED], atol=1e-12)


def test_a_problem_whose_unknowns_act_everywhere_is_not_compact() -> None:
    assert columns_of(draw(1).by_shared.any(1)) is None


@pytest.mark.parametrize("missing", [False, True])
def test_each_source_gives_what_errors_of_its_rows_do_in_the_dense_problem(missing: bool) -> None:
    problem = draw(3, missing)
    known = np.array([True, True, True, False])
    problem = replace(problem, shared_known=known, local_known=np.arange(LOCAL) > 0)
    whitened, layout = whiten(problem), {"a": slice(0, 2), "shape": slice(2, 2), "b": slice(2, 3), "cause": slice(3, 4)}
    rows = rows_by_source(whitened, layout, {"cause"}, slice(1, LOCAL))
    assert set(rows) == {"observations", "inputs", "earlier", "plausible", "a", "b", "wide"}
    assert np.all(np.sum(list(rows.values()), axis=0) == 1)
    assert [int(own.sum()) for own in rows.values()] == [POSES * ROWS, POSES * (LOCAL - 1), EXTRA, 1, 2, 1, POSES]
    shared = replace(problem, local_known=np.ones(LOCAL, bool))  # an error that the points of a pose share
    assert int(rows_by_source(whiten(shared), layout, {"cause"}, slice(1, LOCAL))["observations"].sum()) == POSES * (
        ROWS + 1
    )
    found = whitened.covariance_from(rows, slice(1, SHARED))
    assert_close(sum(found.values()), whitened.covariance()[1:, 1:], atol=1e-12, what="sum")
    follows = np.linalg.pinv(dense(problem)[0])[1:SHARED]  # d estimate / d each row
    for name, own in rows.items():
        assert_close(found[name], follows[:, own] @ follows[:, own].T, atol=1e-12, what=name)


@pytest.mark.parametrize("missing", [False, True])
def test_rest_leverage_and_freedom_are_those_of_the_dense_problem(missing: bool) -> None:
    problem = draw(2, missing)
    matrix, right = dense(problem)
    hat = matrix @ np.linalg.pinv(matrix)
    found = whiten(problem)
    assert_close(found.rest, right - hat @ right, atol=1e-12, what="rest")
    assert_close(found.leverage, np.diag(hat), atol=1e-12, what="leverage")
    assert_close(found.explained, float(right @ hat @ right), atol=1e-10, what="explained")
    missed = int(np.sum(~problem.present))
    assert_close(found.freedom, len(right) - missed - np.trace(hat), atol=1e-10, what="freedom")


def test_an_uninformative_prior_counts_as_no_observation() -> None:
    problem = draw(7)
    wide = replace(problem, by_local=problem.by_local * 1e4, local_known=np.zeros(LOCAL, bool))
    measured = POSES * ROWS + EXTRA + SHARED
    assert_close(whiten(wide).freedom, measured - SHARED - POSES * LOCAL, atol=1e-4, what="freedom")


def test_the_rest_of_pure_noise_has_the_variance_of_noise() -> None:
    """Truth drawn from the prior, noise of unit variance: squares of the rest sum to the degrees of freedom."""
    rng, template = np.random.default_rng(5), draw(6)
    ratios = []
    for _ in range(200):
        shared, local = rng.normal(size=SHARED), rng.normal(size=(POSES, LOCAL))
        measured = template.by_shared @ shared + np.einsum("bmh,bh->bm", template.by_local, local)
        found: Whitened = whiten(
            LinearisedModel(
                measured + rng.normal(size=(POSES, ROWS)),
                template.by_local,
                template.by_shared,
                np.zeros((POSES, LOCAL)),
                np.zeros(SHARED),
                template.extra_by_shared @ shared + rng.normal(size=EXTRA),
                template.extra_by_shared,
                template.present,
                template.local_known,
                template.shared_known,
            )
        )
        ratios.append(found.rest @ found.rest / found.freedom)
    # 62 degrees of freedom, 200 draws: sigma of the mean sqrt(2 / 62 / 200) = 1.3 %.
    assert_between(float(np.mean(ratios)), 1 - 4 * 0.013, 1 + 4 * 0.013, what="variance ratio")


@pytest.mark.parametrize("overlapping", [False, True])
def test_products_and_solutions_of_compact_rows_are_those_of_all_rows(overlapping: bool) -> None:
    rng = np.random.default_rng(5)
    epochs, height, common, size = 12, 4, 3, 14
    columns = np.full((epochs, common + 2), size)  # the last number marks an empty column
    columns[:, :common] = [4, 5, 6]
    own = np.zeros((epochs, height, common + 2))
    own[..., :common] = rng.normal(size=(epochs, height, common))
    for epoch in range(epochs):
        columns[epoch, common:] = rng.choice([0, 1, 2, 3, 7, 8, 9, 10, 11, 12, 13], 2, replace=False)
        own[epoch, :2, common] = rng.normal(size=2)
        own[epoch, 1 if overlapping else 2 :, common + 1] = rng.normal()
    rows = SharedRows(own, np.zeros((0, size)), columns, common)
    whole = np.concatenate([rows.at(slice(None)).reshape(-1, size), np.eye(size)])
    values, covariance = rng.normal(size=size), np.linalg.inv(whole.T @ whole)
    found = rows.solved(values)
    assert found is not None
    assert found == pytest.approx(covariance @ values, abs=1e-12)
    assert rows.gram == pytest.approx(whole.T @ whole, abs=1e-12)
    variances = np.diagonal(rows.followed(covariance, slice(None)), axis1=1, axis2=2)
    assert rows.followed_squares(covariance) == pytest.approx(variances, abs=1e-12)


@pytest.mark.parametrize("few", [False, True])
def test_without_epochs_nothing_is_eliminated_anew_and_all_is_as_if_it_were(few: bool) -> None:
    problem = compact(of_few_poses(draw(8, missing=True))) if few else draw(8, missing=True)
    out = np.array([True, False, False, True, False])
    found, expected = whiten(problem).without(out), whiten(problem.without(out))
    assert_close(found.normal_matrix, expected.normal_matrix, atol=1e-12, what="normal matrix")
    assert_close(found.explained, expected.explained, atol=1e-12, what="explained")
    for own, other, what in zip(found.step(), expected.step(), ("shared", "local"), strict=True):
        assert_close(own, other, atol=1e-12, what=what)
    assert not found.local_step(np.zeros(SHARED))[out].any()  # these epochs stay where they are


@pytest.mark.parametrize("few", [False, True])
def test_other_residuals_need_no_elimination(few: bool) -> None:
    rng = np.random.default_rng(9)
    problem = compact(of_few_poses(draw(9))) if few else draw(9)
    residual, local, shared = (rng.normal(size=v.shape) for v in (problem.residual, problem.local_value, np.ones(4)))
    moved = problem.at(residual, local, shared)
    left = problem.extra_residual - problem.extra_by_shared @ (shared - problem.shared_value)
    assert_close(moved.extra_residual, left, atol=1e-12, what="extra rows")
    whitened = whiten(problem)
    _ = whitened.explained  # its factor is kept
    found, expected = whitened.with_residuals(moved), whiten(moved)
    assert_close(found.rest, expected.rest, atol=1e-12, what="rest")
    assert_close(found.explained, expected.explained, atol=1e-12, what="explained")
    assert_close(found.step()[0], expected.step()[0], atol=1e-12, what="step")
