"""The extended model as text: what is written is what is read, and it predicts what the fit predicted."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulation.telescope import MATRIX, readings, sample_model
from tests.tolerance import assert_between, assert_close
from truing.estimation.rotation import exp_so3, log_so3
from truing.simulation.causes.unexplained import APPROACH, Unexplained
from truing.simulation.extended_model import ExtendedModel, extended, predict_poses, read_model, write_model
from truing.simulation.point_model import Conditions

EFFECTS = (MATRIX, Unexplained(APPROACH, 0.0, 1.0, 1))


def _made(rng: np.random.Generator) -> ExtendedModel:
    model = sample_model(rng, 2, EFFECTS)
    shared = rng.normal(size=model.shared_size) * 0.1
    factor = rng.normal(size=(model.shared_size, model.shared_size)) / model.shared_size
    return extended(model, shared, factor @ factor.T, {"campaign": 'a "quoted" name'})


def _conditions(rng: np.random.Generator, poses: int = 5) -> Conditions:
    return Conditions(readings(rng, poses), {APPROACH: rng.choice([-1.0, 1.0], (poses, 6))})


def test_what_was_written_predicts_the_same_when_read_back() -> None:
    rng = np.random.default_rng(1)
    made = _made(rng)
    read = read_model(write_model(made))
    conditions = _conditions(rng)
    before, after = predict_poses(made, conditions), predict_poses(read, conditions)
    assert read.context == {"campaign": 'a "quoted" name'}
    assert_close(after.p, before.p, atol=1e-13, what="p, m")
    assert_close(after.R, before.R, atol=1e-12, what="R")
    scale = np.abs(before.covariance).max()
    assert_close(after.covariance, before.covariance, atol=1e-6 * scale, what="covariance")


def test_writing_again_gives_the_same_text() -> None:
    text = write_model(_made(np.random.default_rng(2)))
    assert write_model(read_model(text)) == text


def test_predicted_covariance_is_that_of_drawn_models() -> None:
    """Draw unknowns and readings from what the model says of them; the poses scatter as it says."""
    rng = np.random.default_rng(3)
    made = _made(rng)
    conditions = _conditions(rng, poses=2)
    told = predict_poses(made, conditions)
    factor, draws, errors = np.linalg.cholesky(made.covariance), 250, []
    for _ in range(draws):
        drawn = ExtendedModel(made.model, made.shared + factor @ rng.normal(size=len(made.shared)), made.covariance, {})
        read = conditions.readings + made.model.known.reading_sigma * rng.normal(size=(2, 6))
        pose = predict_poses(drawn, Conditions(read, conditions.covariates))
        errors.append(np.concatenate([pose.p - told.p, log_so3(pose.R @ np.swapaxes(told.R, 1, 2))], -1))
    squares = np.einsum("dbi,bij,dbj->d", errors, np.linalg.inv(told.covariance), errors) / 12
    # Mean of chi-square with 12 degrees of freedom over 12, 250 draws: sigma 0.026.
    assert_between(float(np.mean(squares)), 1 - 4 * 0.026, 1 + 4 * 0.026, what="normalised squared error")


def test_a_text_that_is_no_model_is_refused() -> None:
    for text, said in (
        ("format = 7\n", "found format 7, expected 1"),
        ("format = 1\n", "no usable"),
        ("= =", "Invalid"),
    ):
        with pytest.raises(ValueError, match=said):
            read_model(text)


def test_rotations_of_predicted_poses_are_rotations() -> None:
    rng = np.random.default_rng(5)
    found = predict_poses(_made(rng), _conditions(rng))
    assert_close(found.R, exp_so3(log_so3(found.R)), atol=1e-14, what="R")
    assert found.converged.all()
