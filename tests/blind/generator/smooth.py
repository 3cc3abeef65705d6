"""Random smooth functions of several inputs, and other random functions without a closed form."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.blind.generator.quaternions import Array

WAVES = 24
LENGTH_SCALES = 0.5, 1.2  # of an input's standard deviation: as rough as a campaign still resolves
BENT = 0.6  # share of a course that is left when its plane through the inputs is taken off


def random_function(inputs: Array, seed: int) -> Array:
    """A random smooth function (N,) of inputs (N, D), at most 1, without its best plane through them.

    A sum of waves in random directions, which is a draw from a Gaussian process. Its plane is removed, because
    catalogues contain planes (a gain, a slope over time). Functions that are mostly a plane are drawn again.
    """
    scaled = standardised(inputs)
    return _drawn_form(scaled, seed)(scaled)


def own_part(inputs: Array, seed: int, column: int) -> Array:
    """Part of a random function (N,) of inputs (N, D) that depends on one column: the function less its mean over that
    column. The other columns keep their values, so interactions with the column are included."""
    scaled = standardised(inputs)
    form = _drawn_form(scaled, seed)
    every = np.repeat(scaled[:, None], len(scaled), axis=1)
    every[:, :, column] = scaled[:, column]
    mean = form(every.reshape(-1, scaled.shape[1])).reshape(len(scaled), -1).mean(axis=1)
    return form(scaled) - mean


def _drawn_form(scaled: Array, seed: int) -> Callable[[Array], Array]:
    """A random function of any inputs (M, D), drawn for and scaled by standardised ones (N, D)."""
    rng = np.random.default_rng(seed)
    plane = _with_one(scaled)
    while True:
        scale = rng.uniform(*LENGTH_SCALES, scaled.shape[1])
        turns = rng.normal(size=(scaled.shape[1], WAVES)) / scale[:, None]
        phases, sizes = rng.uniform(0, 2 * np.pi, WAVES), rng.normal(size=WAVES)
        course = np.cos(scaled @ turns + phases) @ sizes
        flat = np.linalg.lstsq(plane, course, rcond=None)[0]
        rest = course - plane @ flat
        if np.std(rest) > BENT * np.std(course):
            largest = np.abs(rest).max()
            return lambda at: (np.cos(at @ turns + phases) @ sizes - _with_one(at) @ flat) / largest


def _with_one(columns: Array) -> Array:
    return np.column_stack([np.ones(len(columns)), columns])


def standardised(inputs: Array) -> Array:
    """Inputs (N, D) less their means, over their standard deviations; one that never changes is 0."""
    columns = np.asarray(inputs, float).reshape(len(inputs), -1)
    away = columns - columns.mean(axis=0)
    spread = away.std(axis=0)
    return away / np.where(spread > 0, spread, 1.0)


def random_walk(count: int, seed: int) -> Array:
    """A random walk (count,), smoothed over three steps, at most 1: an unrecorded quantity."""
    steps = np.convolve(np.random.default_rng(seed).normal(size=count + 2), np.ones(3) / 3, "valid")
    walk = np.cumsum(steps)
    walk -= walk.mean()
    return walk / np.abs(walk).max()


def remanence(course: Array, seed: int) -> Array:
    """Hysteresis of a course (N,) in time order by friction elements of random thresholds; at most 1, and not closed.
    Each element moves only when it is pushed beyond its threshold (Prandtl and Ishlinskii's stop, Jenkin's element).
    Their sum depends on all turning points so far."""
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
