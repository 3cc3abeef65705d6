"""Frames of base and platform that poses may have in place of those of the described joints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from truing.arrays import Array
from truing.belonging.reading_hypotheses import Description, MeasuredMotion
from truing.belonging.relation import RecordSlip, SlipKind
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.legs.kinematics import forward

_UP = np.array([0.0, 0.0, 1.0])
_FEWEST = 8  # least poses for the twelve numbers of two frames
_LEFT = 0.1  # largest share of the movement that the fitted frames may leave
_ELSEWHERE = 0.02  # least distance of a frame from its described place, as a share of the legs' length, or in rad


@dataclass(frozen=True)
class OtherFrames:
    """Poses in the frames of the joints, with the slip that says where these frames lie; misfit (rms, m) with it."""

    slip: RecordSlip
    misfit: float


def other_frames(motion: MeasuredMotion) -> OtherFrames | None:
    """Return the frames of base and platform in which readings and poses agree; None where none does.

    The readings give poses by the described legs. A fixed motion before and one after these poses lead to the measured
    ones (robot and world calibration: rotations from pose to pose have the same axes in both frames).
    """
    if motion.legs.count < 6 or len(motion.p) < _FEWEST:
        return None
    found = [one for legs in _assemblies(motion.legs) if (one := _placed(motion, legs))]
    return min(found, key=lambda one: one.misfit, default=None)


def _assemblies(legs: Legs) -> Iterator[Legs]:
    """Yield the legs with the platform on either side of the base, where their description does not say on which."""
    if "u" in legs.closure.geometry:
        yield legs
        return
    for side in (1.0, -1.0):
        yield legs.replace(u=np.broadcast_to(side * _UP, legs.a.shape))


def _placed(motion: MeasuredMotion, legs: Legs) -> OtherFrames | None:
    """Return the frames in which readings and poses agree for one assembly of the legs."""
    by_readings = forward(legs, motion.readings)
    rows = np.flatnonzero(by_readings.converged)
    if len(rows) < max(_FEWEST, len(motion.p) / 2):
        return None
    own_R, own_p, R, p = by_readings.R[rows], by_readings.p[rows], motion.R[rows], motion.p[rows]
    base, tool = _rotations(own_R, R)
    # p = t_base + base own_p + base own_R t_tool
    design = np.concatenate([np.broadcast_to(np.eye(3), R.shape), base @ own_R], axis=2).reshape(-1, 6)
    places = np.linalg.lstsq(design, (p - own_p @ base.T).ravel(), rcond=None)[0]
    of_base, of_tool = places[:3], places[3:]
    turned = base.T @ motion.R @ tool.T
    moved = (motion.p - of_base) @ base - turned @ of_tool
    required = Description((), legs, moved, turned).required_readings()
    reached = np.isfinite(required).all(axis=1)
    if reached.sum() < max(_FEWEST, len(motion.p) / 2):
        return None
    misfit = motion.readings[reached] - required[reached]
    travel = required[reached] - required[reached].mean(axis=0)
    left = float(np.sqrt(np.mean((misfit - misfit.mean(axis=0)) ** 2)))
    if left > _LEFT * float(np.sqrt(np.mean(travel**2))):
        return None
    least = _ELSEWHERE * float(np.abs(legs.l).mean())
    frames = [
        _numbers(name, place, R_frame)
        for name, place, R_frame in (("base", of_base, base), ("platform", of_tool, tool))
        if np.linalg.norm(place) > least or Rotation.from_matrix(R_frame).magnitude() > _ELSEWHERE
    ]
    if not frames:
        return None
    return OtherFrames(RecordSlip(SlipKind.OTHER_FRAME, motion.measured, frames=tuple(frames)), left)


def _rotations(own: Array, measured: Array) -> tuple[Array, Array]:
    """Return base and tool (3, 3) with measured = base @ own @ tool, for orientations (B, 3, 3).

    The rotation vector between two poses is, in the measured frame, that of the own frame turned by the base.
    """
    between = [Rotation.from_matrix(one[1:] @ np.swapaxes(one[:-1], 1, 2)).as_rotvec() for one in (measured, own)]
    base = _nearest_rotation(between[0].T @ between[1])
    return base, _nearest_rotation(np.sum(np.swapaxes(base @ own, 1, 2) @ measured, axis=0))


def _nearest_rotation(matrix: Array) -> Array:
    """Return the rotation (3, 3) R of the largest trace(Rᵀ matrix)."""
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)


def _numbers(name: str, place: Array, R: Array) -> tuple[str, tuple[float, ...]]:
    """Return the name of a body with the place (mm) and the rotation vector (degrees) of a frame."""
    turn = np.degrees(Rotation.from_matrix(R).as_rotvec())
    return name, tuple(float(f"{number:.4g}") for number in (*(1e3 * place), *turn))
