"""Input of a calibration: measured poses and readings with covariances, nominal machine, tolerances and surveys."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.estimation.measured_numbers import NetworkErrors
from truing.simulation.mechanisms.structures.structure import Machine


@dataclass(frozen=True)
class PosesWithCovariance:
    """Poses of a body in its parent: p (B, 3) m, R (B, 3, 3), covariance (B, 6, 6) of (p, theta) with R <- exp(theta)
    R.

    NaN where the body was not found.
    """

    p: NDArray
    R: NDArray
    covariance: NDArray

    def subset(self, rows: NDArray) -> PosesWithCovariance:
        """Return some of the poses."""
        return PosesWithCovariance(self.p[rows], self.R[rows], self.covariance[rows])

    @property
    def found(self) -> NDArray:
        """True for poses (B,) in which the body was found."""
        return np.isfinite(self.p).all(-1) & np.isfinite(self.covariance).all((-1, -2))


@dataclass(frozen=True)
class SurveyShifts:
    """Shifts (B, L), m, of the attachments from their survey along z of the platform, and sigma (B, L) from their
    targets.

    NaN where no target was seen, or it was a gross error.
    """

    shift: NDArray
    sigma: NDArray

    def subset(self, rows: NDArray) -> SurveyShifts:
        """Return the shifts of some poses."""
        return SurveyShifts(self.shift[rows], self.sigma[rows])


@dataclass(frozen=True)
class MeasuredPlatform:
    """Measured poses of the platform with the actuators' readings, rho (B, L) m, and the poses of legs with targets.

    Platform and legs are given relative to the base, which is given in the measurement's frame; its error is common to
    all of them. If the points come from photographs, ``network`` holds their common errors instead.
    """

    poses: tuple[int | str, ...]
    roles: NDArray  # (B,) of text
    base: PosesWithCovariance
    platform: PosesWithCovariance
    rho: NDArray
    legs: Mapping[int, PosesWithCovariance]  # by leg, counted from 0
    shifts: SurveyShifts | None = None
    network: NetworkErrors | None = None
    load: NDArray | None = None  # wrench on the platform (B, 6), base axes, N and N m; None: none is known

    def subset(self, rows: NDArray) -> MeasuredPlatform:
        """Return some of the poses, by mask (B,)."""
        return MeasuredPlatform(
            tuple(pose for pose, is_kept in zip(self.poses, rows, strict=True) if is_kept),
            self.roles[rows],
            self.base.subset(rows),
            self.platform.subset(rows),
            self.rho[rows],
            {leg: poses.subset(rows) for leg, poses in self.legs.items()},
            self.shifts and self.shifts.subset(rows),
            self.network and self.network.subset(rows),
            None if self.load is None else self.load[rows],
        )


def under_load(machine: Machine, measured: MeasuredPlatform) -> Machine:
    """Return the machine with the loads of measured poses."""
    return machine if measured.load is None else replace(machine, load=measured.load)


@dataclass(frozen=True)
class Deformation:
    """Deformation from targets on the attachments: K (L, L) m/m, along x and y (L, 2, L), with sigma of the same shape;
    NaN where not determined."""

    K: NDArray
    sigma: NDArray


@dataclass(frozen=True)
class SurveyedAttachments:
    """Surveyed places b (A, 3), m, of the attachments of legs (A,), counted from 0; covariance (3A, 3A)."""

    legs: NDArray
    b: NDArray
    covariance: NDArray


@dataclass(frozen=True)
class CalibrationData:
    """Usable measured poses, the nominal machine, prior knowledge, and the poses left out."""

    measured: MeasuredPlatform
    machine: Machine
    tolerance: Mapping[str, float]  # one sigma of a, b, l, rho0, flexure_length (m), u and beta, where given
    reading_sigma: float  # m
    deformations: Mapping[str, Deformation]  # linear, matrix, where the deformation stage determined them
    surveyed: SurveyedAttachments | None
    left_out: str
    in_plane: Deformation | None = None  # along x and y, (L, 2, L), if the calibration takes it up
    modulo_plane: bool = False  # too few platform targets away from the attachments: its frame deforms with them
