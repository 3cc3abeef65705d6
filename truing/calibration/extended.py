"""The extended model next to the calibrations: what it identified, and its errors at the measured poses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.calibration.accuracy import PoseErrors
from truing.calibration.measured import Measured
from truing.estimation.rotation import log_so3
from truing.inference.pulls import TOLD
from truing.simulation.cause import Effect
from truing.simulation.mechanisms.extended_model import ExtendedModel, acts_on_poses, predict_poses, some_of
from truing.simulation.mechanisms.identified import IdentifiedGeometry, identified_geometry

if TYPE_CHECKING:
    from truing.simulation.mechanisms.recording import Conditions

MODEL, ESTIMATOR = "extended", "points"
# How the platform deforms in the model, by the cause that was found; the richest counts.
_DEFORMATIONS = {
    "platform-deformation-matrix": "matrix",
    "platform-deformation-nonlinear": "nonlinear",
    "platform-deformation-linear": "linear",
}


@dataclass(frozen=True)
class Extended:
    """The extended model of a campaign, and its errors at the measured poses."""

    found: ExtendedModel
    errors: PoseErrors

    @property
    def deformation(self) -> str:
        """How the platform deforms in it."""
        ids = {cause.id for cause in self.found.model.causes}
        return next((name for cause, name in _DEFORMATIONS.items() if cause in ids), "none")

    @cached_property
    def geometry(self) -> IdentifiedGeometry:
        """The geometry that it identified."""
        return identified_geometry(self.found.model, self.found.shared, self.found.covariance)

    @property
    def effects(self) -> tuple[tuple[Effect, NDArray], ...]:
        """The effects that it holds, with the covariance (P, P) of their parameters, SI."""
        model = self.found.model
        parts = [(effect, model.layout[effect.cause.key]) for effect in model.effects(self.found.shared)]
        scales = [model.effect_sigma(effect.cause) for effect, _ in parts]
        return tuple(
            (effect, self.found.covariance[part, part] * np.outer(scale, scale))
            for (effect, part), scale in zip(parts, scales, strict=True)
        )


def errors_at(found: ExtendedModel, conditions: Conditions, measured: Measured, fitted: NDArray) -> PoseErrors:
    """Measured minus predicted poses, as the instrument should have seen them; NaN where a condition is not known."""
    error, noise = np.full((len(fitted), 6), np.nan), np.zeros((len(fitted), 6, 6))
    rows = np.flatnonzero(_told(found, conditions))
    if len(rows):
        poses = predict_poses(found, some_of(conditions, rows), recorded=True)
        platform = measured.platform.chosen(rows)
        turned = log_so3(platform.R @ np.swapaxes(poses.R, -1, -2))
        away = np.concatenate([platform.p - poses.p, turned], -1)
        error[rows] = np.where(poses.converged[:, None], away, np.nan)
        # Poses that took part have pulled the model to themselves: they share its error.
        shared = np.where(fitted[rows, None, None], 2.0, 0.0) * poses.of_model
        noise[rows] = platform.covariance + poses.covariance - shared
    return PoseErrors(error, noise)


def _told(found: ExtendedModel, conditions: Conditions) -> NDArray:
    """Where (B,) every column that the model's effects follow holds a number."""
    legs = found.model.nominal.count
    needed = {name for cause in found.model.causes if acts_on_poses(cause) for name in cause.needs(legs)}
    columns = [conditions.covariates[name] for name in needed & conditions.covariates.keys()]
    known = [np.isfinite(column.reshape(len(column), -1)).all(1) for column in columns]
    return np.logical_and.reduce([np.ones(len(conditions.readings), bool), *known])


def identifiable(geometry: IdentifiedGeometry) -> NDArray:
    return np.asarray(1.0 - geometry.sigma**2 / np.diag(geometry.prior) >= TOLD)
