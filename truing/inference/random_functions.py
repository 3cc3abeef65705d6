"""Random functions of inputs as arrays: smooth ones, and those of any form of inputs with few distinct values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from truing.inference.arrays import Array, Integers

MOST_FUNCTIONS = 60  # of one set of inputs
SCALES = 0.5, 0.9, 1.6  # length scales, in standard deviations of the inputs
_CORRELATED = 0.02, 0.1  # lengths of correlation in time, as shares of the epochs
_DISTINCT = 1e-2  # functions below this share of the strongest are dropped
_REPEATED = 0.7  # fewer distinct values than this share: functions of any form can be distinguished from chance


def smooth_functions(columns: Array, most: int, scales: Sequence[float]) -> Iterator[Array]:
    """Yield functions (n, m) of inputs (n, D) that approximate a Gaussian process, for each length scale in standard
    deviations of the inputs. The products of the functions are the covariance of the process, exact at its landmarks,
    of which there are at most ``most``."""
    x = standard(columns)
    marks = _landmarks(x, most)
    among, cross = _exponents(marks, marks), _exponents(x, marks)
    for scale in scales:
        values, vectors = np.linalg.eigh(np.exp(among / scale**2))
        is_large = values > 1e-4 * values[-1]
        yield np.asarray(np.exp(cross / scale**2) @ (vectors[:, is_large] / np.sqrt(values[is_large])))


def rough_functions(order: Array, most: int) -> Iterator[Array]:
    """Yield functions (n, m) of the rank in time of n epochs.

    Their random combinations are stationary noise that is correlated over a share of the epochs, and a random walk.

    Cosines have the spectrum of an autoregressive process of first order. Smooth functions cannot take its place: their
    combinations are too smooth, so that those of time and another input would be more probable.
    """
    count = len(order)
    rank = np.argsort(np.argsort(order, kind="stable"))
    number = np.arange(1, min(most, count - 1) + 1)
    waves = np.cos(np.pi * number * (rank[:, None] + 0.5) / count)
    for share in _CORRELATED:
        yield waves / np.sqrt(1.0 + (np.pi * share * number) ** 2)
    yield waves / number


def level_functions(columns: Array) -> Array | None:
    """Return indicators (n, m) of the distinct values of inputs (n, D), for functions of any form; None where too few
    are repeated."""
    distinct, number = np.unique(np.round(standard(columns), 9), axis=0, return_inverse=True)
    return np.eye(len(distinct))[number.ravel()] if len(distinct) <= _REPEATED * len(columns) else None


def _landmarks(x: Array, most: int) -> Array:
    """Return at most ``most`` landmarks (n, D): the place nearest to the middle, then repeatedly the farthest one."""
    distinct = distinct_rows(np.round(x, 9))
    if len(distinct) <= most:
        return distinct
    chosen = [int(np.argmin(np.sum(distinct**2, 1)))]
    far = np.sum((distinct - distinct[chosen[0]]) ** 2, 1)
    while len(chosen) < most:
        chosen.append(int(np.argmax(far)))
        far = np.minimum(far, np.sum((distinct - distinct[chosen[-1]]) ** 2, 1))
    return distinct[chosen]


def distinct_rows(rows: Array) -> Array:
    """Return the distinct ones of rows (n, D), sorted; in a fraction of the time that `numpy.unique` takes."""
    ordered = rows[np.lexsort(rows.T[::-1])]
    return np.asarray(ordered[np.concatenate([[True], np.any(ordered[1:] != ordered[:-1], 1)])])


def _exponents(first: Array, second: Array) -> Array:
    """Return the exponents (n, m) of a Gaussian covariance of unit length scale between places (n, D) and (m, D)."""
    squares = np.sum(first**2, 1)[:, None] + np.sum(second**2, 1) - 2.0 * (first @ second.T)
    return np.asarray(-0.5 * np.maximum(squares, 0.0))


def standard(columns: Array) -> Array:
    """Return columns (n, D) less their means, in units of their standard deviations."""
    spread = columns.std(0)
    return np.asarray((columns - columns.mean(0)) / np.where(spread > 0.0, spread, 1.0))


def centred(rows: Array, groups: Integers | None = None) -> Array:
    """Return rows (n, q) less their mean, group by group."""
    if groups is None:
        return np.asarray(rows - rows.mean(0))
    number = np.unique(groups, return_inverse=True)[1]
    mean = np.stack([np.bincount(number, column) for column in rows.T], -1) / np.bincount(number)[:, None]
    return np.asarray(rows - mean[number])


def orthonormal(functions: Array, least: float = _DISTINCT) -> Array:
    """Return an orthonormal basis (n, r) of functions (n, m), without directions below a share of the largest."""
    basis, size, _ = np.linalg.svd(functions, full_matrices=False)
    return np.asarray(basis[:, size > least * size.max(initial=0.0)])


def of_unit_variance(functions: Array) -> Array:
    """Return functions (n, m) whose random combinations have unit variance on average."""
    return np.asarray(functions / np.sqrt(np.mean(np.sum(centred(functions) ** 2, 1))))
