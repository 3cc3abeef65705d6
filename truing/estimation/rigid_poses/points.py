"""Points of a body over all poses, and its survey: dense arrays in m."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SurveyPoints:
    """One body's survey: targets (T names), points (T, 3) in m in the body frame, cov (T, 3, 3) in m^2, leg
    (T,), 0 for none."""

    targets: tuple[str, ...]
    points: Array
    cov: Array
    leg: NDArray[np.int64]


@dataclass(frozen=True)
class PosePoints:
    """One body over all poses: poses (B ids), targets (T names), points (B, T, 3) in m as measured, zero where
    not seen; cov (B, T, 3, 3) in m^2; seen (B, T)."""

    poses: tuple[int | str, ...]
    targets: tuple[str, ...]
    points: Array
    cov: Array
    seen: NDArray[np.bool_]
