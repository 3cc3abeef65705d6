"""Covariance and redundancy of residuals in a body frame that was fitted to some of the same targets."""

from __future__ import annotations

import numpy as np

from truing.arrays import Array, Mask
from truing.estimation.rotation import rigid_motions


def frame_covariance(points: Array, noise: Array, used: Mask) -> Array:
    """Return the covariance (B, 6, 6) of a frame (p, theta; body axes) fitted to the used targets.

    points (T, 3) in the body frame; noise (B, T, 3, 3) per target in body axes; used (B, T). Undetermined directions
    (fewer than three used targets, or all on one line) are zero, not infinite: check the fit's status first.
    """
    lever = rigid_motions(points)
    weight = _inverse_of_seen(noise) * used[:, :, None, None]
    information = np.einsum("tia,btij,tjc->bac", lever, weight, lever, optimize=True)
    return np.linalg.pinv(information, rcond=1e-12, hermitian=True)


def residual_covariance(points: Array, noise: Array, used: Mask, is_observed: Mask) -> Array:
    """Return the covariance (B, 3T, 3T) of the residuals of all targets, both used and not used for the frame.

    points (T, 3), noise (B, T, 3, 3) in body axes, used and is_observed (B, T). A residual is ``e_a - J_a delta``
    with delta the frame's error; delta contains the errors of used targets, which reduces their residuals. Rows of
    targets not seen are zero.
    """
    batch, count = used.shape
    lever = rigid_motions(points)
    frame = frame_covariance(points, noise, used)
    frame_part = np.einsum("tia,bac,sjc->btisj", lever, frame, lever, optimize=True)
    sign = 1.0 - used[:, :, None].astype(float) - used[:, None, :]
    covariance = frame_part * sign[:, :, None, :, None]
    index = np.arange(count)
    covariance[:, index, :, index, :] += np.moveaxis(noise, 1, 0)
    both = is_observed[:, :, None] & is_observed[:, None, :]
    return (covariance * both[:, :, None, :, None]).reshape(batch, 3 * count, 3 * count)


def redundancy(points: Array, used: Mask) -> Array:
    """Return the redundancy numbers (B, T, 3) (Baarda) of a fit to the used targets (B, T) with equal weights; zero if
    not used.

    A redundancy number is the share of a coordinate's own error in its residual. They sum to 3 n - 6 per batch entry.
    """
    lever = rigid_motions(points)
    information = np.einsum("tia,bt,tic->bac", lever, used.astype(float), lever, optimize=True)
    frame = np.linalg.pinv(information, rcond=1e-12, hermitian=True)
    return (1.0 - np.einsum("tia,bac,tic->bti", lever, frame, lever, optimize=True)) * used[:, :, None]


def _inverse_of_seen(noise: Array) -> Array:
    """Return the inverses (..., 3, 3); zero for unseen targets with zero covariance."""
    is_observed = np.einsum("...ii->...", noise) > 0.0
    safe = np.where(is_observed[..., None, None], noise, np.eye(3))
    return np.linalg.inv(safe) * is_observed[..., None, None]
