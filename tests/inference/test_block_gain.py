"""Gain of a cause in left-out blocks: the difference of two densities, negative if the cause fails there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.inference import toy_campaign as toy
from truing.inference.block_gain import BlockGain, block_gain
from truing.inference.blocks import BlockKind, EpochBlocks
from truing.inference.linear_problem import Whitened, whiten
from truing.inference.linearised_model import LinearisedModel

TEMPLATE = toy.TEMPLATE
POSES, ROWS = TEMPLATE.residual.shape
DAYS = EpochBlocks(BlockKind.DAY, np.repeat(np.arange(4), POSES // 4))
OWN = slice(3, 5)  # the shared unknowns that are a cause's
# Three unknowns of the machine, then a cause of two parameters of which the second is large.
VALUE = np.array([0.3, -1.0, 0.7, 1.2, -0.8])


def at_the_optimum(template: LinearisedModel, measured: NDArray) -> Whitened:
    """The problem of what was measured (B, M), linearised where its unknowns are fitted best."""
    shared, local = whiten(replace(template, residual=measured)).step()
    left = measured - template.by_shared @ shared - np.einsum("bmh,bh->bm", template.by_local, local)
    return whiten(replace(template, residual=left, shared_value=shared, local_value=local))


def measured(template: LinearisedModel, rng: np.random.Generator, value: NDArray = VALUE) -> NDArray:
    local = rng.normal(size=template.local_value.shape)
    own = template.by_shared @ value + np.einsum("bmh,bh->bm", template.by_local, local)
    return np.asarray(own + rng.normal(size=own.shape))


def gain(template: LinearisedModel, values: NDArray, *possible: EpochBlocks) -> BlockGain | None:
    fit = at_the_optimum(template, values)
    return block_gain(fit, OWN, fit.problem.shared_value[OWN], possible or (DAYS,))


def log_density(template: LinearisedModel, values: NDArray, shared: NDArray, own: NDArray) -> float:
    """Of the rows of some poses given all others, from the covariance of everything that was measured."""
    slopes = template.by_shared[..., shared].reshape(POSES * ROWS, -1)
    covariance = slopes @ slopes.T + np.eye(POSES * ROWS)
    for pose, columns in enumerate(template.by_local):
        place = slice(pose * ROWS, (pose + 1) * ROWS)
        covariance[place, place] += columns @ columns.T
    block, flat = np.repeat(own, ROWS), values.ravel()
    across = np.linalg.solve(covariance[np.ix_(~block, ~block)], covariance[np.ix_(~block, block)]).T
    left = flat[block] - across @ flat[~block]
    spread = covariance[np.ix_(block, block)] - across @ covariance[np.ix_(~block, block)]
    return float(-0.5 * (left @ np.linalg.solve(spread, left) + np.linalg.slogdet(spread)[1]))


def test_the_gain_is_that_of_densities_from_the_covariance_of_everything() -> None:
    values = measured(TEMPLATE, np.random.default_rng(1))
    every, others = np.arange(5), np.arange(3)
    expected = sum(
        log_density(TEMPLATE, values, every, DAYS.numbers == day)
        - log_density(TEMPLATE, values, others, DAYS.numbers == day)
        for day in range(4)
    )
    found = gain(TEMPLATE, values)
    assert found is not None
    assert (found.kind, found.blocks) == (BlockKind.DAY, 4)
    assert found.log_gain == pytest.approx(expected, rel=1e-6)
    assert found.log_gain > 10.0


def only_on(days: tuple[int, ...]) -> LinearisedModel:
    """The problem whose cause acts on some days alone."""
    acts = np.isin(DAYS.numbers, days)[:, None, None]
    slopes = TEMPLATE.by_shared.copy()
    slopes[..., OWN] *= acts
    return replace(TEMPLATE, by_shared=slopes)


def test_a_cause_of_one_day_is_not_held_against_the_others() -> None:
    values = measured(only_on((2,)), np.random.default_rng(2))
    assert gain(only_on((2,)), values) is None


def test_a_cause_of_two_days_is_tested_on_left_out_days() -> None:
    acting = only_on((1, 3))
    values = measured(acting, np.random.default_rng(3))
    halves = EpochBlocks(BlockKind.SERIES, np.where(DAYS.numbers == 1, 0, DAYS.numbers + 1))
    found = gain(acting, values, halves, replace(DAYS, kind=BlockKind.REGION))
    assert found is not None
    assert (found.kind, found.blocks) == (BlockKind.SERIES, 2)
    assert found.log_gain > 3.0
    one = EpochBlocks(BlockKind.SERIES, np.where(np.isin(DAYS.numbers, (1, 3)), 0, DAYS.numbers + 1))
    other = gain(acting, values, one, replace(DAYS, kind=BlockKind.REGION))
    assert other is not None
    assert other.kind == BlockKind.REGION


def test_an_effect_that_changes_sign_daily_predicts_no_left_out_day() -> None:
    rng = np.random.default_rng(4)
    values = measured(TEMPLATE, rng)
    sign = np.where(DAYS.numbers % 2, -1.0, 1.0)[:, None]
    values += (2.0 * sign - 1.0 + 0.6) * (TEMPLATE.by_shared[..., OWN] @ VALUE[OWN])
    found = gain(TEMPLATE, values)
    assert found is not None
    assert found.log_gain < -np.log(20.0)


def test_a_shape_is_no_part_of_what_is_taken_away() -> None:
    values = measured(TEMPLATE, np.random.default_rng(5))
    fit = at_the_optimum(TEMPLATE, values)
    whole = block_gain(fit, OWN, fit.problem.shared_value[OWN], (DAYS,))
    amplitude = block_gain(fit, OWN, fit.problem.shared_value[OWN] * [1.0, 0.0], (DAYS,))
    assert whole is not None
    assert amplitude is not None
    assert whole.log_gain != pytest.approx(amplitude.log_gain, rel=1e-3)


def test_noise_taken_for_a_cause_seldom_pays() -> None:
    rng = np.random.default_rng(6)
    found = [gain(TEMPLATE, measured(TEMPLATE, rng, VALUE * [1, 1, 1, 0, 0])) for _ in range(40)]
    assert sum(own is not None and own.log_gain > np.log(20.0) for own in found) <= 4


def test_a_gain_is_far_below_that_of_an_effect_only_if_blocks_do_not_share_it() -> None:
    rng = np.random.default_rng(7)
    shared = [gain(TEMPLATE, measured(TEMPLATE, rng)) for _ in range(20)]
    assert not any(found.is_far_below for found in shared if found is not None)
    sign = np.array([1.0, 0.0, 0.0, -1.0])[DAYS.numbers][:, None]
    effect = 2.0 * TEMPLATE.by_shared[..., OWN] @ VALUE[OWN]
    values = measured(TEMPLATE, rng, VALUE * [1, 1, 1, 1, 1]) + sign * effect
    found = gain(TEMPLATE, values)
    assert found is not None
    assert found.squares > 4.0
    assert found.is_far_below


def test_an_effect_that_a_tolerance_hides_is_not_asked_to_gain_by_its_whole_size() -> None:
    """Next to an unknown that moves nearly the same, only the tolerance of that unknown shows a large effect."""
    slopes = TEMPLATE.by_shared.copy()
    slopes[..., OWN] = slopes[..., :2] + 0.01 * slopes[..., OWN]
    alike = replace(TEMPLATE, by_shared=slopes)
    values = measured(alike, np.random.default_rng(8), np.array([0.3, -1.0, 0.7, 7.0, -7.0]))
    found = gain(alike, values)
    assert found is not None
    assert found.log_gain < np.log(20.0), "the other unknown predicts the blocks nearly as well"
    assert not found.is_far_below
