"""Platform errors by tolerances of a 6-UPUR sensor: random samples, and covariances to first order (paper, eq. 16-17).

T is the full width of a tolerance zone: sigma = T / 6, so that three sigma reach its border. A normal distribution
exceeds it in 0.27 % of the samples, unless these are bounded.

The pose of a platform on legs with errors is solved without linearisation, for many sensors at once. Each leg keeps its
length, `|P + R b' - B'| = L'`, with its actual radii and length. Newton's method uses the unloaded sensor's matrix
throughout: errors of 1e-4 of a leg shrink by that factor with every step. Each coordinate is one array over samples, so
that NumPy runs along memory.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.simulation.bench.six_upur.geometry import JointCentres, outward
from truing.simulation.bench.six_upur.influence import influence_matrix

_MAX_ITERATIONS = 30
# Remaining error, relative to a leg's length, at which the iteration ends.
_ROUNDING = 1e-16
Three = tuple[NDArray, NDArray, NDArray]


@dataclass(frozen=True)
class _LegGeometry:
    """Geometry common to all samples: (3, 6, 1) legs, arms and outward directions below and above; 1 / G; (6, 1)
    lengths."""

    leg: NDArray
    arm: NDArray
    below: NDArray
    above: NDArray
    inverse: NDArray
    length: NDArray


def plan_of(joints: JointCentres) -> _LegGeometry:
    """Return the arguments of `platform_errors` for one sensor; raises LinAlgError if six legs do not hold the
    platform."""
    arrays = (joints.leg, joints.arm, outward(joints.lower), outward(joints.arm))
    leg, arm, below, above = (array.T[..., None] for array in arrays)
    return _LegGeometry(leg, arm, below, above, np.linalg.inv(influence_matrix(joints)), joints.length[:, None])


def assembled(joints: JointCentres, errors: NDArray) -> NDArray:
    """Return platform errors (N, 6), m and rotation vector in rad, of sensors with errors (N, 6, 5) of the sources, m.

    NaN if the legs do not close.
    """
    return platform_errors(plan_of(joints), np.ascontiguousarray(np.transpose(errors, (2, 1, 0)))).T


def platform_errors(plan: _LegGeometry, errors: NDArray) -> NDArray:
    """Return platform errors (6, N) of sensors with errors (5, 6, N), m, in the order of `assembly.SOURCES`."""
    above, below, low, middle, installed = errors
    wanted = plan.length + low - middle + installed
    wider = [direction * above for direction in plan.above]
    arm = _three(old + more for old, more in zip(plan.arm, wider, strict=True))
    base = (direction * below for direction in plan.below)
    leg = _three(old + more - moved for old, more, moved in zip(plan.leg, wider, base, strict=True))
    square, per_length = wanted * wanted, 0.5 / plan.length
    step = _combined(plan.inverse, (_squared(leg) - square) * per_length)
    x, lost = -step, np.zeros(errors.shape[-1], bool)
    shortest = before = float(plan.length.min())
    for _ in range(_MAX_ITERATIONS):
        reach = np.abs(step).max(0)
        if reach.max() > shortest:
            lost |= reach > shortest
        size = float(reach.max(where=~lost, initial=0.0))
        if size * size <= before * _ROUNDING * shortest:  # steps shrink by size / before
            break
        before = size
        step = _combined(plan.inverse, (_squared(_displaced_legs(leg, arm, x)) - square) * per_length)
        if lost.any():
            step[:, lost] = 0.0
        x -= step
    else:
        lost |= reach > np.sqrt(_ROUNDING) * shortest
    x[:, lost] = np.nan
    return _with_rotation_vector(x)


def _displaced_legs(leg: Three, arm: Three, x: NDArray) -> Three:
    """Return the legs (3 of (6, N)) with the platform moved by x: a shift, and half a rotation in Cayley's form.

    R = I + 2 ([c]x + [c]x^2) / (1 + c^2), one matrix per sample instead of one product per leg.
    """
    a, b, c = 0.5 * x[3], 0.5 * x[4], 0.5 * x[5]
    aa, bb, cc = a * a, b * b, c * c
    scale = 2.0 / (1.0 + aa + bb + cc)
    rows = (
        (-scale * (bb + cc), scale * (a * b - c), scale * (a * c + b)),
        (scale * (a * b + c), -scale * (aa + cc), scale * (b * c - a)),
        (scale * (a * c - b), scale * (b * c + a), -scale * (aa + bb)),
    )
    buffer = np.empty_like(arm[0])
    return _three(_add_row_product(row, arm, leg[i] + x[i], buffer) for i, row in enumerate(rows))


def _add_row_product(row: Three, arm: Three, total: NDArray, buffer: NDArray) -> NDArray:
    """Add a row of a matrix times the arms to total (6, N), in place; buffer is memory for one product."""
    for number, part in zip(row, arm, strict=True):
        total += np.multiply(number, part, out=buffer)
    return total


def _with_rotation_vector(x: NDArray) -> NDArray:
    """Replace twice the tangent of the half angle by the rotation vector in x (6, N), in place."""
    tangent = 0.5 * np.sqrt(_squared((x[3], x[4], x[5])))
    still = tangent == 0.0
    x[3:] *= np.where(still, 1.0, np.arctan(tangent) / np.where(still, 1.0, tangent))
    return x


def _combined(inverse: NDArray, long: NDArray) -> NDArray:
    """Return inverse' long (6, N), summed leg by leg: library products may add in another order on other machines."""
    step, buffer = inverse[0][:, None] * long[0], np.empty_like(long)
    for row, values in zip(inverse[1:], long[1:], strict=True):
        step += np.multiply(row[:, None], values, out=buffer)
    return step


def _three(parts: Iterable[NDArray]) -> Three:
    x, y, z = parts
    return x, y, z


def _squared(v: Three) -> NDArray:
    total, buffer = v[0] * v[0], np.empty_like(v[0])
    for part in v[1:]:
        total += np.multiply(part, part, out=buffer)
    return total


# Samples per stream of random numbers: fixed, so that the results of a seed do not depend on the machine.
_STREAM = 1 << 14
# Samples per block, whose arrays fit into a processor's cache.
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

    Closed loops, not linearised. The same generator gives the same bytes for any number of workers, because every 16384
    samples have their own stream. bounded: errors beyond T / 2 = 3 sigma are drawn again.
    """
    plan, widths = plan_of(joints), np.asarray(sigma, float)
    errors = np.empty((count, 6))

    def fill(start: int, stream: np.random.Generator) -> None:
        for block in _blocks(start, min(start + _STREAM, count)):
            errors[block] = platform_errors(plan, _drawn(widths, block.stop - block.start, stream, bounded)).T

    starts = range(0, count, _STREAM)
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(fill, starts, rng.spawn(len(starts))))
    return errors


def _blocks(start: int, stop: int) -> Iterator[slice]:
    return (slice(first, min(first + _BLOCK, stop)) for first in range(start, stop, _BLOCK))


def _drawn(sigma: NDArray, count: int, rng: np.random.Generator, bounded: bool) -> NDArray:
    """Return errors (5, 6, count), m; sources without tolerance consume no random numbers."""
    active = np.flatnonzero(sigma)
    drawn = rng.standard_normal((len(active), 6, count))
    while bounded and (beyond := np.abs(drawn) > _BORDER).any():
        drawn[beyond] = rng.standard_normal(np.count_nonzero(beyond))
    errors = np.zeros((len(sigma), 6, count))
    errors[active] = sigma[active, None, None] * drawn
    return errors


def first_order_covariances(error_map: NDArray, sigma: ArrayLike) -> NDArray:
    """Return the contribution of each source to the covariance of the platform's error (..., 5, 6, 6), m and rad.

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
    """Return the root mean square (...) of comprehensive errors (..., N), with its confidence interval from N
    samples."""
    squares = norms * norms
    mean = squares.mean(-1)
    safe = np.where(mean > 0.0, mean, 1.0)
    relative = np.where(mean > 0.0, squares.std(-1, ddof=1) / safe, 0.0) / np.sqrt(norms.shape[-1])
    reach = np.exp(0.5 * NormalDist().inv_cdf(0.5 + 0.5 * confidence) * relative)
    rms = np.sqrt(mean)
    return Band(rms, rms / reach, rms * reach)


def rms_scatter(covariance: NDArray, count: int) -> NDArray:
    """Return the relative standard deviation (...) of an rms from ``count`` samples of errors.

    covariance (..., n, n): of one sample. The variance of a squared normal error is 2 tr C^2; the relative scatter of
    an rms is half that of its square.
    """
    trace = np.trace(covariance, axis1=-2, axis2=-1)
    return np.sqrt(0.5 * np.sum(covariance * covariance, (-1, -2)) / count) / trace
