"""The extended model as text: reading restores it, and it predicts like the fit."""

from __future__ import annotations

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.mechanisms.made_models import OFFERED, made_model, named_model, some_conditions
from tests.simulation.mechanisms.telescope import MATRIX, SURVEY_M
from tests.tolerance import assert_between, assert_close
from truing.estimation.rotation import exp_so3, log_so3
from truing.simulation.catalogue import catalogue
from truing.simulation.cause import Cause
from truing.simulation.mechanisms.causes.nonparametric import NonparametricMechanismEffect
from truing.simulation.mechanisms.extended_model import (
    ExtendedModel,
    predict_poses,
    read_model,
    with_targets,
    write_model,
)
from truing.simulation.mechanisms.model import MechanismModel
from truing.simulation.mechanisms.recording import Conditions
from truing.simulation.targets import BASE, PLATFORM


def test_every_cause_of_the_catalogue_is_written_and_read() -> None:
    """But those of bodies alone, whose poses no model predicts, and scatter, which moves no prediction."""
    others = {"body-deformation", "body-drift", "gravity-sag", "approach-scatter", "noise-burst"}
    assert {cause.id for cause in OFFERED} == set(catalogue()) - others


@pytest.mark.parametrize("cause", OFFERED, ids=lambda cause: cause.key)
def test_every_cause_comes_back_and_predicts_the_same(cause: Cause) -> None:
    rng = np.random.default_rng(1)
    made = made_model(rng, (cause,))
    text = write_model(made)
    read = read_model(text)
    assert [cause.key for cause in read.model.causes] == [cause.key]
    assert type(read.model.causes[0]) is type(cause)
    assert write_model(read) == text
    conditions = some_conditions(rng)
    for recorded in (False, True):
        before, after = (predict_poses(one, conditions, recorded=recorded) for one in (made, read))
        assert_close(after.p, before.p, atol=1e-13, what="p, m")
        assert_close(after.R, before.R, atol=1e-12, what="R")
        assert_close(after.covariance, before.covariance, atol=1e-9 * np.abs(before.covariance).max(), what="cov")


def test_parameters_of_model_toml_are_those_of_the_tables() -> None:
    cause = next(one for one in OFFERED if one.id == "actuator-periodic-error" and getattr(one, "free", False))
    effect = tomllib.loads(write_model(made_model(np.random.default_rng(4), (cause,))))["effects"][0]
    assert {name.partition("_")[0] for name in effect["parameters"]} == {"amplitude", "phase", "pitch"}
    assert effect["parameters"]["pitch"]["unit"] == "mm"
    assert len(effect["values"]) == len(cause.parameters(6))


def test_the_survey_and_its_noise_are_kept() -> None:
    made = made_model(np.random.default_rng(6))
    read = read_model(write_model(made))
    assert_close(read.model.known.shape, made.model.known.shape, atol=1e-15, what="places, m")
    assert read.model.targets.names == made.model.targets.names
    assert made.survey_sigma.min() > SURVEY_M
    assert_close(read.survey_sigma, made.survey_sigma, atol=1e-15, what="sigma, m")


def test_a_change_of_the_bases_shape_moves_its_frame_as_the_targets_have_it() -> None:
    """A cause that moves targets of the base moves what poses are seen from; without targets nothing says so."""
    rng = np.random.default_rng(8)
    cause = NonparametricMechanismEffect(
        quantity="targets",
        columns=("time_s",),
        centres=(1800.0,),
        half_ranges=(1800.0,),
        body="base",
        targets=("P00", "P01"),
    )
    made = made_model(rng, (cause,))
    conditions = some_conditions(rng)
    bare = made.model.with_causes(())
    plain = ExtendedModel(bare, made.shared[:-6], made.covariance[:-6, :-6], made.survey_sigma, {})
    assert_close(predict_poses(made, conditions).p, predict_poses(plain, conditions).p, atol=1e-15, what="p, m")


def test_predicted_poses_contain_the_error_of_the_instrument_on_request() -> None:
    rng = np.random.default_rng(9)
    cause = next(iter(catalogue()["measurement-scale"].candidates(named_model(rng, ()).scene)))
    made = made_model(rng, (cause,))
    made.shared[-1] = 1e-3 / made.model.effect_sigma(cause)[-1]
    conditions = some_conditions(rng)
    true, seen = (predict_poses(made, conditions, recorded=recorded) for recorded in (False, True))
    own, places = made.model.targets, made.model.known.shape
    base, platform = (places[(own.body == body) & (own.leg < 0)].mean(0) for body in (BASE, PLATFORM))
    # The frames hang on the middle of their targets, which all lie a thousandth further out.
    assert_close(seen.p, true.p + 1e-3 * (true.p + true.R @ platform - base), atol=1e-12, what="p, m")
    assert_close(seen.R, true.R, atol=1e-12, what="R")


def test_the_frame_of_targets_is_that_of_the_joints_where_nothing_bends() -> None:
    rng = np.random.default_rng(10)
    made = made_model(rng, (MATRIX,))
    conditions = some_conditions(rng)
    few = replace(made, model=_thinned(made.model), survey_sigma=made.survey_sigma[:2])
    by_targets, by_joints = predict_poses(made, conditions), predict_poses(few, conditions)
    assert_close(by_targets.p, by_joints.p, atol=1e-13, what="p, m")
    scale = np.abs(by_joints.covariance).max()
    assert_close(by_targets.covariance, by_joints.covariance, atol=1e-8 * scale, what="covariance")


def _thinned(model: MechanismModel) -> MechanismModel:
    return with_targets(model, np.cumsum(model.targets.body == BASE) <= 2)


@pytest.mark.slow
def test_predicted_covariance_is_that_of_drawn_models() -> None:
    """Poses scatter by the predicted covariance if unknowns and readings are drawn from the model."""
    rng = np.random.default_rng(3)
    made = made_model(rng)
    conditions = some_conditions(rng, poses=2)
    reported = predict_poses(made, conditions)
    factor, draws, errors = np.linalg.cholesky(made.covariance), 250, []
    for _ in range(draws):
        drawn = replace(made, shared=made.shared + factor @ rng.normal(size=len(made.shared)))
        read = conditions.readings + made.model.known.reading_sigma * rng.normal(size=(2, 6))
        pose = predict_poses(drawn, Conditions(read, conditions.covariates))
        errors.append(np.concatenate([pose.p - reported.p, log_so3(pose.R @ np.swapaxes(reported.R, 1, 2))], -1))
    squares = np.einsum("dbi,bij,dbj->d", errors, np.linalg.inv(reported.covariance), errors) / 12
    # Mean of chi-square with 12 degrees of freedom over 12, 250 draws: sigma 0.026.
    assert_between(float(np.mean(squares)), 1 - 4 * 0.026, 1 + 4 * 0.026, what="normalised squared error")


def test_predictions_are_independent_of_the_number_of_poses() -> None:
    rng = np.random.default_rng(11)
    made = made_model(rng, (MATRIX,))
    conditions = some_conditions(rng, poses=150)
    whole = predict_poses(made, conditions)
    last = Conditions(conditions.readings[-3:])
    assert_close(whole.p[-3:], predict_poses(made, last).p, atol=1e-15, what="p, m")


def test_a_text_that_is_no_model_is_refused() -> None:
    good = write_model(made_model(np.random.default_rng(2)))
    for text, said in (
        ("format = 7\n", "found format 7, expected 2"),
        ("format = 2\n", "no usable"),
        ("= =", "Invalid"),
        (good.replace("platform-deformation-matrix", "witchcraft"), "found cause 'witchcraft'"),
    ):
        with pytest.raises(ValueError, match=said):
            read_model(text)


def test_rotations_of_predicted_poses_are_rotations() -> None:
    rng = np.random.default_rng(5)
    found = predict_poses(made_model(rng), some_conditions(rng))
    assert_close(found.R, exp_so3(log_so3(found.R)), atol=1e-14, what="R")
    assert found.converged.all()
