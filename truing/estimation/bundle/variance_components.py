"""Precision of each kind of target in each camera: variance components of rays, and the global test of sigma0.

Helmert's estimation in Foerstner's simplified form (Foerstner 1979; Luhmann et al., section 2.4.2.5): a group's
weighted squares over its share of the redundancy, iterated with the adjustment until the ratio is one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.bundle.adjustment import Adjustment
from truing.estimation.bundle.network import Network

POOLED_GROUPS = -1  # in place of a camera or kind number: several small groups share a component
_FEWEST = 30.0  # redundancy below which a group is pooled: its component would be known to 25 % at best
_BOUNDS = (1e-4, 1e4)  # of a factor; values outside are not measurement noise


@dataclass(frozen=True)
class VarianceComponents:
    """Factors of the rays' covariances: component (N,) of each ray; per component camera (G,) and kind (G,) by number
    (POOLED_GROUPS if shared by small groups); factor (G,) with its standard deviation sigma (G,), redundancy (G,), and
    whether the factor is at a bound (G,)."""

    component: Index
    camera: Index
    kind: Index
    factor: Array
    sigma: Array
    redundancy: Array
    bounded: Mask

    def ray_factors(self) -> Array:
        """Return the factor (N,) of each ray's covariance."""
        return self.factor[self.component]


@dataclass(frozen=True)
class GlobalTest:
    """Global test: sigma0^2 = weighted sum of squares over redundancy, its two-sided limits at level alpha, the
    p-value, and whether the stated standard deviations pass."""

    variance_factor: float
    low: float
    high: float
    p_value: float
    alpha: float

    @property
    def passed(self) -> bool:
        """True if sigma0^2 lies within its limits."""
        return not (self.variance_factor < self.low or self.variance_factor > self.high)


def global_test(chi2: float, redundancy: int, alpha: float = 0.05) -> GlobalTest:
    """Return the two-sided chi-square test of sigma0^2 = chi2 / redundancy against one, NaN without redundancy."""
    from scipy.special import chdtr, chdtrc, chdtri

    if redundancy <= 0:
        return GlobalTest(float("nan"), float("nan"), float("nan"), float("nan"), alpha)
    low, high = chdtri(redundancy, [1 - alpha / 2, alpha / 2]) / redundancy
    p_value = 2 * min(float(chdtr(redundancy, chi2)), float(chdtrc(redundancy, chi2)))
    return GlobalTest(chi2 / redundancy, float(low), float(high), p_value, alpha)


def initial_components(network: Network, used: Mask, redundancy: Array) -> VarianceComponents:
    """Return components with factor one: a group per camera and kind of target, with small groups pooled.

    used (N,): rays that count; redundancy (N,) of each. Small groups are pooled with other small ones of their camera.
    If that is not enough, they join the largest group of their camera, or of all.
    """
    camera = network.image_camera[network.rays.image]
    pairs, component = np.unique(np.stack([camera, network.rays.kind], axis=1), axis=0, return_inverse=True)
    component = component.ravel()
    names = [(int(c), int(k)) for c, k in pairs]
    weight = np.bincount(component, np.where(used, redundancy, 0.0), minlength=len(names))
    target = np.arange(len(names))
    for c in np.unique(pairs[:, 0]):
        small = np.flatnonzero((pairs[:, 0] == c) & (weight < _FEWEST))
        if len(small) == 0 or (len(small) == 1 and len(names) == 1):
            continue
        large = np.flatnonzero((pairs[:, 0] == c) & (weight >= _FEWEST))
        if weight[small].sum() < _FEWEST:
            large = large if len(large) else np.flatnonzero(weight >= _FEWEST)
            target[small] = large[np.argmax(weight[large])] if len(large) else small[0]
        else:
            target[small] = small[0]
    targets, component = np.unique(target[component], return_inverse=True)
    members = [np.flatnonzero(target == k) for k in targets]
    first, second = zip(*((_common(pairs[m, 0]), _common(pairs[m, 1])) for m in members), strict=True)
    ones, zeros = np.ones(len(targets)), np.zeros(len(targets))
    return VarianceComponents(
        component, np.array(first), np.array(second), ones, np.full(len(targets), np.nan), zeros, zeros > 0
    )


def _common(numbers: Index) -> int:
    return int(numbers[0]) if (numbers == numbers[0]).all() else POOLED_GROUPS


def updated_components(
    components: VarianceComponents, adjusted: Adjustment, redundancy: Array, accepted_share: float = 1.0
) -> VarianceComponents:
    """Return the components after one step from the residuals of an adjustment with the present factors.

    redundancy (N, 2, 2): Q_vv C^-1 of every ray, C with its factor. accepted_share: mean square of good rays that a
    test accepts, over that of all good rays. The standard deviations neglect the correlation between groups: exact for
    one group; what several share is distributed by size.
    """
    used, group = adjusted.used, components.component[adjusted.used]
    G = len(components.factor)
    v = adjusted.residuals_px[used]
    P = np.linalg.inv(adjusted.network.rays.cov_px2[used]) / components.ray_factors()[used][:, None, None]
    squares = np.bincount(group, np.einsum("ni,nij,nj->n", v, P, v), minlength=G)
    r = np.bincount(group, np.einsum("nii->n", redundancy[used]), minlength=G).astype(float)
    trace_of_squares = np.bincount(group, np.einsum("nij,nji->n", redundancy[used], redundancy[used]), minlength=G)
    is_determined = r > 1e-6
    ratio = np.where(is_determined, squares / np.where(is_determined, r, 1.0) / accepted_share, 1.0)
    factor = np.clip(components.factor * ratio, *_BOUNDS)
    shared = np.maximum(r - trace_of_squares, 0.0)
    S = np.diag(np.where(is_determined, trace_of_squares, 1.0)) + np.outer(shared, shared) / max(
        float(shared.sum()), 1e-12
    )
    relative_sigma = np.sqrt(2 * np.diag(np.linalg.inv(S)))
    bounded = (factor <= _BOUNDS[0]) | (factor >= _BOUNDS[1])
    return replace(
        components,
        factor=factor,
        sigma=np.where(is_determined, factor * relative_sigma, np.inf),
        redundancy=r,
        bounded=bounded,
    )
