"""Targets on bodies, and the unknown errors of their survey (classes `Targets` and `ShapeUnknowns`).

The frame of base and platform is the least-squares frame of the body's targets that are not on attachments, relative to
their survey; so the survey errors of these targets have no rigid part. The attachments, surveyed in the same frame,
carry the rigid part instead.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import rigid_motions

BASE, PLATFORM, LEG = 0, 1, 2
# Standard deviation of unknowns without prior knowledge: too wide to bias them, narrow enough for good scaling.
FREE_LENGTH_M, FREE_ANGLE_RAD, FREE_DIRECTION = 0.01, 0.1, 0.05


@dataclass(frozen=True)
class Targets:
    """K targets: the kind of body that carries each, and its leg (counted from 0).

    ``leg`` is the leg that carries a LEG target, or the attachment of a PLATFORM target; -1 for none. ``names`` and
    ``bodies`` are those of the tables, if given.
    """

    body: NDArray  # (K,) of BASE, PLATFORM, LEG
    leg: NDArray  # (K,) int
    names: tuple[str, ...] = ()
    bodies: tuple[str, ...] = ()

    @property
    def at_attachment(self) -> NDArray:
        """Mask (K,) of the targets on attachments."""
        return (self.body == PLATFORM) & (self.leg >= 0)


@dataclass(frozen=True)
class ShapeUnknowns:
    """Unknown shape of K targets: deviation from the survey = modes @ w, w ~ N(0, 1), except targets on attachments.

    ``modes`` (K, 3, W) in m; ``attachment_factor`` (3A, 3A) in m is a square root of the covariance of the surveyed
    positions of the A targets on attachments, in their order.
    """

    modes: NDArray
    attachment_factor: NDArray


def shape_unknowns(targets: Targets, survey: NDArray, covariance: NDArray) -> ShapeUnknowns:
    """Return the unknowns of a survey (K, 3) in m with covariance (K, 3, 3) in m^2."""
    seats = np.flatnonzero(targets.at_attachment)
    free = [np.flatnonzero((targets.body == body) & ~targets.at_attachment) for body in np.unique(targets.body)]
    blocks = [
        (group, _free_factor(survey, covariance, group, rigid=targets.body[group[0]] != LEG))
        for group in free
        if len(group)
    ]
    modes = np.zeros((len(survey), 3, sum(factor.shape[1] for _, factor in blocks)))
    first = 0
    for rows, factor in blocks:
        modes[rows, :, first : first + factor.shape[1]] = factor.reshape(len(rows), 3, -1)
        first += factor.shape[1]
    framing = np.flatnonzero((targets.body == targets.body[seats[0]]) & ~targets.at_attachment) if len(seats) else seats
    return ShapeUnknowns(modes, _attachment_factor(survey, covariance, seats, framing))


def _free_factor(survey: NDArray, covariance: NDArray, rows: NDArray, rigid: bool) -> NDArray:
    """Return a square root (3n, W) of the covariance of a body's shape; without its rigid part if ``rigid``."""
    full = _block_diagonal(covariance[rows])
    if not rigid or len(rows) < 3:
        return np.linalg.cholesky(full)
    motions = np.linalg.qr(_rigid_motions(survey[rows]))[0]
    residual = np.eye(len(full)) - motions @ motions.T
    values, vectors = np.linalg.eigh(residual @ full @ residual)
    return vectors[:, 6:] * np.sqrt(np.maximum(values[6:], 0.0))


def _attachment_factor(survey: NDArray, covariance: NDArray, seats: NDArray, framing: NDArray) -> NDArray:
    full = _block_diagonal(covariance[seats])
    if len(framing) >= 3 and len(seats):
        fit = np.linalg.pinv(_rigid_motions(survey[framing]))
        lever = _rigid_motions(survey[seats]) @ fit
        full = full + lever @ _block_diagonal(covariance[framing]) @ lever.T
    return np.linalg.cholesky(full)


def _rigid_motions(points: NDArray) -> NDArray:
    """Return the displacements (3n, 6) of points (n, 3) per small rigid motion, translations first."""
    return rigid_motions(points).reshape(3 * len(points), 6)


def _block_diagonal(blocks: NDArray) -> NDArray:
    """Return the matrix (3n, 3n) with blocks (n, 3, 3) on its diagonal."""
    full = np.zeros((len(blocks), 3, len(blocks), 3))
    full[np.arange(len(blocks)), :, np.arange(len(blocks))] = blocks
    return full.reshape(3 * len(blocks), 3 * len(blocks))
