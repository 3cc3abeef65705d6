"""Numbers measured in a pose, by the names that tables of joint covariances give them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


def pose_numbers(body: str) -> NDArray[np.object_]:
    """What the six numbers of a body's pose, (p, theta), are called in tables of joint covariances."""
    return np.array([f"{body} {name}" for name in ("px", "py", "pz", "rx", "ry", "rz")], dtype=object)


def shift_number(leg: int) -> str:
    """What the shift of an attachment, legs from 1, is called in tables of joint covariances."""
    return f"shift {leg}"


@dataclass(frozen=True)
class NetworkErrors:
    """Errors of the numbers measured (Q) in each of B poses, SI: covariance (B, Q, Q) of those of one pose, NaN where
    it is not told; effects (B, Q, K) of K errors common to all poses, independent and of one standard deviation each,
    which are in the covariance."""

    numbers: tuple[str, ...]
    covariance: NDArray
    effects: NDArray

    def chosen(self, rows: NDArray) -> NetworkErrors:
        """Return those of some poses."""
        return NetworkErrors(self.numbers, self.covariance[rows], self.effects[rows])

    def of(self, numbers: Sequence[str], is_measured: NDArray) -> tuple[NDArray, NDArray]:
        """Return covariance (B, n, n), NaN where not told, and effects (B, n, K), zero there, of the numbers named, as
        far as they are told (B, n)."""
        known = {name: n for n, name in enumerate(self.numbers)}
        place = np.array([known.get(name, -1) for name in numbers])
        covariance = self.covariance[:, place[:, None], place]
        diagonal = np.diagonal(covariance, axis1=1, axis2=2)
        there = is_measured & (place >= 0) & np.isfinite(diagonal)
        covariance = np.where(there[:, :, None] & there[:, None], covariance, np.nan)
        return covariance, np.where(there[..., None], self.effects[:, place], 0.0)
