"""Fits that weigh points as if they were independent: how uncertain they are where points have errors in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stages.common.point_errors import Index
from stages.rigid_poses.body_pose import BodyPoses
from truing.estimation.covariance import fit_gain, survey_frame_covariance, symmetric
from truing.estimation.rigid_poses.correlated import JointMotions
from truing.estimation.rigid_poses.point_errors import PointErrors

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JointFit:
    """The joint fit of the bodies of a pose, by number, to the points in rows (N,) of the observations."""

    bodies: tuple[int, ...]
    row: Index
    motions: JointMotions


def with_other_methods(
    bodies: Sequence[BodyPoses], rows: Sequence[Index], errors: PointErrors, joint: Mapping[int, JointFit]
) -> list[BodyPoses]:
    """The bodies with the covariance of the fits beside their default: a pose is linear in the points' errors, with the
    weights that it has, whatever these errors have in common. rows: per body (B, T) the rows of observations; joint: by
    pose."""
    filled = list(bodies)
    for method in dict.fromkeys(method for body in bodies for method in body.weights):
        gains = [_gain(body, method) for body in bodies]
        cov = [np.full((len(body.fit.t), 6, 6), np.nan) for body in bodies]
        cross = [{other.name: np.full_like(cov[0], np.nan) for other in bodies} for _ in bodies]
        for p in range(len(bodies[0].fit.t)):
            there, row, gain = _stacked(p, method, bodies, rows, gains, joint.get(p))
            if not there:
                continue
            both = gain @ errors.covariance(row) @ gain.T
            for i, b in enumerate(there):
                cov[b][p] = both[6 * i : 6 * i + 6, 6 * i : 6 * i + 6]
                for k, other in enumerate(there):
                    cross[b][bodies[other].name][p] = both[6 * i : 6 * i + 6, 6 * k : 6 * k + 6]
        filled = [_replaced(*one, method) for one in zip(filled, cov, cross, strict=True)]
    return filled


def _gain(body: BodyPoses, method: str) -> Array | None:
    """How the pose follows each point's error, (B, T, 6, 3), with what a robust fit scatters more than its weights say;
    None where the body has no such fit."""
    if method not in body.weights:
        return None
    weight, factor = body.weights[method]
    fit = body.fits[method]
    turn = np.where(fit.ok[:, None, None], fit.R, np.eye(3))
    gain = fit_gain(body.source @ np.swapaxes(turn, -1, -2), weight[..., None, None] * np.eye(3), fit.ok)
    return np.asarray(gain * np.sqrt(np.where(fit.ok, factor, 1.0))[:, None, None, None])


def _stacked(
    p: int,
    method: str,
    bodies: Sequence[BodyPoses],
    rows: Sequence[Index],
    gains: Sequence[Array | None],
    joint: JointFit | None,
) -> tuple[list[int], Index, Array]:
    """The bodies that a pose has by a method, by their default where they lack it; the rows (n,) of its points, and the
    gain (6b, 3n) on these motions."""
    row = np.concatenate([own[p][own[p] >= 0] for own in rows])
    place = {r: n for n, r in enumerate(row.tolist())}
    there, parts = [], []
    for b, body in enumerate(bodies):
        own, of_body = gains[b], np.zeros((6, len(row), 3))
        if own is not None and body.fits[method].ok[p]:
            seen = np.flatnonzero(rows[b][p] >= 0)
            of_body[:, [place[r] for r in rows[b][p, seen].tolist()]] = np.swapaxes(own[p, seen], 0, 1)
        elif own is None and joint is not None and b in joint.bodies:
            first = 6 * joint.bodies.index(b)
            by_joint = joint.motions.gain[first : first + 6].reshape(6, -1, 3)
            of_body[:, [place[r] for r in joint.row.tolist()]] = by_joint
        else:
            continue
        there.append(b)
        parts.append(of_body.reshape(6, -1))
    return there, row, np.concatenate(parts) if parts else np.zeros((0, 3 * len(row)))


def _replaced(body: BodyPoses, measured: Array, cross: Mapping[str, Array], method: str) -> BodyPoses:
    told = {(method, other): found for other, found in cross.items()}
    if method not in body.weights:
        return replace(body, cross={**body.cross, **told})
    weight, factor = body.weights[method]
    fit, exact = body.fits[method], np.zeros((*weight.shape, 3, 3))
    W = weight[..., None, None] * np.eye(3)
    by_survey = survey_frame_covariance(fit.R, body.source, W, body.cov_source, exact, body.frame, fit.ok)
    covariance = symmetric(measured + by_survey * factor[:, None, None])
    covariance = np.where(np.isfinite(covariance), covariance, fit.covariance)
    return replace(body, fits=body.fits | {method: replace(fit, covariance=covariance)}, cross={**body.cross, **told})
