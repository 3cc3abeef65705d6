"""Noise that is larger in places: whether the size of residuals follows something, and what then.

The logarithm of the squared length of a point's standardised residual is regressed on what it may follow; where there
is nothing, it is that of a chi-square (one degree of freedom per coordinate), whose scatter is known and hardly grows
with heavy tails. Effects on the mean look like noise that follows something: this is a test for what is left without
them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

# A residual tells of its point's noise where the fit left it at least this share of every direction.
_TOLD = 0.1
# Logarithms of what is very small say nothing of noise. A single coordinate is often near zero by chance: with one
# added to its square, the logarithm keeps nine tenths of what there is to know of the noise, and four without.
_LEAST = 1e-3
_ADDED = {1: 1.0}
_FEWEST_POINTS = 20


@dataclass(frozen=True)
class Driver:
    """Something that the noise may follow: values (B, K), what it is called, and its column of the configurations.

    ``within`` (K,) numbers groups whose own level says nothing: targets for what changes from pose to pose, bodies for
    what changes from target to target. ``targets`` are those concerned where it is noise of these alone.
    """

    name: str
    values: NDArray
    within: NDArray
    column: str = ""
    targets: tuple[int, ...] = ()


@dataclass(frozen=True)
class NoiseFollowing:
    """What the noise follows; its p-value, corrected for all that was tried; and how much larger it is where it is
    largest than where it is least.

    ``factor`` (B, K) is each point's noise over the typical one.
    """

    driver: Driver
    p_value: float
    ratio: float
    sigma: float
    factor: NDArray


def standardised(rest: NDArray, told: NDArray) -> NDArray:
    """Return residuals (B, K, d) brought to unit noise, NaN where a fit leaves too little of a point.

    ``told`` (B, K, d, d) is the covariance of the whitened residuals ``rest`` where noise is unit noise.
    """
    amount, axes = np.linalg.eigh(told)
    enough = amount[..., 0] > _TOLD
    own = np.einsum("bkij,bki->bkj", axes, rest) / np.sqrt(np.maximum(amount, _TOLD))
    return np.where(enough[..., None], own, np.nan)


def drivers(
    covariates: Mapping[str, NDArray], shape: NDArray, bodies: NDArray, distance: NDArray | None = None
) -> list[Driver]:
    """Return what the noise may follow: columns (B,) and their squares, the place on the body, the distance, a target.

    shape (K, 3) in m, bodies (K,) numbers of the targets' bodies, distance (B, K) of points from the instrument, m.
    """
    targets = np.arange(len(shape))
    poses = next((len(values) for values in covariates.values()), 0 if distance is None else len(distance))
    found = []
    for name, values in covariates.items():
        if values.ndim == 1 and np.isfinite(values).all() and np.ptp(values) > 0:
            x = 2 * (values - values.min()) / np.ptp(values) - 1
            for power in (x, x**2 - np.mean(x**2)):
                found.append(Driver(name, np.repeat(power[:, None], len(shape), 1), targets, name))
    for axis, values in zip("xyz", shape.T, strict=False):  # numbers have no place
        found.append(Driver(f"the place along {axis}", np.repeat(values[None], poses, 0), bodies))
    if distance is not None:
        found.append(Driver("the distance from the instrument", distance, targets))
    for target in targets:
        values = np.repeat((targets == target)[None].astype(float), poses, 0)
        found.append(Driver("", values, np.zeros(len(shape), int), "", (int(target),)))
    return found


def noise_following(rest: NDArray, candidates: Sequence[Driver], level: float) -> NoiseFollowing | None:
    """Return what the noise behind standardised residuals (B, K, d) follows; None where p exceeds the level.

    NaN where a point was not seen. p-values are corrected for the number of candidates (Bonferroni).
    """
    square = np.sum(rest**2, -1)
    known = np.isfinite(square)
    if known.sum() < _FEWEST_POINTS or not candidates:
        return None
    size = rest.shape[-1]
    squares = np.maximum(np.nan_to_num(square) + _ADDED.get(size, 0.0), _LEAST)
    follows, spread = _log_moments(size)
    logs = np.where(known, np.log(squares) / follows, 0.0)
    scores = [_slope(logs, known, driver, spread) for driver in candidates]
    best = int(np.argmax([_strength(score, driver) for score, driver in zip(scores, candidates, strict=True)]))
    strength = _strength(scores[best], candidates[best])
    tails = 1.0 if candidates[best].targets else 2.0
    p_value = min(1.0, tails * 0.5 * math.erfc(max(strength, 0.0) / math.sqrt(2.0)) * len(candidates))
    if p_value > level:
        return None
    return _following(candidates[best], scores[best], known, p_value)


@lru_cache(maxsize=8)
def _log_moments(size: int) -> tuple[float, float]:
    """Return how the mean logarithm of a chi-square of so many degrees of freedom (and of what is added to it) follows
    that of the noise's variance, and the variance of such logarithms once that slope is one."""
    from scipy.integrate import quad
    from scipy.special import gammaincinv, polygamma

    added = _ADDED.get(size, 0.0)
    if not added:
        return 1.0, float(polygamma(1, size / 2))

    def mean(of: Callable[[float], float]) -> float:
        return float(quad(lambda x: of(2.0 * gammaincinv(size / 2, x)), 0.0, 1.0)[0])

    slope, first = mean(lambda q: q / (q + added)), mean(lambda q: math.log(q + added))
    second = mean(lambda q: math.log(q + added) ** 2)
    return slope, (second - first**2) / slope**2


def _slope(logs: NDArray, known: NDArray, driver: Driver, spread: float) -> tuple[float, float]:
    """Return the slope of the logarithms (B, K) along a driver, and its standard deviation; they scatter by no less
    than the variance ``spread``."""
    y, x = _within(logs, known, driver.within), _within(driver.values, known, driver.within)
    size = float(np.sum(x**2))
    if size <= 1e-12 * max(float(np.sum(driver.values[known] ** 2)), 1e-300):
        return 0.0, math.inf
    variance = max(float(np.sum(y**2) / max(known.sum() - len(np.unique(driver.within)), 1)), spread)
    return float(np.sum(x * y)) / size, math.sqrt(variance / size)


def _strength(score: tuple[float, float], driver: Driver) -> float:
    """Return how many standard deviations a slope is; a single target only counts where it is noisier."""
    ratio = score[0] / score[1]
    return ratio if driver.targets else abs(ratio)


def _within(values: NDArray, known: NDArray, groups: NDArray) -> NDArray:
    """Return values (B, K) less the mean of their group of targets; zero where not known."""
    left = np.where(known, values, 0.0)
    for group in np.unique(groups):
        own = groups == group
        count = known[:, own].sum()
        left[:, own] -= left[:, own].sum() / max(count, 1)
    return np.where(known, left, 0.0)


def _following(driver: Driver, score: tuple[float, float], known: NDArray, p_value: float) -> NoiseFollowing:
    x = _within(driver.values, known, driver.within)
    away = np.where(np.isfinite(driver.values), driver.values, 0.0) - driver.values[known].mean()
    reach = 0.5 * float(np.ptp(x[known]))
    ratio = math.exp(abs(score[0]) * reach)
    factor = np.exp(0.5 * score[0] * away)
    return NoiseFollowing(driver, p_value, ratio, ratio * score[1] * reach, factor)
