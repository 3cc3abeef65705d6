"""Did a camera stay what it was from pose to pose?

Per pose, principal distance and principal point are held against common ones by what its rays tell of them, which is
normal: score n ~ N(N d, N) with information N, d the pose's deviation (`ray_statistics`). `image_stability` goes on
to single images.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Mask
from truing.estimation.quality import holm_adjusted

WATCHED = ("c", "x0", "y0")


@dataclass(frozen=True)
class CameraStability:
    """Per pose (S): whether its rays tell of the camera at all, deviation_px (S, 3) of c, x0, y0 from the values common
    to the poses that do, with covariance_px2 (S, 3, 3), chi2 (S,) of it and p_value (S,) adjusted for their number
    (Holm); NaN for poses that tell nothing. Of all: chi2 of no deviation with its degrees of freedom and its
    p-value."""

    determined: Mask
    deviation_px: Array
    covariance_px2: Array
    chi2: Array
    p_value: Array
    overall_chi2: float
    freedom: int
    overall_p_value: float


def camera_stability(score: Array, information: Array) -> CameraStability:
    """Differences of one camera between poses, from score (S, 3) and information (S, 3, 3) of each.

    A pose's deviation from the common values, which it has a part in, has covariance N^-1 - (sum N)^-1.
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
    apart = np.einsum("pij,pj->pi", inverse, n) - of_common @ n.sum(axis=0)
    own = inverse - of_common
    single = np.einsum("pi,pi->p", apart, np.linalg.solve(own, apart[..., None])[..., 0])
    deviation[determined], covariance[determined], chi2[determined] = apart, own, single
    p_value[determined] = holm_adjusted(chdtrc(size, single))
    overall, freedom = float(np.einsum("pi,pij,pj->", apart, N, apart)), size * (len(N) - 1)
    return CameraStability(
        determined, deviation, covariance, chi2, p_value, overall, freedom, float(chdtrc(freedom, overall))
    )  # fmt: skip
