"""Names and joint errors of the numbers measured in a pose, as used in tables of joint covariances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


def pose_numbers(body: str) -> NDArray[np.object_]:
    """Return the names of the six numbers of a body's pose, (p, theta), in tables of joint covariances."""
    return np.array([f"{body} {name}" for name in ("px", "py", "pz", "rx", "ry", "rz")], dtype=object)


def shift_number(leg: int) -> str:
    """Return the name of the shift of an attachment, legs from 1, in tables of joint covariances."""
    return f"shift {leg}"


@dataclass(frozen=True)
class NetworkErrors:
    """Errors of the numbers measured (Q) in each of B poses, SI.

    covariance (B, Q, Q): within one pose, NaN if unknown; effects (B, Q, K): of K independent unit-variance errors
    common to all poses, which the covariance includes.
    """

    numbers: tuple[str, ...]
    covariance: NDArray
    effects: NDArray

    def subset(self, rows: NDArray) -> NetworkErrors:
        """Return the errors of some poses."""
        return NetworkErrors(self.numbers, self.covariance[rows], self.effects[rows])

    def of(self, numbers: Sequence[str], is_measured: NDArray) -> tuple[NDArray, NDArray]:
        """Return covariance (B, n, n), NaN if unknown; effects (B, n, K), zero if unknown, and the mask (B, n) of known
        values, for the named numbers."""
        known = {name: n for n, name in enumerate(self.numbers)}
        index = np.array([known.get(name, -1) for name in numbers])
        covariance = self.covariance[:, index[:, None], index]
        diagonal = np.diagonal(covariance, axis1=1, axis2=2)
        there = is_measured & (index >= 0) & np.isfinite(diagonal)
        covariance = np.where(there[:, :, None] & there[:, None], covariance, np.nan)
        return covariance, np.where(there[..., None], self.effects[:, index], 0.0)
