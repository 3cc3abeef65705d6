"""One image from points with coordinates: consensus over samples of four, then least squares with bounded influence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.estimation.bundle.intersection import Mask
from truing.estimation.bundle.network import Array
from truing.estimation.rotation import exp_so3, skew

FEWEST = 4  # three fix the six unknowns up to four solutions, the fourth says which
_SAMPLES = 300
_STEPS = 8


@dataclass(frozen=True)
class Resection:
    """Orientation of an image: R (3, 3) camera axes into measurement axes, centre (3,), which points agree (n,), and
    the root mean square of their misses in ideal pixels."""

    R: Array
    centre: Array
    agrees: Mask
    rms_px: float


def resect(direction: Array, X: Array, scale_px: float, tolerance_px: float) -> Resection | None:
    """Return the orientation of the image that sees points X (n, 3) at X/Z, Y/Z (n, 2), or None where too few agree.

    scale_px is the principal distance, to which the tolerance relates.
    """
    import cv2

    if len(X) < FEWEST:
        return None
    origin, size = np.median(X, axis=0), max(float(np.abs(X - np.median(X, axis=0)).max()), 1e-12)
    local = np.ascontiguousarray((X - origin) / size)
    image = np.ascontiguousarray(direction)
    limit = tolerance_px / scale_px
    try:
        found, turn, shift, chosen = cv2.solvePnPRansac(
            local, image, np.eye(3), None,
            iterationsCount=_SAMPLES, reprojectionError=limit, confidence=0.9999, flags=cv2.SOLVEPNP_AP3P,
        )  # fmt: skip
    except cv2.error:
        return None
    if not found or chosen is None or len(chosen) < FEWEST:
        return None
    best = _settled(cv2.Rodrigues(turn)[0].T, shift.ravel(), image, local, limit)
    members = np.ravel(chosen)
    if len(members) > FEWEST:
        for turn, shift in _of_all(local[members], image[members]):
            other = _settled(cv2.Rodrigues(turn)[0].T, shift.ravel(), image, local, limit)
            best = other if _better(other, best) else best
    R, t, off, depth = best
    agrees = (depth > 0) & (off < limit)
    if agrees.sum() < FEWEST:
        return None
    rms = float(np.sqrt(np.mean(off[agrees] ** 2)) * scale_px)
    return Resection(R, origin - R @ t * size, agrees, rms)


def _of_all(X: Array, direction: Array) -> list[tuple[Array, Array]]:
    """Orientations from all points at once, as rotation vector and shift; none where the points do not determine one,
    which the library takes for a fault."""
    import cv2

    try:
        found, turns, shifts, _ = cv2.solvePnPGeneric(X, direction, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
    except cv2.error:
        return []
    return list(zip(turns, shifts, strict=True)) if found else []


def _better(one: tuple[Array, Array, Array, Array], other: tuple[Array, Array, Array, Array]) -> bool:
    """Whether one orientation's bounded misses add up to less."""
    return bool(_bounded(one) < _bounded(other))


def _bounded(found: tuple[Array, Array, Array, Array]) -> float:
    off, depth = found[2], found[3]
    middle = np.median(off)
    return float(np.where(depth > 0, np.minimum(off, 3 * middle + 1e-12), 1e3).sum())


def _settled(R: Array, t: Array, direction: Array, X: Array, limit: float) -> tuple[Array, Array, Array, Array]:
    """Gauss-Newton on the points that agree, misses beyond the limit without weight: R, t with u = R^T X + t, the
    misses (n,) and depths (n,)."""
    for step in range(_STEPS + 1):
        u = X @ R + t
        with np.errstate(all="ignore"):
            a = u[:, :2] / u[:, 2:]
            off = np.nan_to_num(np.linalg.norm(a - direction, axis=1), nan=1e3, posinf=1e3)
        if step == _STEPS:
            break
        w = ((off < limit) & (u[:, 2] > 0)).astype(float)
        if w.sum() < 3:
            break
        P = np.zeros((len(X), 2, 3))
        with np.errstate(all="ignore"):
            P[:, 0, 0] = P[:, 1, 1] = 1 / u[:, 2]
            P[:, :, 2] = -a / u[:, 2:]
        P[w == 0] = 0.0
        J = np.concatenate([P, -P @ skew(u - t)], axis=2)
        N = np.einsum("nki,nkj->ij", J, J)
        step_ = np.linalg.lstsq(
            N, np.einsum("nki,nk->i", J, np.where(w[:, None] > 0, direction - a, 0.0)), rcond=1e-12
        )[0]
        t = t + step_[:3]
        R = R @ exp_so3(step_[3:]).T
    return R, t, off, u[:, 2]
