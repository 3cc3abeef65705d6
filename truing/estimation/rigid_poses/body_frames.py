"""Frames of bodies: what their fit does to residuals seen in them."""

from __future__ import annotations

import numpy as np

from truing.arrays import Array, Mask
from truing.estimation.rotation import rigid_motions

_FEWEST = 3


def frame_covariance(points: Array, noise: Array, used: Mask) -> Array:
    """(B, 6, 6) covariance of a frame (p, theta; body axes) fitted to the used targets.

    points (T, 3) in the body frame; noise (B, T, 3, 3) per target in body axes; used (B, T). Directions that the
    used targets leave free (fewer than three, or in line) come out as zero, not as infinite: check the fit's
    status first.
    """
    lever = rigid_motions(points)
    weight = _inverse(noise) * used[:, :, None, None]
    information = np.einsum("tia,btij,tjc->bac", lever, weight, lever, optimize=True)
    return np.linalg.pinv(information, rcond=1e-12, hermitian=True)


def residual_covariance(points: Array, noise: Array, used: Mask, seen: Mask) -> Array:
    """(B, 3T, 3T) covariance of the residuals of all targets, those used for the frame and those judged in it.

    points (T, 3), noise (B, T, 3, 3) in body axes, used and seen (B, T). A residual is ``e_a - J_a delta``
    with delta the frame's error; where a target was used its own error is in delta too, which takes out of the
    residuals what the frame swallowed. Rows of targets not seen are zero.
    """
    batch, count = used.shape
    lever = rigid_motions(points)
    frame = frame_covariance(points, noise, used)
    swallowed = np.einsum("tia,bac,sjc->btisj", lever, frame, lever, optimize=True)
    sign = 1.0 - used[:, :, None].astype(float) - used[:, None, :]
    covariance = swallowed * sign[:, :, None, :, None]
    index = np.arange(count)
    covariance[:, index, :, index, :] += np.moveaxis(noise, 1, 0)
    both = seen[:, :, None] & seen[:, None, :]
    return (covariance * both[:, :, None, :, None]).reshape(batch, 3 * count, 3 * count)


def redundancy(points: Array, used: Mask) -> Array:
    """(B, T, 3) share of each coordinate's own error that a fit to the used targets (B, T), equally weighted,
    leaves in its residual (Baarda's redundancy number); zero where not used. Sums to 3 n - 6 per entry of the batch.
    """
    lever = rigid_motions(points)
    information = np.einsum("tia,bt,tic->bac", lever, used.astype(float), lever, optimize=True)
    frame = np.linalg.pinv(information, rcond=1e-12, hermitian=True)
    return (1.0 - np.einsum("tia,bac,tic->bti", lever, frame, lever, optimize=True)) * used[:, :, None]


def _inverse(noise: Array) -> Array:
    """(..., 3, 3) inverses; zero where a target was not seen and its covariance is zero."""
    seen = np.einsum("...ii->...", noise) > 0.0
    safe = np.where(seen[..., None, None], noise, np.eye(3))
    return np.linalg.inv(safe) * seen[..., None, None]
