"""Bodies that should stand still before the instrument: where, whether they are seen to, how much they jitter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3, log_so3, rigid_motions
from truing.schemas.covariates import stand_in

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.stages.diagnosis.body_targets import BodyTargets

Array = NDArray[np.float64]

# From one pose to the next, half of the time, a body that stands still moves by less than so many standard deviations
# of a point: an instrument's own jitter is of that order. A frame of its own in every pose makes it jump by metres.
_STEP = 30.0
_FEWEST = 8
# So many steps between poses at the same place tell how much a body jitters, whatever else happens to it.
_ENOUGH_STEPS = 30
# Jitter is taken to be alike in all directions as surely as so many steps would show it: a covariance from few steps
# fits them too well, and everything else looks significant.
_ALIKE = 100.0
_NORMAL = 1.4826  # standard deviation over median absolute deviation
_TAIL = 3.0  # standardised steps count no more than this
_LEAST = 0.3  # of the points' noise: a smaller jitter is of no account


@dataclass(frozen=True)
class Standing:
    """How a body stands: the number of its places, which of them each pose has (B,), a root of its jitter (6, 6).

    No place where it need not stand still. ``R``, ``t`` (B, ..) are where it stands, as a start, m.
    """

    levels: int
    level: NDArray[np.int64]
    jitter: Array
    R: Array
    t: Array


def standing(body: BodyTargets, settings: Campaign, covariates: Mapping[str, Array]) -> Standing:
    """Return how a body stands: still where it is the reference and hardly moves, or where campaign.toml says so.

    A body that campaign.toml names stands still where the drives do: in one place for every combination of them.
    """
    order = covariates["order"]
    none = np.zeros(len(order), np.int64)
    named = body.name in settings.bodies.still
    if (named or body.name == settings.reference_body) and frame_is_common(body, order):
        return _standing(body, none, order)
    drives = [covariates[d] for d in map(stand_in, settings.campaign.drives) if d in covariates]
    if named and drives:
        level = np.unique(np.column_stack(drives), axis=0, return_inverse=True)[1].ravel()
        if 2 * (level.max() + 1) <= len(level) + 1:  # most places are seen twice: else nothing can be compared
            return _standing(body, level, order)
    return Standing(0, none, np.eye(6), body.R, body.t)


def frame_is_common(body: BodyTargets, order: Array) -> bool:
    """Whether a body hardly moves from one pose to the next: the measurement then has one frame for the campaign."""
    in_time = np.argsort(order, kind="stable")
    points, seen = body.points[in_time], (body.seen & body.ok[:, None])[in_time]
    both = seen[1:] & seen[:-1]
    if both.sum() < _FEWEST:
        return False
    steps = np.linalg.norm(np.diff(points, axis=0), axis=-1)[both]
    return bool(np.median(steps) < _STEP * body.sigma)


def _standing(body: BodyTargets, level: NDArray[np.int64], order: Array) -> Standing:
    """Stand at the middle of what was found at each place."""
    R, t, middle = body.R.copy(), body.t.copy(), body.shape.mean(0)
    centre = body.t + body.R @ middle
    for place in range(level.max() + 1):
        own = level == place
        known = own & body.ok
        if known.any():
            first = body.R[known][0]
            R[own] = exp_so3(np.median(log_so3(body.R[known] @ first.T), axis=0)) @ first
            t[own] = np.median(centre[known], axis=0) - R[own] @ middle
    return Standing(int(level.max()) + 1, level, _jitter(body, level, order), R, t)


def _jitter(body: BodyTargets, level: NDArray[np.int64], order: Array) -> Array:
    """A square root (6, 6) of the covariance of a body's pose from one pose to the next, beyond its targets' noise.

    Shift of the targets' middle (m), then rotation vector (rad), in the axes of the measurement. Robust.
    """
    steps = _steps(body, level, order)
    if len(steps) < _ENOUGH_STEPS:
        return _root(np.zeros((6, 6)), body)
    scale = _NORMAL * np.median(np.abs(steps), axis=0)
    clipped = np.clip(steps / np.maximum(scale, 1e-12), -_TAIL, _TAIL)
    own = np.corrcoef(clipped, rowvar=False) * np.outer(scale, scale)
    alike = np.diag(np.repeat([np.mean(scale[:3] ** 2), np.mean(scale[3:] ** 2)], 3))
    share = len(steps) / (len(steps) + _ALIKE)
    return _root(share * own + (1.0 - share) * alike - _of_noise(body), body)


def _steps(body: BodyTargets, level: NDArray[np.int64], order: Array) -> Array:
    """Steps (n, 6) of the pose between poses at the same place, one after the other in time, over the root of two."""
    centre, found = body.t + body.R @ body.shape.mean(0), []
    in_time = np.argsort(order, kind="stable")
    for place in range(level.max() + 1):
        rows = in_time[(body.ok & (level == place))[in_time]]
        turned = log_so3(body.R[rows][1:] @ np.swapaxes(body.R[rows][:-1], 1, 2))
        found.append(np.concatenate([np.diff(centre[rows], axis=0), turned], 1))
    return np.concatenate(found) / np.sqrt(2.0)


def _of_noise(body: BodyTargets) -> Array:
    """The covariance (6, 6) that the points' noise gives a pose."""
    arms = (body.shape - body.shape.mean(0)) @ body.R[np.flatnonzero(body.ok)[0]].T
    design = rigid_motions(arms).reshape(-1, 6)
    return np.asarray(np.linalg.pinv(design.T @ design / body.sigma**2))


def _root(covariance: Array, body: BodyTargets) -> Array:
    """A square root of what is positive of a covariance; at least a small share of the points' noise everywhere."""
    radius = max(float(np.sqrt(np.mean(np.sum((body.shape - body.shape.mean(0)) ** 2, -1)))), 1e-6)
    unit = np.array([body.sigma] * 3 + [body.sigma / radius] * 3)
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    return np.asarray(unit[:, None] * vectors * np.sqrt(np.maximum(values, _LEAST**2)))
