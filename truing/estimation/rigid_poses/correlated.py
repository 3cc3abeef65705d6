"""The motions of several bodies at once from points whose errors are correlated, within a body and between bodies.

Generalised least squares with ``S = cov_target + R cov_source R'`` of all points together. Where the points lie in a
frame of their own (a free network), cov_target is singular along common motions of all points, and depends on the
choice of that frame by terms ``J A + A' J'`` with J the motions of the bodies. Both leave the relative motions of
bodies as they are: ``J K J'`` added to S changes no estimate (Rao and Mitra, Generalized Inverse of Matrices, 1971).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from truing.estimation.covariance import apply_rotation, fit_gain, symmetric
from truing.estimation.rotation import exp_so3, skew

_MOST_STEPS = 30
# Squared length of the last step in units of its own covariance.
_SETTLED = 1e-12
# Share of a point's own weight that has to be controlled by others for a test of it.
_CONTROLLED = 1e-6
# Share of the mean variance below which nothing is known.
_EXACT = 1e-10


@dataclass(frozen=True)
class PointsOfBodies:
    """All points of a pose that are used: source and target (N, 3) in m, body (N,) by number, cov_source (N, 3, 3) in
    the bodies' frames, cov_target (3N, 3N) of all together, in m^2."""

    source: NDArray
    target: NDArray
    body: NDArray
    cov_source: NDArray
    cov_target: NDArray

    def without(self, row: int) -> PointsOfBodies:
        """The same without one of the points."""
        keep = np.arange(len(self.source)) != row
        place = np.repeat(keep, 3)
        cov_target = self.cov_target[np.ix_(place, place)]
        return PointsOfBodies(self.source[keep], self.target[keep], self.body[keep], self.cov_source[keep], cov_target)


@dataclass(frozen=True)
class JointMotions:
    """Motions R (B, 3, 3) and t (B, 3) of B bodies; gain (6B, 3N): how the error of each point moves (t, theta) of each
    body, R <- exp(theta) R; tests (N,): squared standardised size of each point's gross error, chi-square with 3
    degrees without one, NaN where the others do not control it; converged."""

    R: NDArray
    t: NDArray
    gain: NDArray
    tests: NDArray
    converged: bool

    def covariance(self, cov_target: NDArray) -> NDArray:
        """What errors of the points with covariance (3N, 3N) leave in the motions together, (6B, 6B).

        Nothing where the points' own frame is what the motions are told in; rounding is no variance below zero there.
        """
        found = symmetric(self.gain @ cov_target @ self.gain.T)
        values, vectors = np.linalg.eigh(found)
        return found if values[0] >= 0.0 else symmetric((vectors * np.maximum(values, 0.0)) @ vectors.T)


def joint_motions(points: PointsOfBodies, R: NDArray, t: NDArray) -> JointMotions:
    """Return the motions of the bodies of a pose from starts R (B, 3, 3), t (B, 3); three points or more of each.

    The starts, not converged, where the points leave more than motions open: their common scale.
    """
    R, t = R.copy(), t.copy()
    each = points.body
    converged = False
    start = JointMotions(
        R.copy(), t.copy(), np.zeros((6 * len(R), points.target.size)), np.full(len(each), np.nan), False
    )
    for _ in range(_MOST_STEPS):
        turned = R[each] @ points.cov_source @ np.swapaxes(R[each], -1, -2)
        arm = apply_rotation(R[each], points.source)
        r = points.target - arm - t[each]
        J = _motions(arm, each, len(R))
        try:
            factor = _factor(points.cov_target, turned, J)
        except LinAlgError:
            return start
        force = cho_solve(factor, r.ravel()).reshape(-1, 3)
        J = _motions(arm + apply_rotation(turned, force), each, len(R))
        weighted = cho_solve(factor, J)
        normal = symmetric(J.T @ weighted)
        step = np.linalg.solve(normal, J.T @ force.ravel())
        t += step.reshape(-1, 6)[:, :3]
        R = exp_so3(step.reshape(-1, 6)[:, 3:]) @ R
        converged = bool(step @ normal @ step < _SETTLED)
        if converged:
            break
    gain = np.linalg.solve(normal, weighted.T)
    return JointMotions(R, t, gain, _tests(factor, weighted, gain, r), converged)


def _motions(arm: NDArray, body: NDArray, bodies: int) -> NDArray:
    """Return how points move with their bodies: (3N, 6B)."""
    J = np.zeros((len(arm), 3, bodies, 6))
    rows = np.arange(len(arm))
    J[rows, :, body, :3] = np.eye(3)
    J[rows, :, body, 3:] = -skew(arm)
    return J.reshape(3 * len(arm), 6 * bodies)


def _factor(cov_target: NDArray, turned: NDArray, J: NDArray) -> tuple[NDArray, bool]:
    """Return the Cholesky factor of S + J K J', K of the size that makes both alike."""
    count = len(turned)
    S = symmetric(cov_target)
    rows = np.arange(count)
    blocks = S.reshape(count, 3, count, 3)
    blocks[rows, :, rows, :] += turned
    size = np.einsum("ij,ij->j", J, J) / count
    variance = np.trace(S) / (3 * count)
    # What else is exact, as the size of points without scale, has to leave the matrix regular.
    S[np.diag_indices(3 * count)] += _EXACT * variance
    return cho_factor(S + (J * (variance / size)) @ J.T, lower=True)


def _tests(factor: tuple[NDArray, bool], weighted: NDArray, gain: NDArray, r: NDArray) -> NDArray:
    """Return Baarda's test (N,) of a gross error in each point, three coordinates at once."""
    count = len(r)
    W = cho_solve(factor, np.eye(3 * count))
    Q = symmetric(W - weighted @ gain).reshape(count, 3, count, 3)
    rows = np.arange(count)
    own, whole = Q[rows, :, rows, :], W.reshape(count, 3, count, 3)[rows, :, rows, :]
    force = np.einsum("nikj,kj->ni", Q, r)
    controlled = np.linalg.eigvalsh(own)[:, 0] > _CONTROLLED * np.linalg.eigvalsh(whole)[:, 0]
    safe = np.where(controlled[:, None, None], own, np.eye(3))
    value = np.einsum("ni,ni->n", force, np.linalg.solve(safe, force[..., None])[..., 0])
    return np.where(controlled, value, np.nan)


def survey_part(
    source: NDArray, cov_source: NDArray, body: NDArray, frame: NDArray, gain: NDArray, R: NDArray
) -> NDArray:
    """Return what the survey's errors leave in the motions (6B, 6B); cov_source (N, 3, 3), the rest as `by_survey`."""
    moved = by_survey(source, body, frame, gain, R)
    return symmetric(np.einsum("pni,nij,qnj->pq", moved, cov_source, moved, optimize=True))


def by_survey(source: NDArray, body: NDArray, frame: NDArray, gain: NDArray, R: NDArray) -> NDArray:
    """Return how the motions follow the survey's errors, (6B, N, 3), their frames being those that the survey defines.

    As `survey_frame_covariance`: source (N, 3) of all surveyed points of all bodies, body (N,) by number, frame (N,)
    those that make the frames; gain (6B, 3N), zero where a point was not used.
    """
    own = np.zeros((len(R), 6, len(source), 3))
    for number, turn in enumerate(R):
        rows = np.flatnonzero(body == number)
        weights = frame[rows, None, None] * np.eye(3)
        within = fit_gain(source[rows][None], weights[None], np.ones(1, bool))[0]
        both = np.zeros((6, 6))
        both[:3, :3] = both[3:, 3:] = turn
        own[number][:, rows] = np.swapaxes(both @ within, 0, 1)
    used = gain.reshape(6 * len(R), len(source), 3)
    return np.asarray(own.reshape(6 * len(R), len(source), 3) - np.einsum("pni,nij->pnj", used, R[body]))
