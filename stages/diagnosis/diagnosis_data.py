"""Data of a diagnosis, its artifacts, and units of reported errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from truing.report.diagnosis.findings import DECLARED_NOISE
from truing.schemas.verdict import Relation
from truing.simulation.effects_model import EffectsModel

if TYPE_CHECKING:
    from truing.inference.fitted_model import FittedModel
    from truing.inference.observations import Epochs
    from truing.inference.prediction import NoiseFloor, PredictionError
    from truing.inference.selection import CauseDiagnosis
    from truing.report.wordings.claim import Advice
    from truing.schemas.campaign import Campaign
    from truing.simulation.cause import Cause

M = TypeVar("M", bound=EffectsModel, covariant=True)

# An effect concerns a channel if it moves it by this share of its largest motion, in units of the noise.
_CONCERNED = 0.2
# An effect on displacements and rotations is reported for displacements, unless rotations show it so much more clearly.
_RATHER = 2.0
_SCATTER = "Hold one load and read every channel ten times: the scatter is the true noise."


@dataclass(frozen=True)
class ReportedRms:
    """Root mean squares over some targets (all of them: every coordinate of every point), in a unit of so much SI.

    Words for the page: ``what`` was measured, an ``epoch``, ``fitted`` and ``held_out`` data, the ``drive``
    of the predictions, the expected ``noise``, and a measurement of the ``scatter`` by itself. ``is_length``: whether
    an effect moves anything by a length or an angle. ``is_noise_known``: False if the noise is the scatter about the
    plain model, so that errors cannot be compared with it.
    """

    unit: str = "um"
    si: float = 1e-6
    targets: NDArray | slice = field(default_factory=lambda: slice(None))
    fitted: str = "the calibration poses"
    held_out: str = "held-out poses"
    drive: str = "the readings"
    scatter: str = "Measure one pose ten times without moving anything: the scatter is the true noise."
    what: str = "point"
    epoch: str = "pose"
    noise: str = DECLARED_NOISE
    is_length: bool = True
    is_noise_known: bool = True

    def rms(self, error: PredictionError | None) -> float | None:
        """Root mean square of an error, None if nothing was measured."""
        rms = None if error is None else error.rms_of(self.targets)
        return None if rms is None else rms / self.si

    def floor(self, floor: NoiseFloor) -> float | None:
        """Root mean square by noise alone; None if the noise is not known."""
        return floor.rms_of(self.targets) / self.si if self.is_noise_known else None

    def largest_motion(self, before: PredictionError, after: PredictionError) -> float | None:
        """Largest change of any prediction by an effect; None if it is no length."""
        if not self.is_length:
            return None
        moved = np.where(before.is_observed[..., None], after.gap - before.gap, 0.0)[:, self.targets]
        return float(np.sqrt(np.max(np.sum(moved**2, -1)))) / self.si

    def of_effect(self, before: PredictionError, after: PredictionError) -> ReportedRms:
        """Reporting of an effect: as of everything."""
        return self

    def of_target(self, target: int) -> ReportedRms:
        """Reporting of one target: as of everything."""
        return self

    def overall(self, error: PredictionError) -> ReportedRms:
        """Reporting of everything."""
        return self


POINTS = ReportedRms()
# Of rays, in units of their own noise; motions of points are reported elsewhere.
RAYS = ReportedRms(
    "sigma",
    1.0,
    drive="what all poses should share",
    scatter="Photograph one pose ten times without moving anything, and adjust each by itself.",
    is_length=False,
    what="ray",
)


@dataclass(frozen=True)
class Channels:
    """The units (K,) of channels and their SI value; ``signal`` (K,): True for signals, which are no readings.

    In words as in `ReportedRms`; ``epoch`` is what a reading is taken at.
    """

    units: tuple[str, ...]
    si: NDArray
    signal: NDArray
    epoch: str = "load step"
    fitted: str = "the runs fitted"
    held_out: str = "held-out runs"
    drive: str = "the loads"
    scatter: str = _SCATTER
    what: str = "reading"
    noise: str = DECLARED_NOISE
    is_noise_known: bool = True

    def of_effect(self, before: PredictionError, after: PredictionError) -> ReportedRms:
        """Reporting of an effect: over the channels of one unit that it moves; signals if it moves no reading."""
        moved = after.whitened - before.whitened
        size = np.sqrt(np.sum(np.where(before.is_observed, np.sum(moved**2, -1), 0.0), 0))
        size = np.where(size >= _CONCERNED * size.max(), size, 0.0)
        readings = np.where(self.signal, 0.0, size)
        return self._reported_rms(readings if readings.any() else size)

    def of_target(self, target: int) -> ReportedRms:
        """Reporting of one channel."""
        return self._reported_rms((np.arange(len(self.units)) == target).astype(float))

    def overall(self, error: PredictionError) -> ReportedRms:
        """Reporting of all readings: those of the most frequent unit."""
        seen = error.is_observed.sum(0).astype(float)
        readings = np.where(self.signal, 0.0, seen)
        return self._reported_rms(readings if readings.any() else seen)

    def _reported_rms(self, weight: NDArray) -> ReportedRms:
        units = np.array(self.units)
        total = {unit: float(np.sum(weight[units == unit] ** 2)) for unit in dict.fromkeys(self.units)}
        unit = max(total, key=lambda name: total[name])
        if total[self.units[0]] * _RATHER**2 >= total[unit]:
            unit = self.units[0]
        members = np.flatnonzero((units == unit) & ((weight > 0.0) | (weight.max() == 0.0)))
        words = (self.fitted, self.held_out, self.drive, self.scatter, self.what, self.epoch, self.noise)
        si = float(self.si[members[0]])
        return ReportedRms(unit, si, members, *words, is_noise_known=self.is_noise_known)


@dataclass(frozen=True)
class InstrumentResults:
    """Artifacts of an instrument (None if absent), and next measurement by a cause's key."""

    artifacts: Mapping[str, object]
    advice: Mapping[str, Advice] = field(default_factory=dict)


@dataclass(frozen=True)
class IsolatedPoint:
    """A point that agrees with no other of its target just before or after it: its pose, body and target, and its
    distance from its place on the body, m."""

    pose: int | str
    subject: str
    distance: float


@dataclass(frozen=True)
class DiagnosisData(Generic[M]):
    """Measured values by role, model of the plain simulation, and omissions in words. ``leaves``: artifacts of its
    instrument; ``relation``: relation that its model tests; ``isolated``: points that are left out before any fit.
    ``every_epoch``: the same of all epochs where the search takes only some; the final model is fitted to them."""

    model: M
    calibration: Epochs
    held_out: Epochs | None
    left_out: str
    instrument_results: Callable[[CauseDiagnosis, DiagnosisData[EffectsModel], Campaign], InstrumentResults]
    given: tuple[Cause, ...] = ()  # causes that are certain before any search: labels that were exchanged
    shown: ReportedRms | Channels = POINTS
    model_text: Callable[[FittedModel, Campaign], str] | None = None  # what stands in model.toml of a fit
    is_calibrated: Callable[[Cause], bool] = lambda cause: False  # whether a calibration can hold a cause's effect
    relation: Relation = Relation.READINGS_POSES
    isolated: tuple[IsolatedPoint, ...] = ()
    framing: int | None = None  # platform targets that sit on no attachment; None where there is no mechanism
    every_epoch: DiagnosisData[M] | None = None

    @property
    def whole(self) -> DiagnosisData[M]:
        """Data of all epochs, which are these unless the search takes only some."""
        return self.every_epoch or self
