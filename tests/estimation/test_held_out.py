"""Choice of a model by held-out poses: excluded beyond noise, else the most probable, else the simplest."""

from __future__ import annotations

import numpy as np
import pytest

from tests.tolerance import assert_between
from truing.estimation.held_out import Contender, choose_model, held_out_misfit


def _noise(rng: np.random.Generator, scale: float = 1.0) -> np.ndarray:
    return scale * rng.chisquare(6, 8)


def test_a_model_at_the_noise_floor_is_not_refuted_by_one_that_lies_a_little_lower():
    squares = _noise(np.random.default_rng(1))
    made = choose_model([Contender(squares, 6, -100.0, 50), Contender(squares * 0.95, 6, -110.0, 90)])
    assert made.chosen == 0
    assert not made.indistinguishable.any()


def test_a_model_that_misses_held_out_poses_is_excluded_however_probable():
    rng = np.random.default_rng(2)
    made = choose_model([Contender(_noise(rng, 40.0), 6, -10.0, 50), Contender(_noise(rng), 6, -100.0, 90)])
    assert made.chosen == 1


def test_of_equally_probable_models_the_one_with_fewest_parameters_is_chosen():
    squares = _noise(np.random.default_rng(3))
    made = choose_model(
        [Contender(squares, 6, -99.0, 90), Contender(squares, 6, -100.0, 54), Contender(squares, 6, -150.0, 36)]
    )
    assert made.chosen == 1
    assert made.indistinguishable.tolist() == [True, False, False]


def test_without_held_out_poses_evidence_decides():
    made = choose_model([Contender(np.zeros(0), 6, -100.0, 54), Contender(np.zeros(0), 6, -50.0, 90)])
    assert made.chosen == 1


def test_the_more_accurate_model_is_chosen_where_all_miss_the_noise_floor():
    steady = choose_model([Contender(np.full(8, 60.0), 6, -10.0, 50), Contender(np.full(8, 40.0), 6, -100.0, 90)])
    assert steady.chosen == 1


def test_poses_may_differ_in_freedom():
    freedom = np.repeat([6, 60], 8)
    squares = np.random.default_rng(4).chisquare(freedom)
    one = Contender(squares, freedom, -100.0, 50)
    assert choose_model([one, Contender(squares * 0.9, freedom, -110.0, 90)]).chosen == 0
    missing = Contender(squares * 10, freedom, -10.0, 50)
    assert choose_model([missing, one]).chosen == 1


def test_a_model_to_which_held_out_poses_are_impossible_is_excluded_and_changes_no_other():
    squares = _noise(np.random.default_rng(6))
    others = [Contender(squares, 6, -100.0, 50), Contender(squares * 0.95, 6, -110.0, 90)]
    impossible = Contender(np.where(np.arange(8) == 3, np.inf, 0.0), 6, 0.0, 20)
    made = choose_model([impossible, *others])
    assert made.chosen == 1 + choose_model(others).chosen
    assert choose_model([impossible]).chosen == 0


def test_no_model_is_no_choice():
    with pytest.raises(ValueError, match="at least one"):
        choose_model([])


def test_the_misfit_of_a_right_model_is_its_number_of_equations():
    rng, poses = np.random.default_rng(5), 4000
    A, J = rng.normal(size=(poses, 3, 5)), rng.normal(size=(poses, 3, 4))
    noise = np.broadcast_to(np.diag([1.0, 2.0, 0.5, 1.0, 3.0]), (poses, 5, 5))
    root = rng.normal(size=(4, 4))
    known = root @ root.T
    measured = np.sqrt(np.diagonal(noise, axis1=1, axis2=2)) * rng.normal(size=(poses, 5))
    value = np.einsum("bmn,bn->bm", A, measured)
    value += np.einsum("bmp,pq,bq->bm", J, root, rng.normal(size=(poses, 4)))
    found = held_out_misfit(value, A, J, noise, known)
    error = np.sqrt(6 / poses)  # of a mean of chi-squares of three
    assert_between(float(found.mean()), 3 - 4 * error, 3 + 4 * error, what="mean chi-square of three equations")
