"""Rigid motion between corresponding points in closed form, for batches of poses.

``target = scale R source + t``: source is the body's survey, target the measurement, both in m. A missing point has
weight 0, and may then be NaN.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.estimation.covariance import weighted_fit_covariance

# A spread below this share of the distance from the origin is rounding.
_ROUNDING = 1e-13
# A spread across a line below 1e-6 of that along it counts as zero; singular values go with its square.
_SINGULAR = 1e-12


class FitStatus(StrEnum):
    """Status of a fit, with the remedy; entries other than OK have no numbers."""

    OK = "ok"
    TOO_FEW_POINTS = "too-few-points"
    COINCIDENT = "coincident"
    COLLINEAR = "collinear"
    AMBIGUOUS = "ambiguous"
    NOT_CONVERGED = "not-converged"
    NO_CONSENSUS = "no-consensus"

    @property
    def remedy(self) -> str:
        """Advice for the reader of the status, in one sentence."""
        return _REMEDIES[self]


_REMEDIES = {
    FitStatus.OK: "Nothing to do.",
    FitStatus.TOO_FEW_POINTS: "A pose needs three points of the body: measure more targets, check names.",
    FitStatus.COINCIDENT: "All points are one and the same: check the coordinates and their mapping.",
    FitStatus.COLLINEAR: "All points lie on one line and leave its roll free: add a target off it.",
    FitStatus.AMBIGUOUS: "Several attitudes fit equally well: check for mirrored axes and labels.",
    FitStatus.NOT_CONVERGED: "The iteration did not settle: check for gross errors, or start closer.",
    FitStatus.NO_CONSENSUS: "Too few points agree on one motion: check labels, and that it is rigid.",
}


@dataclass(frozen=True)
class RigidFit:
    """A batch of B rigid motions ``target = scale R source + t``; m and rad. A fit of two single clouds has no batch.

    Entries whose ``status`` is not OK have NaN numbers, so that a caller that ignores the status cannot use a wrong
    number. ``n_used`` and ``status`` are always valid.
    """

    R: NDArray  # (B, 3, 3) R_target_source
    t: NDArray  # (B, 3) m, position of the source frame's origin in the target frame
    scale: NDArray  # (B,) 1 unless a scale was fitted
    covariance: NDArray  # (B, 6, 6) of (t, theta), R <- exp(theta) R, in the target frame; m and rad
    scale_sigma: NDArray  # (B,) standard deviation of scale, 0 unless it was fitted
    rms: NDArray  # (B,) m, root of the weighted mean squared distance (all three coordinates)
    n_used: NDArray  # (B,) number of points with a weight
    status: NDArray  # (B,) of FitStatus values (str)
    iterations: NDArray  # (B,) 0 for a closed form

    def some(self, rows: slice | NDArray) -> RigidFit:
        """Return some entries."""
        return RigidFit(*(values[rows] for values in self.entries()))

    def entries(self) -> tuple[NDArray, ...]:
        """All fields, in order."""
        return tuple(getattr(self, f.name) for f in fields(self))

    def masked(self) -> RigidFit:
        """Return the fit with NaN in all numbers of entries whose status is not OK."""
        names = ("R", "t", "scale", "covariance", "scale_sigma", "rms")
        return replace(self, **{name: mask_entries(getattr(self, name), self.ok) for name in names})

    @property
    def ok(self) -> NDArray:
        """Mask (B,) of entries with numbers."""
        return self.status == FitStatus.OK

    @property
    def only(self) -> RigidFit:
        """The only entry of a batch of one, without the axis of the batch: R (3, 3), t (3,)."""
        return RigidFit(*(getattr(self, f.name).squeeze(0) for f in fields(self)))

    def apply(self, source: NDArray) -> NDArray:
        """Return points source ((B,) N, 3) in the target frame, ((B,) N, 3) in m."""
        moved = np.asarray(source) @ np.swapaxes(self.R, -1, -2)
        return self.scale[..., None, None] * moved + self.t[..., None, :]

    def residuals(self, source: NDArray, target: NDArray) -> NDArray:
        """Return measured minus fitted points in the source (body) frame, ((B,) N, 3) in m."""
        return (target - self.t[..., None, :]) @ self.R / self.scale[..., None, None] - source


_FAULTS = (FitStatus.TOO_FEW_POINTS, FitStatus.COINCIDENT, FitStatus.COLLINEAR, FitStatus.AMBIGUOUS)
_STATUS = np.array([*map(str, _FAULTS), str(FitStatus.OK)]).dtype


class Motions(NamedTuple):
    """Rotations R (B, 3, 3), translations t (B, 3) in m, scales (B,) and statuses (B,) of fits."""

    R: NDArray
    t: NDArray
    scale: NDArray
    status: NDArray


def join_fits(fits: Sequence[RigidFit]) -> RigidFit:
    """Return the entries of one or more fits as one batch, in their order."""
    return RigidFit(*(np.concatenate(parts) for parts in zip(*(fit.entries() for fit in fits), strict=True)))


def solve_weighted(
    x: NDArray, y: NDArray, w: NDArray, *, with_scale: bool = False, sigma: ArrayLike | None = None
) -> RigidFit:
    """Return the result of `umeyama` for clouds checked by `check_correspondences`."""
    return _assemble(x, y, w, solve_motion(x, y, w, with_scale=with_scale), with_scale, sigma)


def solve_misfit(x: NDArray, y: NDArray, w: NDArray, *, with_scale: bool = False) -> tuple[NDArray, NDArray]:
    """Return rms (B,) in m and scale (B,) of `solve_weighted`, NaN where not OK; its covariances take as long."""
    motions = solve_motion(x, y, w, with_scale=with_scale)
    ok = motions.status == FitStatus.OK
    return mask_entries(_rms(_misfit(x, y, w, motions)[1], w), ok), mask_entries(motions.scale, ok)


def solve_motion(x: NDArray, y: NDArray, w: NDArray, *, with_scale: bool = False) -> Motions:
    """Return R (B, 3, 3), t (B, 3), scale (B,) and status (B,) of `solve_weighted`; meaningless where not OK."""
    total = np.maximum(w.sum(-1), np.finfo(float).tiny)
    centre_x, centre_y = weighted_centroid(x, w, total), weighted_centroid(y, w, total)
    q, p = x - centre_x[:, None], y - centre_y[:, None]
    U, s, Vt = np.linalg.svd(np.swapaxes(w[..., None] * p, -1, -2) @ q)
    handed = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    spread = [weighted_square(cloud, w) for cloud in (q, p)]
    is_one_place = np.logical_or(*map(_coincident, spread, (centre_x, centre_y), (total, total)))
    status = _status(w, is_one_place, s, handed)
    R = (U * np.stack([np.ones_like(handed), np.ones_like(handed), handed], -1)[:, None]) @ Vt
    scale = np.ones(len(R))
    if with_scale:
        scale = (s[:, 0] + s[:, 1] + handed * s[:, 2]) / np.where(spread[0] > 0, spread[0], 1.0)
    t = centre_y - scale[:, None] * np.einsum("bij,bj->bi", R, centre_x)
    return Motions(R, t, scale, status)


def check_correspondences(
    source: ArrayLike, target: ArrayLike, weight: ArrayLike | None
) -> tuple[NDArray, NDArray, NDArray]:
    """Return source, target (B, N, 3) and weight (B, N) as float64, with points of weight 0 set to 0.

    Raises ValueError with the found and the expected shape or value.
    """
    x, y = np.asarray(source, np.float64), np.asarray(target, np.float64)
    for name, cloud in (("source", x), ("target", y)):
        if cloud.ndim not in (2, 3) or cloud.shape[-1] != 3:
            raise ValueError(f"{name}: found shape {cloud.shape}, expected (N, 3) or (B, N, 3)")
    if x.shape[-2] != y.shape[-2]:
        raise ValueError(f"found {x.shape[-2]} source and {y.shape[-2]} target points, expected pairs")
    w = np.ones(x.shape[-2]) if weight is None else np.asarray(weight, np.float64)
    if not np.all(np.isfinite(w)) or np.any(w < 0):
        raise ValueError("weight: found a negative or non-finite value, expected 0 (missing) or more")
    shape = np.broadcast_shapes(x.shape[:-1], y.shape[:-1], w.shape)
    shape = shape if len(shape) == 2 else (1, *shape)
    x, y, w = np.broadcast_to(x, (*shape, 3)), np.broadcast_to(y, (*shape, 3)), np.broadcast_to(w, shape)
    return _masked(x, w, "source"), _masked(y, w, "target"), w


def _masked(cloud: NDArray, w: NDArray, name: str) -> NDArray:
    finite = np.isfinite(cloud).all(-1)
    if not np.all(finite | (w == 0)):
        raise ValueError(f"{name}: found a non-finite point, expected weight 0 for every missing point")
    return cloud if finite.all() else np.where(finite[..., None], cloud, 0.0)


def weighted_centroid(points: NDArray, w: NDArray, total: NDArray) -> NDArray:
    """Return the centroids (B, 3) of points (B, N, 3) for weights w (B, N) of sum total (B,)."""
    return (w[:, None] @ points)[:, 0] / total[:, None]


def weighted_square(points: NDArray, w: NDArray) -> NDArray:
    """Return ``sum w |p|^2`` (B,) of points (B, N, 3) for weights w (B, N)."""
    return (w[:, None] @ np.einsum("bni,bni->bn", points, points)[..., None])[:, 0, 0]


def _status(w: NDArray, is_one_place: NDArray, s: NDArray, handed: NDArray) -> NDArray:
    """Return a status (B,) from weights (B, N), a mask (B,) of coincident clouds, and s (B, 3): singular values of the
    product of centred clouds."""
    gap, on_line = s[:, 1] + handed * s[:, 2], s[:, 1] <= _SINGULAR * s[:, 0]
    conditions = [np.count_nonzero(w, axis=-1) < 3, is_one_place, on_line, gap <= _SINGULAR * s[:, 0]]
    if not np.any(conditions):  # as nearly always; a choice among texts takes as long as the fits of few points
        return np.full(len(w), str(FitStatus.OK), _STATUS)
    return np.select(conditions, [str(c) for c in _FAULTS], str(FitStatus.OK))


def _coincident(spread: NDArray, centre: NDArray, total: NDArray) -> NDArray:
    """Return the mask (B,) of clouds with a spread ``sum w |p - centre|^2`` of rounding of ``sum w |p|^2``."""
    return spread <= _ROUNDING**2 * (spread + total * np.einsum("bi,bi->b", centre, centre))


def _assemble(
    x: NDArray, y: NDArray, w: NDArray, motions: Motions, with_scale: bool, sigma: ArrayLike | None
) -> RigidFit:
    R, t, scale, status = motions
    arm, misfit = _misfit(x, y, w, motions)
    used, ok = np.count_nonzero(w, axis=-1), status == FitStatus.OK
    if sigma is None:
        freedom = np.maximum(3 * used - 6 - with_scale, 1)
        noise = (misfit / freedom)[:, None] / np.where(w > 0, w, 1.0)
    else:
        noise = np.broadcast_to(np.asarray(sigma, np.float64) ** 2, w.shape)
    covariance = weighted_fit_covariance(arm, w, noise, ok, with_scale)
    scale_sigma = scale * np.sqrt(covariance[:, 6, 6]) if with_scale else np.zeros(len(R))
    rms = _rms(misfit, w)
    none = np.zeros(len(R), np.int64)
    return RigidFit(R, t, scale, covariance[:, :6, :6], scale_sigma, rms, used, status, none).masked()


def _misfit(x: NDArray, y: NDArray, w: NDArray, motions: Motions) -> tuple[NDArray, NDArray]:
    """Return turned source points (B, N, 3) and ``sum w |y - x|^2`` (B,) of the residuals."""
    arm = motions.scale[:, None, None] * (x @ np.swapaxes(motions.R, -1, -2))
    return arm, weighted_square(y - arm - motions.t[:, None], w)


def _rms(misfit: NDArray, w: NDArray) -> NDArray:
    return np.asarray(np.sqrt(misfit / np.maximum(w.sum(-1), np.finfo(float).tiny)))


def mask_entries(values: NDArray, ok: NDArray) -> NDArray:
    """Return values (B, ...) with NaN in the entries that are not ok (B,)."""
    return np.where(ok.reshape(-1, *(1,) * (values.ndim - 1)), values, np.nan)
