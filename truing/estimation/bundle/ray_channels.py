"""Independent channels of unit noise that hold all that the rays of a pose tell of shared numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.bundle.network import Array

# What is left of a number's information once others are free, below which a pose does not tell it.
_LEFT = 1e-8


@dataclass(frozen=True)
class RayChannels:
    """By pose (S): values (S, T) with noise of one, that follow the numbers by root (S, T, T); told (S, T): which say
    anything. The channel of a number is free of all numbers before it."""

    value: Array
    root: Array
    told: NDArray[np.bool_]


def ray_channels(information: Array, score: Array) -> RayChannels:
    """Return the channels of information (S, T, T) and scores (S, T): Cholesky's factor, pose by pose, that leaves out
    what the numbers after it tell as well."""
    left, rest = information.copy(), score.copy()
    whole = np.diagonal(information, axis1=1, axis2=2)
    root, value = np.zeros_like(information), np.zeros_like(score)
    told = np.zeros(score.shape, bool)
    for k in range(score.shape[1]):
        pivot = left[:, k, k]
        told[:, k] = pivot > _LEFT * whole[:, k]
        factor = np.where(told[:, k], 1 / np.sqrt(np.where(told[:, k], pivot, 1.0)), 0.0)
        root[:, k, k:] = left[:, k, k:] * factor[:, None]
        value[:, k] = rest[:, k] * factor
        left -= root[:, k, :, None] * root[:, k, None]
        rest -= root[:, k] * value[:, k, None]
    return RayChannels(value, root, told)
