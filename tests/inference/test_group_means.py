"""Lack of fit against pure error: the F test keeps its level for any declared noise, and detects missing terms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.inference import toy_campaign as toy
from truing.estimation.rotation import exp_so3
from truing.inference.adequacy import Adequacy, MisfitKind, WhyUntested, by_region, pure_error
from truing.inference.group_means import EpochResiduals, epoch_residuals, means_against_scatter, means_of_columns
from truing.inference.linear_problem import whiten
from truing.inference.linearised_model import LinearisedModel
from truing.inference.observations import Frames

# Eight commands, each given three times; what repeats share is where they are.
GROUPS = np.repeat(np.arange(8), 3)
REPEATED = replace(
    toy.TEMPLATE, by_local=toy.TEMPLATE.by_local[3 * GROUPS], by_shared=toy.TEMPLATE.by_shared[3 * GROUPS]
)
TRIALS = 300


def residuals(
    rng: np.random.Generator, effect: np.ndarray | float = 0.0, noise: str = "normal", of: LinearisedModel = REPEATED
) -> EpochResiduals:
    rows = of.residual.shape
    drawn = rng.standard_t(3, rows) / np.sqrt(3.0) if noise == "heavy" else rng.normal(size=rows)
    local = rng.normal(size=of.local_value.shape)
    unknown = of.by_shared @ rng.normal(size=toy.SHARED) + np.einsum("bmh,bh->bm", of.by_local, local)
    fit = whiten(replace(of, residual=unknown + drawn + effect))
    return epoch_residuals(fit, toy.MEASURED, toy.FRAMES, toy.READINGS)


def p_value(found: EpochResiduals, groups: np.ndarray = GROUPS) -> float:
    (test,) = pure_error(found, groups)
    return test.p_value


@pytest.mark.parametrize("of", [REPEATED, toy.TEMPLATE], ids=["repeats", "epochs that differ"])
@pytest.mark.parametrize("noise", ["normal", "heavy"])
def test_a_right_model_is_rejected_no_more_often_than_the_level_says(noise: str, of: LinearisedModel) -> None:
    rng = np.random.default_rng(1)
    p_values = np.array([p_value(residuals(rng, noise=noise, of=of)) for _ in range(TRIALS)])
    assert np.mean(p_values <= 0.05) <= 0.05 + 3.1 * np.sqrt(0.05 * 0.95 / TRIALS)
    assert np.mean(p_values <= 0.004) <= 0.004 + 3.1 * np.sqrt(0.004 / TRIALS)
    if of is REPEATED:
        assert np.mean(p_values <= 0.5) == pytest.approx(0.5, abs=3.1 * np.sqrt(0.25 / TRIALS))


def test_the_ratio_is_one_on_average_where_only_noise_is_left() -> None:
    rng = np.random.default_rng(2)
    found = [means_against_scatter(residuals(rng), GROUPS, 4.0) for _ in range(TRIALS)]
    ratios = np.array([own.ratio for own in found if own is not None])
    freedom = found[0]
    assert freedom is not None
    spread = np.sqrt(2.0 / freedom.of_means + 2.0 / freedom.within)
    expected = freedom.within / (freedom.within - 2.0)
    assert np.mean(ratios) == pytest.approx(expected, abs=3.5 * spread / np.sqrt(TRIALS))


def test_means_of_repeats_show_an_effect_of_the_command_and_no_scatter() -> None:
    rng = np.random.default_rng(3)
    effect = rng.normal(size=(8, REPEATED.residual.shape[1]))
    assert p_value(residuals(rng, effect[GROUPS])) < 1e-6
    anywhere = rng.normal(size=REPEATED.residual.shape)
    assert p_value(residuals(rng, anywhere)) > 1e-3


def test_the_p_value_is_independent_of_the_declared_noise() -> None:
    found = residuals(np.random.default_rng(4))
    louder = replace(found, values=7.0 * found.values)
    assert p_value(louder) == pytest.approx(p_value(found), rel=1e-9)


def test_the_p_value_is_independent_of_the_measurement_frame_of_each_pose() -> None:
    rng = np.random.default_rng(5)
    poses, turns = toy.POSES, exp_so3(rng.normal(size=(toy.POSES, 3)))

    def turned(rows: np.ndarray) -> np.ndarray:
        own = rows.reshape(poses, toy.POINTS, 3, -1)
        return (turns[:, None] @ own).reshape(rows.shape)

    residual = rng.normal(size=REPEATED.residual.shape)
    plain = whiten(replace(REPEATED, residual=residual))
    other = whiten(
        replace(
            REPEATED,
            residual=turned(residual),
            by_local=turned(REPEATED.by_local),
            by_shared=turned(REPEATED.by_shared),
        )
    )
    frames = Frames(turns, toy.FRAMES.t)
    assert p_value(epoch_residuals(other, toy.MEASURED, frames, toy.READINGS)) == pytest.approx(
        p_value(epoch_residuals(plain, toy.MEASURED, toy.FRAMES, toy.READINGS)), rel=1e-6
    )


def test_observations_without_a_repeat_count_for_nothing() -> None:
    found = residuals(np.random.default_rng(6))
    is_observed = found.is_observed.copy()
    is_observed[1::3] = is_observed[2::3] = False
    gone = replace(
        found,
        is_observed=is_observed,
        values=np.where(is_observed, found.values, 0.0),
        redundancy=np.where(is_observed, found.redundancy, 0.0),
    )
    assert not list(pure_error(gone, GROUPS))


def test_without_repeats_the_reason_is_that_and_with_few_another() -> None:
    found = residuals(np.random.default_rng(7))
    assert not list(pure_error(found, np.full(toy.POSES, -1)))
    few = np.where(GROUPS == 0, 0, -1)
    assert not list(pure_error(found, few))
    assert Adequacy(()).why_untested(MisfitKind.PURE_ERROR) == WhyUntested.NO_REPEATS
    assert Adequacy((), repeated=True).why_untested(MisfitKind.PURE_ERROR) == WhyUntested.TOO_FEW
    assert Adequacy(()).why_untested(MisfitKind.INPUT_NOISE) == WhyUntested.TOO_FEW
    assert MisfitKind.PURE_ERROR in Adequacy(()).untested
    assert MisfitKind.PURE_ERROR not in Adequacy((), not_asked=frozenset([MisfitKind.PURE_ERROR])).untested


def test_an_effect_of_the_region_is_found_by_region() -> None:
    rng = np.random.default_rng(8)
    poses, width = 64, 12

    def seen_by(effect: np.ndarray) -> tuple[float, str]:
        values = rng.normal(size=(poses, width)) + effect[:, None]
        ones = np.ones((poses, width))
        plain = EpochResiduals(values, ones > 0.0, ones, 0.0 * ones, lambda own: np.zeros((width, 1)))
        (test,) = by_region(plain, columns)
        return test.p_value, test.along

    columns = {"x": rng.uniform(-1, 1, poses), "y": rng.uniform(-2, 2, poses), "still": np.zeros(poses)}
    p, along = seen_by(0.6 * np.sign(columns["y"]))
    assert p < 1e-6
    assert along == "x y still"
    p_values = [seen_by(np.zeros(poses))[0] for _ in range(200)]
    assert np.mean(np.array(p_values) <= 0.05) <= 0.05 + 3.1 * np.sqrt(0.05 * 0.95 / 200)
    assert not list(by_region(residuals(rng), {}))


def test_columns_that_share_a_mean_of_zero_are_rejected_as_often_as_the_level_says() -> None:
    rng = np.random.default_rng(8)
    drawn = [means_of_columns(_some_unknown(rng.normal(size=(4, 30)), rng)) for _ in range(TRIALS)]
    assert 0.05 < np.mean([found is not None and found.p_value < 0.1 for found in drawn]) < 0.16


def test_a_displacement_in_all_of_few_epochs_is_seen_whatever_the_noise() -> None:
    rng = np.random.default_rng(9)
    for noise in (0.3, 1.0, 5.0):
        found = means_of_columns(_some_unknown(noise * (rng.normal(size=(4, 30)) + rng.normal(size=30)), rng))
        assert found is not None
        assert found.p_value < 1e-3


def test_one_epoch_tells_nothing_of_means() -> None:
    assert means_of_columns(np.full((1, 30), 1.0)) is None


def _some_unknown(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.where(rng.random(values.shape) < 0.1, np.nan, values)
