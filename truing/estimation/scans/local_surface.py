"""The surface behind a dense cloud: a paraboloid through the neighbours of a point, with what its noise does.

A tangent plane lies inside every curved surface by more than the noise of a dense scan leaves: a paraboloid does not.
It is a linear smoother, so how much each neighbour enters a height is known, and with it how heights correlate.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

NEIGHBOURS = 14
_COEFFICIENTS = 6
# Median of the chi-square of 8 degrees of freedom, over 8: takes a median of variances to their mean.
_MEDIAN_OF_VARIANCE = 0.9180
# A patch is no patch where it scatters this much more than the median one: an edge, a border of two parts, clutter.
_ROUGH = 5.0
# Within this share of a patch's radius a point is over the surface, beyond that one it is beside it.
_OVER, _BESIDE = 0.7, 1.5
_CHUNK = 20_000


@dataclass(frozen=True)
class Patches:
    """Paraboloids at A anchors of a cloud; m."""

    neighbours: NDArray  # (A, k) points of the cloud that each was fitted to
    centre: NDArray  # (A, 3)
    frame: NDArray  # (A, 3, 3) columns: two tangents and the normal
    radius: NDArray  # (A,) distance of the farthest neighbour
    smoother: NDArray  # (A, 6, k) from the neighbours' heights to the coefficients
    coefficients: NDArray  # (A, 6) of 1, u, v, u^2, u v, v^2 with u, v in units of the radius
    variance: NDArray  # (A,) m^2, of the neighbours about the paraboloid

    @property
    def noise_variance(self) -> float:
        """Variance in m^2 of the cloud along its normal, as the typical patch has it."""
        return float(np.median(self.variance)) / _MEDIAN_OF_VARIANCE

    def smooth(self, least: float) -> NDArray:
        """Whether each anchor (A,) lies on a surface that a paraboloid describes, to a variance that matters, m^2."""
        return self.variance <= _ROUGH * max(float(np.median(self.variance)), least)

    def at(self, rows: NDArray) -> Patches:
        """The patches of some rows."""
        return Patches(*(getattr(self, own.name)[rows] for own in fields(self)))

    def followed_by(self, others: Patches) -> Patches:
        """These patches and others."""
        pairs = ((getattr(self, own.name), getattr(others, own.name)) for own in fields(self))
        return Patches(*(np.concatenate(pair) for pair in pairs))


@dataclass
class Surface:
    """A cloud (M, 3) with its tree, and the paraboloids that were fitted to it so far, each once; m."""

    points: NDArray
    tree: cKDTree
    _fitted: Patches | None = field(default=None, init=False, repr=False)
    _row: NDArray = field(init=False, repr=False)  # (M,) of each point among what was fitted, -1 where it was not

    def __post_init__(self) -> None:
        self._row = np.full(len(self.points), -1)

    def patches(self, anchors: NDArray) -> Patches:
        """The paraboloids at the anchors (A,), different indices of points."""
        missing = anchors[self._row[anchors] < 0]
        if self._fitted is None:
            self._fitted = fit_patches(self.points, self.tree, missing)
            self._row[missing] = np.arange(len(missing))
        elif len(missing):
            self._row[missing] = len(self._fitted.variance) + np.arange(len(missing))
            self._fitted = self._fitted.followed_by(fit_patches(self.points, self.tree, missing))
        return self._fitted.at(self._row[anchors])


@dataclass(frozen=True)
class Heights:
    """N points seen from the patches below them; m."""

    height: NDArray  # (N,) signed distance from the surface
    normal: NDArray  # (N, 3) of the surface below each point
    share: NDArray  # (N, k) by which each neighbour's own error along the normal enters the height
    slope_variance: NDArray  # (N,) variance of one tangential component of the normal, per variance of the noise
    over: NDArray  # (N,) whether the point lies over its patch, and the patch is smooth
    beside: NDArray  # (N,) whether the point lies clearly beside the surface


def fit_patches(points: NDArray, tree: cKDTree, anchors: NDArray) -> Patches:
    """Return paraboloids at the anchors (A,), indices of points (M, 3); tree is the cKDTree of the points."""
    chunks = [_fit_chunk(points, tree, anchors[s : s + _CHUNK]) for s in range(0, max(len(anchors), 1), _CHUNK)]
    return Patches(*(np.concatenate(column) for column in zip(*chunks, strict=True)))


def heights_over(patches: Patches, which: NDArray, points: NDArray, sigma: float) -> Heights:
    """Return points (N, 3) as seen from patch number which (N,) each, in the frame of the patches' cloud.

    sigma in m is the points' own noise: a patch that is rough by less than that is smooth enough.
    """
    radius = patches.radius[which]
    u, v, w = np.einsum("ni,nij->jn", points - patches.centre[which], patches.frame[which])
    u, v = u / radius, v / radius
    c = patches.coefficients[which]
    one, zero = np.ones_like(u), np.zeros_like(u)
    basis = np.stack([one, u, v, u * u, u * v, v * v], -1)
    along_u = np.stack([zero, one, zero, 2 * u, v, zero], -1) / radius[:, None]
    along_v = np.stack([zero, zero, one, zero, u, 2 * v], -1) / radius[:, None]
    slope = np.stack([-np.sum(along_u * c, -1), -np.sum(along_v * c, -1), one], -1)
    secant = np.linalg.norm(slope, axis=1)
    smoother = patches.smoother[which]
    share = np.einsum("ni,nik->nk", basis, smoother) / secant[:, None]
    tilt = [np.sum(np.einsum("ni,nik->nk", d, smoother) ** 2, -1) for d in (along_u, along_v)]
    normal = np.einsum("nij,nj->ni", patches.frame[which], slope / secant[:, None])
    away, height = u * u + v * v, (w - np.sum(basis * c, -1)) / secant
    over = (away <= _OVER**2) & patches.smooth(sigma**2)[which]
    return Heights(height, normal, share, (tilt[0] + tilt[1]) / 2, over, away > _BESIDE**2)


def workers_for(n_queries: int) -> int:
    """Return how many threads a tree is asked with: starting them costs more than a few thousand queries."""
    return -1 if n_queries >= _CHUNK else 1


def _fit_chunk(points: NDArray, tree: cKDTree, anchors: NDArray) -> tuple[NDArray, ...]:
    distance, neighbours = tree.query(points[anchors], k=NEIGHBOURS, workers=workers_for(len(anchors)))
    near = points[neighbours]
    centre = near.mean(1)
    offset = near - centre[:, None]
    _, axes = np.linalg.eigh(np.swapaxes(offset, 1, 2) @ offset)
    frame, radius = axes[:, :, ::-1], np.maximum(distance[:, -1], np.finfo(float).tiny)
    u, v, w = np.moveaxis(offset @ frame, -1, 0)
    u, v = u / radius[:, None], v / radius[:, None]
    basis = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], -1)
    # The ridge, 1e-9 of the neighbours' weight, only matters where they repeat each other.
    normal_matrix = np.swapaxes(basis, 1, 2) @ basis + 1e-9 * NEIGHBOURS * np.eye(_COEFFICIENTS)
    smoother = np.linalg.solve(normal_matrix, np.swapaxes(basis, 1, 2))
    coefficients = np.einsum("aik,ak->ai", smoother, w)
    residual = w - np.einsum("aki,ai->ak", basis, coefficients)
    variance = np.sum(residual**2, -1) / (NEIGHBOURS - _COEFFICIENTS)
    return neighbours, centre, frame, radius, smoother, coefficients, variance
