"""Surveyed and measured targets of a legged mechanism, and the positions of targets on its legs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rigid_poses.umeyama import umeyama
from truing.inference.observations import Epochs, Frames, Observations
from truing.simulation.mechanisms.causes.targets import TargetsSwapped
from truing.simulation.mechanisms.extended_model import some_of
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.model import nominal_leg_frames
from truing.simulation.mechanisms.recording import Conditions
from truing.simulation.targets import LEG, Targets

_FEWEST_TARGETS = 3


@dataclass(frozen=True)
class MeasuredTargets:
    """Targets of all bodies, one after the other, m, and the exchanged labels among them."""

    targets: Targets
    shape: NDArray  # (K, 3)
    shape_cov: NDArray  # (K, 3, 3)
    points: NDArray  # (B, K, 3)
    cov: NDArray  # (B, K, 3, 3)
    is_observed: NDArray  # (B, K)
    swapped: tuple[TargetsSwapped, ...]

    def subset(self, used: NDArray) -> MeasuredTargets:
        """Return some of the targets (mask K)."""
        every = self.targets
        names = [tuple(np.array(values, object)[used]) for values in (every.names, every.bodies)]
        targets = Targets(every.body[used], every.leg[used], names[0], names[1])
        return MeasuredTargets(
            targets,
            self.shape[used],
            self.shape_cov[used],
            self.points[:, used],
            self.cov[:, used],
            self.is_observed[:, used],
            tuple(cause for cause in self.swapped if cause.body in targets.bodies),
        )

    def epochs(self, conditions: Conditions, frames: Frames, rows: NDArray) -> Epochs:
        """Return the measurements at some poses (mask B)."""
        measured = Observations(self.points[rows], self.cov[rows], self.is_observed[rows])
        return Epochs(measured, some_of(conditions, rows), Frames(frames.R[rows], frames.t[rows]))


@dataclass(frozen=True)
class SeatedLegs:
    """Legs (R,) that carry targets, and the position of each leg's survey frame on the leg in its nominal direction.

    rotation (L, 3, 3) and seat (L, 3), m, are start values. ``dropped`` lists, in words, targets on legs without use.
    """

    legs: NDArray
    rotation: NDArray
    seat: NDArray
    dropped: list[str]

    def targets_on_legs(self, targets: Targets) -> NDArray:
        """Return the mask (K,) of the targets on one of these legs, or on no leg."""
        return np.asarray((targets.body != LEG) | np.isin(targets.leg, self.legs))


def seated_legs(
    legs: Legs, measured: MeasuredTargets, readings: NDArray, frames: Frames, fitted: NDArray
) -> SeatedLegs:
    """Find the position of the legs' survey frames from their targets.

    readings (B, L), m; ``fitted`` (B,) marks the poses that may be used; frames are those of the base.
    """
    seats = _leg_motions(legs, measured, frames, fitted)
    carrying = {int(leg) for leg in measured.targets.leg[measured.targets.body == LEG]}
    ridden = [leg for leg in seats if legs.closure.one_body]
    dropped = [f"targets of leg{leg + 1} (fewer than three seen together off a line)" for leg in carrying - set(seats)]
    dropped += ["targets on legs, which are not one rigid body each"] if len(seats) > len(ridden) else []
    rotation, seat = np.tile(np.eye(3), (legs.count, 1, 1)), np.zeros((legs.count, 3))
    for leg in ridden:
        pose, R, t = seats[leg]
        frame = nominal_leg_frames(legs, readings[pose][None])
        rotation[leg] = frame.rotation[0, leg].T @ R
        seat[leg] = frame.rotation[0, leg].T @ (t - frame.origin[0, leg])
    return SeatedLegs(np.array(ridden, int), rotation, seat, dropped)


def _leg_motions(
    legs: Legs, measured: MeasuredTargets, frames: Frames, fitted: NDArray
) -> dict[int, tuple[int, NDArray, NDArray]]:
    """Return, by leg, its best measured pose and the motion from its survey to the base there."""
    in_base = (measured.points - np.nan_to_num(frames.t)[:, None]) @ frames.R
    motions = {}
    for leg in range(legs.count):
        on_leg = (measured.targets.body == LEG) & (measured.targets.leg == leg)
        if on_leg.sum() < _FEWEST_TARGETS:
            continue
        fit = umeyama(
            measured.shape[on_leg],
            in_base[:, on_leg],
            (measured.is_observed[:, on_leg] & fitted[:, None]).astype(float),
        )
        best = int(np.argmax(np.where(fit.ok, fit.n_used - np.nan_to_num(fit.rms), -1.0)))
        if fit.ok[best]:
            motions[leg] = best, fit.R[best], fit.t[best]
    return motions
