"""The noise of a campaign is estimated by component for any declared noise, and effects hardly inflate it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.inference import toy_campaign as toy
from tests.tolerance import assert_between
from truing.inference.linear_problem import whiten
from truing.inference.noise import components, input_ratio, rescaled_noise

BODIES = np.array([0, 0, 0, 1, 1, 1])


def ratios(points: float, readings: float, campaigns: int = 40) -> tuple[float, float]:
    """Mean noise found over the declared one, of points (rms over the axes) and of readings."""
    found = []
    for number in range(campaigns):
        whitened = toy.measured(np.random.default_rng([number, 5]), points=points, readings=readings)
        reported = rescaled_noise(whitened, toy.MEASURED, BODIES, toy.MEASURED.covariance).covariance
        level = np.sqrt(np.mean(np.trace(reported, axis1=-2, axis2=-1)) / 3)
        found.append((level, input_ratio(whitened, 3 * toy.POINTS, toy.READINGS, 1.0)))
    return float(np.mean([f[0] for f in found])), float(np.mean([f[1] for f in found]))


def test_noise_as_declared_is_kept() -> None:
    points, readings = ratios(1.0, 1.0)
    assert_between(points, 0.96, 1.04)
    assert_between(readings, 0.96, 1.04)


def test_larger_noise_is_estimated_up_to_the_weight_of_the_declared_noise() -> None:
    """The declared noise counts as 50 observations, so some 200 observations give four fifths of the difference."""
    points, readings = ratios(1.3, 1.3)
    assert_between(points, 1.18, 1.32)
    assert_between(readings, 1.06, 1.32)


def test_noise_is_estimated_along_each_axis() -> None:
    rng, uneven = np.random.default_rng(4), np.tile([1.0, 1.0, 2.0], toy.POINTS)
    template = toy.TEMPLATE
    noise = rng.normal(size=template.residual.shape) * uneven
    found = rescaled_noise(
        whiten(replace(template, residual=noise)), toy.MEASURED, BODIES, toy.MEASURED.covariance
    ).covariance[0, 0]
    assert found[2, 2] > 2.0 * max(found[0, 0], found[1, 1])


def test_an_effect_on_one_target_hardly_enlarges_its_noise() -> None:
    moved = np.zeros((toy.POSES, toy.POINTS, 3))
    moved[18:, 2] = 20.0
    whitened = toy.measured(np.random.default_rng(6), moved.reshape(toy.POSES, -1))
    reported = rescaled_noise(whitened, toy.MEASURED, BODIES, toy.MEASURED.covariance).covariance
    plain = components(whitened, 3 * toy.POINTS, toy.READINGS)
    assert np.trace(reported[0, 5]) / 3 < 0.5 * plain.observed_total / plain.observed


def test_components_include_the_declared_observations() -> None:
    found = components(toy.measured(np.random.default_rng(7)), 3 * toy.POINTS, toy.READINGS)
    assert min(found.observed, found.inputs) > 50
    assert found.without(0.0, 1, 1.0) == found.inputs_total / found.inputs * found.inputs / (found.inputs - 1)


def test_noise_without_several_effects_equals_noise_without_each_alone() -> None:
    found = components(toy.measured(np.random.default_rng(8)), 3 * toy.POINTS, toy.READINGS)
    squares, shares = np.array([0.0, 7.5, 1e9]), np.array([0.0, 0.3, 1.0])
    alone = [found.without(float(s), 2, float(share)) for s, share in zip(squares, shares, strict=True)]
    assert found.without(squares, 2, shares).tolist() == alone
    assert alone[0] > 0.5 > alone[2] > 0.0  # an effect cannot explain more than there is


def test_a_direction_without_any_scatter_keeps_a_tenth_of_the_noise_of_the_others() -> None:
    """However often its noise is estimated: points that all lie at z = 0 say nothing on the noise of z."""
    rng, flat = np.random.default_rng(9), np.tile([1.0, 1.0, 0.0], toy.POINTS)
    noise = rng.normal(size=toy.TEMPLATE.residual.shape) * flat
    measured = toy.MEASURED
    for _ in range(20):
        ratio = np.sqrt(np.diag(toy.MEASURED.covariance[0, 0]) / np.diag(measured.covariance[0, 0]))
        whitened = whiten(replace(toy.TEMPLATE, residual=noise * np.tile(ratio, toy.POINTS)))
        measured = rescaled_noise(whitened, measured, BODIES, toy.MEASURED.covariance)
    variances = np.linalg.eigvalsh(measured.covariance[0, 0] / toy.MEASURED.covariance[0, 0][0, 0])
    assert_between(float(np.sqrt(variances[0] / variances[2])), 0.1 - 1e-9, 0.2)
    assert_between(float(variances[1]), 0.25, 2.0)
