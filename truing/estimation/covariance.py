"""Covariances of rigid motions: of a weighted fit, and through composition and inversion.

Order (p, theta) with ``R <- exp(theta) R`` and ``p <- p + dp`` in the parent frame; m and rad; batches lead.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import rigid_motions, skew

_POSES_AT_ONCE = 5000  # keeps intermediate matrices small


def weighted_fit_covariance(arm: NDArray, w: NDArray, noise: NDArray, ok: NDArray, with_scale: bool = False) -> NDArray:
    """Return the covariance (B, 6, 6) of a weighted rigid fit, or (B, 7, 7) with relative scale last.

    arm (B, N, 3), in m: points from the source origin, in target axes; w (B, N): weights of the fit; noise (B, N), in
    m^2: variance per coordinate. ``A^-1 B A^-1`` with A the normal matrix and B that of the weighted noise; equals
    ``A^-1`` if w = 1/noise. The result is meaningless for entries not ok (B,).
    """
    total = np.maximum(w.sum(-1), np.finfo(float).tiny)
    centre = (w[:, None] @ arm)[:, 0] / total[:, None]
    a = arm - centre[:, None]
    size = 7 if with_scale else 6
    normal = np.where(ok[:, None, None], _moments(a, w)[:, :size, :size], np.eye(size))
    inverse = np.linalg.inv(normal)
    about_centre = inverse @ _moments(a, w * w * noise)[:, :size, :size] @ inverse
    G = np.zeros((len(a), size, size)) + np.eye(size)
    G[:, :3, 3:6] = skew(centre)
    if with_scale:
        G[:, :3, 6] = -centre
    return symmetric(G @ about_centre @ np.swapaxes(G, -1, -2))


def survey_frame_covariance(
    R: NDArray,
    source: NDArray,
    W: NDArray,
    cov_source: NDArray,
    cov_target: NDArray,
    reference: NDArray,
    ok: NDArray,
) -> NDArray:
    """Return the covariance (B, 6, 6) of poses of the frame that the survey defines.

    That frame is the unweighted least-squares frame of the body's ``reference`` targets (N,) relative to their survey
    ``source`` (N, 3): rigid motions in the survey's noise (N, 3, 3) move the frame and are no error of it. R (B, 3, 3);
    W (B, N, 3, 3): weight matrices of the fit, zero for unused targets; cov_target (B, N, 3, 3). The result is
    meaningless for entries not ok (B,).
    """
    reference_gain = fit_gain(source[None], (reference[:, None, None] * np.eye(3))[None], np.any(ok, keepdims=True))[0]
    out = np.empty((len(R), 6, 6))
    for first in range(0, len(R), _POSES_AT_ONCE):
        b = slice(first, first + _POSES_AT_ONCE)
        turn = np.where(ok[b, None, None], R[b], np.eye(3))
        gain = fit_gain(source @ np.swapaxes(turn, -1, -2), W[b], ok[b])
        by_survey = _blocks(turn, np.zeros((3, 3)), turn)[:, None] @ reference_gain - gain @ turn[:, None]
        used = np.any(W[b] != 0, axis=(-1, -2))
        measured = np.where(used[..., None, None], cov_target[b], 0.0)
        out[b] = _side_by_side(gain @ measured) @ np.swapaxes(_side_by_side(gain), -1, -2)
        out[b] += _side_by_side(by_survey @ cov_source) @ np.swapaxes(_side_by_side(by_survey), -1, -2)
    return symmetric(out)


def _side_by_side(matrices: NDArray) -> NDArray:
    """Return the matrices (B, N, 6, 3) of all points next to each other, (B, 6, 3N)."""
    return np.swapaxes(matrices, 1, 2).reshape(len(matrices), matrices.shape[2], -1)


def fit_gain(arm: NDArray, W: NDArray, ok: NDArray) -> NDArray:
    """Return the derivative (B, N, 6, 3) of the fitted pose by each point's error, ``(sum J' W J)^-1 J' W``."""
    J = rigid_motions(arm)
    JW = np.swapaxes(J, -1, -2) @ W
    normal = np.where(ok[:, None, None], np.sum(JW @ J, axis=1), np.eye(6))
    return np.linalg.inv(normal)[:, None] @ JW


def _moments(a: NDArray, v: NDArray) -> NDArray:
    """Return ``sum v J' J`` (B, 7, 7) of J = [I, -[a]x, a]: position, rotation, relative scale."""
    first = (v[:, None] @ a)[:, 0]
    second = np.swapaxes(v[..., None] * a, -1, -2) @ a
    trace = np.trace(second, axis1=-2, axis2=-1)
    out = np.zeros((len(a), 7, 7))
    out[:, :3, :3] = v.sum(-1)[:, None, None] * np.eye(3)
    out[:, 3:6, :3] = skew(first)
    out[:, :3, 3:6] = -out[:, 3:6, :3]
    out[:, 3:6, 3:6] = trace[:, None, None] * np.eye(3) - second
    out[:, :3, 6] = out[:, 6, :3] = first
    out[:, 6, 6] = trace
    return out


def compose(
    R_ab: NDArray, p_ab: NDArray, cov_ab: NDArray, R_bc: NDArray, p_bc: NDArray, cov_bc: NDArray
) -> tuple[NDArray, NDArray, NDArray]:
    """Return ``T_ab T_bc`` as R (..., 3, 3), p (..., 3) and covariance (..., 6, 6) of independent factors."""
    lever = apply_rotation(R_ab, p_bc)
    J_ab = _blocks(np.eye(3), -skew(lever), np.eye(3))
    J_bc = _blocks(R_ab, np.zeros((3, 3)), R_ab)
    return R_ab @ R_bc, p_ab + lever, symmetric(propagated(J_ab, cov_ab) + propagated(J_bc, cov_bc))


def invert(R: NDArray, p: NDArray, cov: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Return ``T^-1`` as R (..., 3, 3), p (..., 3) and covariance (..., 6, 6)."""
    Rt = np.swapaxes(R, -1, -2)
    J = _blocks(-Rt, -Rt @ skew(p), -Rt)
    return Rt, -apply_rotation(Rt, p), symmetric(propagated(J, cov))


def relative(
    R_wa: NDArray, p_wa: NDArray, cov_wa: NDArray, R_wb: NDArray, p_wb: NDArray, cov_wb: NDArray
) -> tuple[NDArray, NDArray, NDArray]:
    """Return ``T_wa^-1 T_wb``, the pose of b relative to a, with its covariance; a and b independent."""
    return compose(*invert(R_wa, p_wa, cov_wa), R_wb, p_wb, cov_wb)


def relative_of_pair(
    R_wa: NDArray, p_wa: NDArray, R_wb: NDArray, p_wb: NDArray, cov: NDArray
) -> tuple[NDArray, NDArray, NDArray]:
    """Return ``T_wa^-1 T_wb`` as `relative`, with the joint covariance cov (..., 12, 12) of a and b."""
    R, p, _ = relative(R_wa, p_wa, cov[..., :6, :6], R_wb, p_wb, cov[..., 6:, 6:])
    J = relative_slope(R_wa, p_wa, p_wb)
    return R, p, symmetric(propagated(J, cov))


def relative_slope(R_wa: NDArray, p_wa: NDArray, p_wb: NDArray) -> NDArray:
    """Return the derivative (..., 6, 12) of the pose of b relative to a by the errors of a and b."""
    Rt = np.swapaxes(R_wa, -1, -2)
    zero = np.zeros((3, 3))
    by_a = _blocks(-Rt, Rt @ skew(p_wb - p_wa), -Rt)
    return np.concatenate([by_a, _blocks(Rt, zero, Rt)], axis=-1)


def shared_parent_covariance(R_wa: NDArray, p_wa: NDArray, cov_wa: NDArray, p_a: NDArray) -> NDArray:
    """Return the joint covariance of K bodies relative to a due to the error of the pose of a, R_wa, p_wa, cov_wa (...,
    6, 6).

    p_a (..., K, 3): positions of the bodies in a. The result (..., 6K, 6K), body by body, is the common part of their
    poses' covariance, and the only covariance between different bodies.
    """
    _, p_aw, cov_aw = invert(R_wa, p_wa, cov_wa)
    lever = p_a - p_aw[..., None, :]
    J = _blocks(np.eye(3), -skew(lever), np.eye(3))
    J = J.reshape(*J.shape[:-3], -1, 6)
    return symmetric(propagated(J, cov_aw))


def in_inner_constraints(xyz: NDArray, cov: NDArray, *, with_scale: bool) -> NDArray:
    """Return the covariance (3n, 3n) of points (n, 3) in inner constraints, by Baarda's S-transformation.

    It contains no common motion of all points, and no common scale if ``with_scale``.
    """
    x = xyz - xyz.mean(axis=0)
    parts = [np.tile(np.eye(3), (len(x), 1)), -skew(x).reshape(-1, 3)]
    G = np.concatenate([*parts, *([x.reshape(-1, 1)] if with_scale else [])], axis=1)
    S = np.eye(len(cov)) - G @ np.linalg.solve(G.T @ G, G.T)
    return np.asarray(S @ cov @ S.T)


def apply_rotation(R: NDArray, v: NDArray) -> NDArray:
    """Return ``R v`` (..., 3)."""
    return np.einsum("...ij,...j->...i", R, v)


def extreme_variances(C: NDArray) -> tuple[NDArray, NDArray]:
    """Return the smallest and the largest eigenvalue (...) of symmetric matrices (..., 3, 3)."""
    if not any(np.any(C[..., i, j]) for i, j in ((0, 1), (0, 2), (1, 2), (1, 0), (2, 0), (2, 1))):
        diagonal = [C[..., i, i] for i in range(3)]
        return np.minimum(np.minimum(diagonal[0], diagonal[1]), diagonal[2]), np.maximum(
            np.maximum(diagonal[0], diagonal[1]), diagonal[2]
        )
    eigenvalues = np.linalg.eigvalsh(C)
    return eigenvalues[..., 0], eigenvalues[..., 2]


def symmetric(C: NDArray) -> NDArray:
    """Return the symmetric part (..., n, n), to remove rounding."""
    return (C + np.swapaxes(C, -1, -2)) / 2


def propagated(J: NDArray, C: NDArray) -> NDArray:
    """Covariance J C J^T (..., m, m) of J x by the covariance C (..., n, n) of x, J (..., m, n)."""
    return J @ C @ np.swapaxes(J, -1, -2)


def _blocks(pp: NDArray, ptheta: NDArray, thetatheta: NDArray) -> NDArray:
    shape = np.broadcast_shapes(pp.shape, ptheta.shape, thetatheta.shape)
    J = np.zeros((*shape[:-2], 6, 6))
    J[..., :3, :3], J[..., :3, 3:], J[..., 3:, 3:] = pp, ptheta, thetatheta
    return J
