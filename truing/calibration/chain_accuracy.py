"""Accuracy of a chain's tip: what a calibration by given poses leaves uncertain, and what tolerances do to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Mask
from truing.calibration.accuracy import WITHIN, deciding_count
from truing.calibration.chain_design import PlannedPoses
from truing.estimation.rotation import skew
from truing.simulation.mechanisms.chains.tree import TWIST, JointKind, Tree, geometry_modes

# Targets on one line show no rotation about it: least square of their width over that of their length.
_WIDE = 1e-4
_MOST_POSES = 100_000  # beyond, no number of poses counts as enough


@dataclass(frozen=True)
class TipSight:
    """Motion of the tip at B poses, m and rad in the axes of the base: derivatives (B, 6, G) by the shared unknowns per
    prior sigma, and (B, 6, H) by the readings' noise per sigma. ``of_measurement`` (B, 6): variance of a measurement
    of it. ``known`` (6,): components that its targets show."""

    by_unknowns: Array
    by_readings: Array
    of_measurement: Array
    known: Mask

    def variance(self, covariance: NDArray) -> Array:
        """Variance (B, 6) of predictions at a covariance (G, G) of the unknowns, noise of the readings included."""
        by = self.by_unknowns
        return np.asarray(np.einsum("bkg,gh,bkh->bk", by, covariance, by, optimize=True) + self.of_readings)

    @property
    def of_readings(self) -> Array:
        """Variance (B, 6) by the noise of the readings in the poses themselves."""
        return np.asarray(np.sum(self.by_readings**2, -1))


def tip_sight(poses: PlannedPoses) -> TipSight:
    """Return the linearised motion of the measured tip at poses, about the nominal chain.

    The position is the mean of the tip's targets; three of them, or a measured orientation, show rotations. In frames
    of single poses it moves relative to the link that defines these. Raises ValueError if nothing measured moves with
    the tip.
    """
    model = poses.model.at(replace(poses.conditions, coupling=None))
    local = np.zeros((len(poses.conditions.readings), model.local_size))
    predicted = model.predict(np.zeros(model.shared_size), local)
    if predicted.values.shape[-1] != 3:
        raise ValueError("measured points or poses of the tip: distances alone do not show its errors by component")
    carriers = np.array([model.tree.moving_node(int(k)) for k in model.channels.node])
    on_tip = carriers == model.tree.moving_node(model.known.payload[0])
    if not on_tip.any():
        raise ValueError("measured points or poses of the tip, or of a link that moves with it")
    places = model.points(np.zeros(model.shared_size), local)
    turned = np.asarray(model.is_angle)
    centre = places[:, on_tip & ~turned].mean(1)
    pose, known = _motion(places, turned, on_tip, centre)
    if poses.instrument.free:
        pose = pose - _motion(places, turned, carriers == carriers.min(), centre)[0]
    to_base = np.swapaxes(model.known.base_R[poses.conditions.series], -1, -2)
    rotation = np.zeros((len(to_base), TWIST, TWIST))
    rotation[:, :3, :3] = rotation[:, 3:, 3:] = to_base
    seen = rotation @ pose
    size = 3 * len(turned)
    by_shared = predicted.by_shared.reshape(len(places), size, -1)
    by_shared = np.pad(by_shared, ((0, 0), (0, 0), (model.shared_size - by_shared.shape[-1], 0)))
    by_local = predicted.by_local.reshape(len(places), size, model.local_size)
    noise = np.zeros((size, size))
    for k, covariance in enumerate(poses.instrument.covariance):
        noise[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = covariance
    of_measurement = np.einsum("bki,ij,bkj->bk", seen, noise, seen, optimize=True)
    return TipSight(np.asarray(seen @ by_shared), np.asarray(seen @ by_local), np.asarray(of_measurement), known)


def _motion(places: NDArray, turned: Mask, chosen: Mask, centre: NDArray) -> tuple[Array, Mask]:
    """Return the matrix (B, 6, 3 K) from displacements of channels to shift and rotation at ``centre`` (B, 3); and the
    mask (6,) of components that the chosen ones show."""
    count, channels = places.shape[:2]
    levers = np.where(turned[:, None], 0.0, places - centre[:, None])
    by = np.zeros((count, channels, 3, TWIST))
    by[..., 3:] = -skew(levers)
    by[..., :3] = np.where(turned[:, None, None], 0.0, np.eye(3))
    by[:, turned, :, 3:] = np.eye(3)
    by[:, ~chosen] = 0.0
    own = levers[0, chosen & ~turned]
    size = np.linalg.eigvalsh(np.cov(own.T, bias=True)) if len(own) > 2 else np.zeros(3)
    turns = bool(turned[chosen].any() or size[1] > _WIDE * size[2] > 0.0)
    known = np.array([True] * 3 + [turns] * 3)
    flat = by.reshape(count, -1, TWIST) * known
    return np.asarray(np.linalg.pinv(flat)), known


def covered(variance: NDArray) -> Array:
    """Return the sizes (K,) below which 95 % of normal errors of variance (B, K) stay, as a requirement counts them:
    1.96 times the rms."""
    return np.asarray(WITHIN * np.sqrt(np.mean(variance, 0)))


def expected_errors(sight: TipSight, information: NDArray) -> Array:
    """Return the sizes (6,), m and rad, of which 95 % of errors after a calibration stay below. ``information`` (G, G)
    of the data is per prior sigma."""
    return covered(sight.variance(np.linalg.inv(np.eye(len(information)) + information)))


def held_out_needed(sight: TipSight, information: NDArray, limits: NDArray) -> list[int | None]:
    """Return for each component (6,) the number of held-out poses that decide its requirement after a calibration by
    data of ``information`` (G, G); None if no number does, or no limit is finite."""
    variance = sight.variance(np.linalg.inv(np.eye(len(information)) + information)).mean(0)
    noise = sight.of_measurement.mean(0)
    return [
        deciding_count(float(variance[k] + noise[k]), float(noise[k]), float(limit)) if np.isfinite(limit) else None
        for k, limit in enumerate(limits)
    ]


def poses_needed(sight: TipSight, per_pose: NDArray, kept: NDArray, limits: NDArray) -> list[int | None]:
    """Return for each component (6,) the least number of further poses after which its errors stay below its limit.

    None if no number is enough, or no limit is finite. ``per_pose`` (G, G): mean information of a pose; ``kept``: that
    of poses that are measured already.
    """
    needed: list[int | None] = []
    for k, limit in enumerate(limits):
        low, high = 0, 1
        while high <= _MOST_POSES and not _reaches(sight, kept + high * per_pose, k, limit):
            low, high = high, 2 * high
        if not np.isfinite(limit) or high > _MOST_POSES:
            needed.append(None)
            continue
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if _reaches(sight, kept + middle * per_pose, k, limit) else (middle, high)
        needed.append(high)
    return needed


def _reaches(sight: TipSight, information: NDArray, component: int, limit: float) -> bool:
    return bool(expected_errors(sight, information)[component] <= limit)


@dataclass(frozen=True)
class ToleranceSource:
    """One tolerance of a joint or link, and the motion (B, 6, P) of the tip by its P numbers, m and rad per sigma."""

    kind: str  # offset, length or angle
    subject: str
    by_numbers: Array

    @property
    def variance(self) -> Array:
        """Variance (B, 6) of the tip's errors by this tolerance alone."""
        return np.asarray(np.sum(self.by_numbers**2, -1))


def tolerance_sources(
    tree: Tree, tip: int, readings: NDArray, offsets: NDArray, sigma: NDArray
) -> list[ToleranceSource]:
    """Return the errors of the tip by each tolerance, before any calibration, in the axes of the base.

    readings (B, n), rad or m; ``offsets`` (n,): of zeros; ``sigma`` (6,): of the shifts and rotations of each joint's
    frame. A tip behind its last joint has a frame with the same tolerances.
    """
    frames = tree.frames(readings)
    node = np.array([tip])
    by_twist = np.concatenate(
        [tree.point_slopes(frames, node, frames.t[:, node]), tree.rotation_slopes(frames, node)], 2
    )[:, 0]
    found = [
        ToleranceSource("offset", tree.readings[k], np.einsum("bknc,nc->bk", by_twist, zero)[..., None])
        for k, zero in enumerate(tree.axis_twists * offsets[:, None, None])
        if offsets[k] > 0.0
    ]
    if not sigma.any():
        return found
    modes = geometry_modes(tree, sigma, False, np.ones(TWIST, bool))
    for k, frame in enumerate(tree.nodes):
        own = modes[k][:, np.abs(modes[k]).max(0, initial=0.0) > 0.0]
        if k == tip and frame.kind is JointKind.FIXED and frame.parent >= 0:
            own = np.diag(sigma)
        for kind, rows in (("length", slice(0, 3)), ("angle", slice(3, 6))):
            part = np.zeros_like(own)
            part[rows] = own[rows]
            moved = by_twist[:, :, k] @ part
            if np.abs(moved).max(initial=0.0) > 0.0:
                found.append(ToleranceSource(kind, frame.joint or frame.link, np.asarray(moved)))
    return found


def total_variance(sources: Sequence[ToleranceSource]) -> Array:
    """Return the variance (B, 6) by all tolerances together."""
    return np.asarray(np.sum([source.variance for source in sources], 0))
