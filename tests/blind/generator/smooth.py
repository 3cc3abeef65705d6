"""Random smooth functions of several inputs, and other courses that no formula was written for."""

from __future__ import annotations

import numpy as np

from tests.blind.generator.quaternions import Array

WAVES = 24
LENGTH_SCALES = 0.5, 1.2  # of an input's standard deviation: as rough as a campaign still resolves
BENT = 0.6  # share of a course that is left when its plane through the inputs is taken off


def random_function(inputs: Array, seed: int) -> Array:
    """A random smooth function (N,) of inputs (N, D), at most 1, without its best plane through them.

    A sum of waves in random directions, which is a draw from a Gaussian process. A plane would be what catalogues
    hold (a gain, a slope over time), so that it is taken off, and functions that are mostly a plane are drawn again.
    """
    rng = np.random.default_rng(seed)
    scaled = standardised(inputs)
    plane = np.column_stack([np.ones(len(scaled)), scaled])
    while True:
        scale = rng.uniform(*LENGTH_SCALES, scaled.shape[1])
        turns = rng.normal(size=(scaled.shape[1], WAVES)) / scale[:, None]
        waves = np.cos(scaled @ turns + rng.uniform(0, 2 * np.pi, WAVES))
        course = waves @ rng.normal(size=WAVES)
        rest = course - plane @ np.linalg.lstsq(plane, course, rcond=None)[0]
        if np.std(rest) > BENT * np.std(course):
            return rest / np.abs(rest).max()


def standardised(inputs: Array) -> Array:
    """Inputs (N, D) less their means, over their standard deviations; one that never changes is 0."""
    columns = np.asarray(inputs, float).reshape(len(inputs), -1)
    away = columns - columns.mean(axis=0)
    spread = away.std(axis=0)
    return away / np.where(spread > 0, spread, 1.0)


def random_walk(count: int, seed: int) -> Array:
    """A walk (count,) with steps at random, smoothed over three of them, at most 1: what nobody wrote down."""
    steps = np.convolve(np.random.default_rng(seed).normal(size=count + 2), np.ones(3) / 3, "valid")
    walk = np.cumsum(steps)
    walk -= walk.mean()
    return walk / np.abs(walk).max()


def remanence(course: Array, seed: int) -> Array:
    """What friction elements of random thresholds keep of a course (N,) in time order, at most 1; it does not close.

    Each element moves on only when it is pushed farther than its threshold (Prandtl and Ishlinskii's stop, Jenkin's
    element); their sum depends on all turning points so far.
    """
    rng = np.random.default_rng(seed)
    span = np.ptp(course)
    thresholds = span * rng.uniform(0.05, 0.45, 5)
    weights = rng.uniform(0.2, 1.0, 5)
    kept = np.zeros_like(thresholds)
    out = np.empty(len(course))
    for n, now in enumerate(course - course[0]):
        kept = np.clip(kept, now - thresholds, now + thresholds)
        out[n] = weights @ (kept - now)
    out -= out.mean()
    return out / np.abs(out).max()
