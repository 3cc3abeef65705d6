"""Tolerances as samples of platforms, and to first order (force-sensor paper, eq. 16-17).

T is the full width of a tolerance zone: sigma = T / 6, and three sigma reach its border. A normal law does not stop
there; 0.27 % of the errors lie beyond, unless they are asked to be bounded.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.simulation.bench.six_upur.closure import plan_of, stand
from truing.simulation.bench.six_upur.geometry import JointCentres

# Samples that share a stream of random numbers: part of what a seed means, so that it never follows the machine.
_STREAM = 1 << 14
# Samples worked on at once, so that their arrays stay in a processor's own cache.
_BLOCK = 1 << 11
_BORDER = 3.0


def sigma_of(tolerance: ArrayLike) -> NDArray:
    """Return one standard deviation of full tolerance widths T, in their unit (eq. 16)."""
    return np.asarray(tolerance, float) / 6.0


def box_muller(sigma: ArrayLike, mu1: ArrayLike, mu2: ArrayLike) -> NDArray:
    """Return normal errors from uniform mu1 in (0, 1] and mu2 in [0, 1) (eq. 17)."""
    return np.asarray(sigma) * np.sqrt(-2.0 * np.log(mu1)) * np.cos(2.0 * np.pi * np.asarray(mu2))


def sampled_errors(
    joints: JointCentres,
    sigma: ArrayLike,
    count: int,
    rng: np.random.Generator,
    *,
    workers: int = 1,
    bounded: bool = False,
) -> NDArray:
    """Return errors (count, 6), m and rad, of the platforms of sensors whose sources have sigma (5,), m.

    Closed loops, not linearised. The same generator gives the same bytes with any number of workers, as every 16384
    samples have a stream of their own. bounded: errors beyond T / 2 = 3 sigma are drawn again.
    """
    plan, widths = plan_of(joints), np.asarray(sigma, float)
    found = np.empty((count, 6))

    def fill(start: int, stream: np.random.Generator) -> None:
        for block in _blocks(start, min(start + _STREAM, count)):
            found[block] = stand(plan, _drawn(widths, block.stop - block.start, stream, bounded)).T

    starts = range(0, count, _STREAM)
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(fill, starts, rng.spawn(len(starts))))
    return found


def _blocks(start: int, stop: int) -> Iterator[slice]:
    return (slice(first, min(first + _BLOCK, stop)) for first in range(start, stop, _BLOCK))


def _drawn(sigma: NDArray, count: int, rng: np.random.Generator, bounded: bool) -> NDArray:
    """Return errors (5, 6, count), m; sources without tolerance use up no random numbers."""
    active = np.flatnonzero(sigma)
    drawn = rng.standard_normal((len(active), 6, count))
    while bounded and (beyond := np.abs(drawn) > _BORDER).any():
        drawn[beyond] = rng.standard_normal(np.count_nonzero(beyond))
    errors = np.zeros((len(sigma), 6, count))
    errors[active] = sigma[active, None, None] * drawn
    return errors


def first_order_covariances(error_map: NDArray, sigma: ArrayLike) -> NDArray:
    """Return what each source contributes to the covariance of the platform's error (..., 5, 6, 6), m and rad.

    error_map (..., 6, 6, 5) by leg and source, `assembly.closed_loop_map` or the paper's; sigma (5,) m.
    """
    scaled = error_map * np.asarray(sigma, float)
    return np.einsum("...pik,...qik->...kpq", scaled, scaled)


@dataclass(frozen=True)
class Band:
    """An estimate (...) with the bounds of its confidence interval, in its unit."""

    value: NDArray
    low: NDArray
    high: NDArray


def rms_band(norms: NDArray, confidence: float = 0.95) -> Band:
    """Return the root mean square (...) of comprehensive errors (..., N) and what N samples let one say of it."""
    squares = norms * norms
    mean = squares.mean(-1)
    safe = np.where(mean > 0.0, mean, 1.0)
    relative = np.where(mean > 0.0, squares.std(-1, ddof=1) / safe, 0.0) / np.sqrt(norms.shape[-1])
    reach = np.exp(0.5 * NormalDist().inv_cdf(0.5 + 0.5 * confidence) * relative)
    rms = np.sqrt(mean)
    return Band(rms, rms / reach, rms * reach)


def rms_scatter(covariance: NDArray, count: int) -> NDArray:
    """Return the relative standard deviation (...) of an rms from so many samples of errors.

    covariance (..., n, n): that of one sample.
    The variance of a squared normal error is 2 tr C^2; an rms scatters half as much, relatively, as its square.
    """
    trace = np.trace(covariance, axis1=-2, axis2=-1)
    return np.sqrt(0.5 * np.sum(covariance * covariance, (-1, -2)) / count) / trace
