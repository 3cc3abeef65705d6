"""Whether what a fit leaves is more than the declared noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.diagnosis.noise_components import NOISE_PRIOR_FREEDOM
from truing.estimation.diagnosis.point_fit import MeasuredPoints
from truing.estimation.diagnosis.whitening import Whitened


@dataclass(frozen=True)
class NoiseLevel:
    """The noise found over the declared one, its standard deviation, and the chance of so much where the declared
    one is right to within what it is taken to be known."""

    ratio: float
    sigma: float
    p_value: float


def noise_level(
    whitened: Whitened, measured: MeasuredPoints, declared: NDArray, targets: NDArray | None = None
) -> NoiseLevel:
    """Return the level of the noise that a fit leaves in the points over the declared covariances (B, K, d, d).

    Of all targets, or of those that ``targets`` (K,) marks. Its logarithm is tested, one-sided; ``measured`` holds the
    covariances that the fit used.
    """
    poses, count = measured.seen.shape
    seen = measured.seen if targets is None else measured.seen & targets
    size = measured.size
    height = size * count + whitened.problem.local_value.shape[1]

    def of_points(rows: NDArray) -> NDArray:
        own = rows[: poses * height].reshape(poses, height)[:, : size * count]
        return np.asarray(own.reshape(poses, count, size)[seen])

    used, promised = measured.covariance[seen], declared[seen]
    change = np.linalg.solve(np.linalg.cholesky(promised), np.linalg.cholesky(used))
    rest = np.einsum("nij,nj->ni", change, of_points(whitened.rest))
    freedom = float(np.sum(1.0 - of_points(whitened.leverage)))
    ratio = float(np.sqrt(np.sum(rest**2) / freedom))
    spread = math.sqrt(0.5 / NOISE_PRIOR_FREEDOM + 0.5 / freedom)
    p_value = 0.5 * math.erfc(math.log(ratio) / spread / math.sqrt(2.0))
    return NoiseLevel(ratio, ratio * math.sqrt(0.5 / freedom), p_value)
