"""Test whether the interior orientation of a camera changed between poses.

Principal distance and principal point of each pose are compared with common values through the statistics of its rays:
score n ~ N(N d, N) with information N and deviation d of the pose (`ray_statistics`). `image_stability` tests single
images.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Mask
from truing.estimation.quality import holm_adjusted

WATCHED = ("c", "x0", "y0")


@dataclass(frozen=True)
class CameraStability:
    """Deviations of a camera's interior orientation per pose (S), with tests.

    determined (S,): whether the rays of a pose determine the camera. deviation_px (S, 3) of c, x0, y0 from the common
    values, with covariance_px2 (S, 3, 3); chi2 (S,) and p_value (S,) adjusted for their number (Holm); NaN if not
    determined. For all poses together: chi2 of no deviation, degrees of freedom, p-value.
    """

    determined: Mask
    deviation_px: Array
    covariance_px2: Array
    chi2: Array
    p_value: Array
    overall_chi2: float
    freedom: int
    overall_p_value: float


def camera_stability(score: Array, information: Array) -> CameraStability:
    """Return the deviations of one camera per pose from score (S, 3) and information (S, 3, 3).

    The common values include the pose itself, so its deviation has the covariance N^-1 - (sum N)^-1.
    """
    from scipy.special import chdtrc

    determined = np.array(
        [np.linalg.matrix_rank(block, hermitian=True) == len(block) for block in information], dtype=bool
    )
    N, n = information[determined], score[determined]
    poses, size = len(score), score.shape[1]
    deviation, covariance = np.full((poses, size), np.nan), np.full((poses, size, size), np.nan)
    chi2, p_value = np.full(poses, np.nan), np.full(poses, np.nan)
    if determined.sum() < 2:
        return CameraStability(determined, deviation, covariance, chi2, p_value, float("nan"), 0, float("nan"))
    inverse, of_common = np.linalg.inv(N), np.linalg.inv(N.sum(axis=0))
    changes = np.einsum("pij,pj->pi", inverse, n) - of_common @ n.sum(axis=0)
    unshared = inverse - of_common
    single = np.einsum("pi,pi->p", changes, np.linalg.solve(unshared, changes[..., None])[..., 0])
    deviation[determined], covariance[determined], chi2[determined] = changes, unshared, single
    p_value[determined] = holm_adjusted(chdtrc(size, single))
    overall, freedom = float(np.einsum("pi,pij,pj->", changes, N, changes)), size * (len(N) - 1)
    return CameraStability(
        determined, deviation, covariance, chi2, p_value, overall, freedom, float(chdtrc(freedom, overall))
    )  # fmt: skip
