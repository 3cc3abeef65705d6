"""Test whether the residuals of neighbouring places of a group are more alike than noise, within an epoch.

A bending group, or an instrument with errors by place, moves neighbouring places alike; the amount differs between
epochs. Spread over all places, this passes for a little more noise. The statistic is the sum over pairs of places of
the products of their residuals, weighted by nearness: the score test of a random field's variance. Its mean and
variance under noise follow from the projection that the fit applies to noise, whose size each place has of its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from truing.inference.arrays import Array, Integers, Mask
from truing.inference.linear_problem import Whitened

# Distance at which places are near each other, in units of the rms distance from their group's centre.
_NEAR = 0.4
# Fewest places of a group whose residuals are compared, and most epochs: of more, a sample is tested.
_FEWEST_PLACES, _MOST_EPOCHS = 4, 500
_PRIOR = 0.01  # weight of the common noise in the noise of each place
_LEAST_P = 1e-12


@dataclass(frozen=True)
class SpatialCorrelation:
    """Mean correlation of residuals of neighbouring places, weighted by nearness, and its p-value."""

    correlation: float
    p_value: float


def has_neighbours(groups: Integers) -> bool:
    """Return True if a group, of the number ``groups`` (K,) of each place, has enough places to compare."""
    return bool((np.unique(groups, return_counts=True)[1] >= _FEWEST_PLACES).any())


def spatial_correlation(
    whitened: Whitened,
    shape: tuple[int, int, int],
    places: Array,
    groups: Integers,
    rng: np.random.Generator,
    selected: Integers | None = None,
) -> SpatialCorrelation | None:
    """Return the correlation of residuals between neighbouring places of a group, within epochs.

    ``shape``: epochs, places and axes (B, K, d) of the observations; ``places`` (K, D); ``groups`` (K,): number of each
    place's group; ``selected``: numbers of the epochs to test, all without. None where no group has enough places, or
    where the fit leaves no residuals there.
    """
    near = _nearness(places, groups)
    epochs, count, size = shape
    if size == 1 or not near.any():
        return None
    chosen = np.arange(epochs) if selected is None else selected
    if len(chosen) > _MOST_EPOCHS:
        chosen = np.sort(rng.choice(chosen, _MOST_EPOCHS, replace=False))
    rest, projection = _residuals(whitened, epochs, count * size, chosen)
    noise = _noise_of_places(rest, projection, count)
    if noise is None:
        return None
    weights = np.kron(near, np.eye(size)) / np.sqrt(np.outer(noise, noise))
    excess, variance, weight = 0.0, 0.0, 0.0
    for residual, projector in zip(rest, projection, strict=True):
        along = weights @ ((projector * noise) @ projector)
        excess += float(residual @ weights @ residual - np.trace(along))
        variance += 2.0 * float(np.sum(along * along.T))
        seen = (np.diagonal(projector).reshape(count, size) > 0.0).astype(float)
        weight += float(np.sum(near * (seen @ seen.T)))
    if not variance > 0.0:
        return None
    p_value = 0.5 * math.erfc(excess / math.sqrt(2.0 * variance))
    return SpatialCorrelation(excess / weight, max(p_value, _LEAST_P))


def _nearness(places: Array, groups: Integers) -> Array:
    """Return the weight (K, K) of each pair of places: a Gaussian of their distance in a group, zero between groups and
    for a place with itself."""
    weights = np.zeros((len(places), len(places)))
    for group in np.unique(groups):
        members = np.flatnonzero(groups == group)
        centred = places[members] - places[members].mean(0)
        size = float(np.sqrt(np.mean(np.sum(centred**2, 1))))
        if len(members) < _FEWEST_PLACES or not size > 0.0:
            continue
        squares = np.sum((centred[:, None] - centred) ** 2, -1)
        weights[np.ix_(members, members)] = np.exp(-0.5 * squares / (_NEAR * size) ** 2)
    np.fill_diagonal(weights, 0.0)
    return weights


def _residuals(whitened: Whitened, epochs: int, observed: int, chosen: Integers) -> tuple[Array, Array]:
    """Return the residuals (b, N) of the chosen epochs, and the projections (b, N, N) that the fit applies to noise;
    zero where nothing was seen."""
    height = observed + whitened.problem.local_value.shape[1]
    rows = slice(0, epochs * height)
    residuals = whitened.rest[rows].reshape(epochs, height)[chosen, :observed]
    is_observed: Mask = whitened.present[rows].reshape(epochs, height)[chosen, :observed]
    local = whitened.local_basis[chosen, :observed]
    shared = whitened.basis_at(chosen)[:, :observed]
    projection = np.eye(observed) - local @ np.swapaxes(local, 1, 2) - shared @ np.swapaxes(shared, 1, 2)
    return np.where(is_observed, residuals, 0.0), projection * (is_observed[:, :, None] & is_observed[:, None])


def _noise_of_places(residuals: Array, projection: Array, count: int) -> Array | None:
    """Return the variance of noise (N,) of each row, equal for the axes of a place; None where the fit leaves nothing.

    Squares of residuals are the projection's squares times the variances, which are solved for (MINQUE; C. R. Rao, J.
    Multivariate Analysis 1 (1971) 257). A little weight on a common variance keeps places regular of which the fit
    leaves little.
    """
    size = residuals.shape[1] // count
    shares = np.sum(projection**2, 0).reshape(count, size, count, size).sum((1, 3))
    squares = np.sum(residuals**2, 0).reshape(count, size).sum(1)
    if not shares.sum() > 0.0:
        return None
    common = squares.sum() / shares.sum()
    prior = _PRIOR * np.trace(shares) / count
    variances = np.linalg.solve(shares + prior * np.eye(count), squares + prior * common)
    return np.repeat(np.maximum(variances, _PRIOR * common), size)
