"""What every model shares: effects among its unknowns; and what instruments make of points."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Cause, Effect, Step
from truing.simulation.recording import Recording
from truing.simulation.split import Split


@dataclass(frozen=True)
class EffectsModel(ABC):
    """Points as a function of unknowns that all poses share (G,) and of each pose's own (B, H), with some effects."""

    causes: tuple[Cause, ...] = field(default=(), kw_only=True)

    @property
    @abstractmethod
    def layout(self) -> dict[str, slice]:
        """Return where each kind of shared unknown stands in the vector."""

    @property
    @abstractmethod
    def leg_count(self) -> int:
        """Return the number of legs L."""

    @property
    def zeros(self) -> NDArray | None:
        """Return which readings share a zero: none, since points have frames."""
        return None

    @property
    def together(self) -> NDArray | None:
        """Return which poses err together: each stands for itself."""
        return None

    @property
    def split(self) -> Split | None:
        """Return how parameters split into what is common to all legs and each leg's own: none do."""
        return None

    def with_share(self, share: float) -> Self:
        """Return the model with another share in common, of parameters that split."""
        return self

    @property
    def shared_size(self) -> int:
        """Return the number of shared unknowns G."""
        return max(part.stop for part in self.layout.values())

    def widened(self, shared: NDArray, model: Self) -> NDArray:
        """Return shared unknowns of this model as those of another, zero where this one has none."""
        wide = np.zeros(model.shared_size)
        if len(shared):
            for name in self.layout.keys() & model.layout.keys():
                wide[model.layout[name]] = shared[self.layout[name]]
        return wide

    def effects(self, shared: NDArray) -> tuple[Effect, ...]:
        """Return the effects with the values that shared unknowns (G,) stand for."""
        return tuple(Effect(cause, shared[self.layout[cause.key]] * self.effect_sigma(cause)) for cause in self.causes)

    def effect_scale(self, cause: Cause) -> NDArray:
        """Return the plausible scale (P,) of a cause's parameters, SI."""
        return np.array([parameter.scale for parameter in cause.parameters(self.leg_count)])

    def effect_sigma(self, cause: Cause) -> NDArray:
        """Return the prior sigma (P,) that a cause's parameters are fitted with, SI."""
        return cause.reach * self.effect_scale(cause)


@dataclass(frozen=True)
class RecordedModel(EffectsModel):
    """Points of bodies in space, which instruments record."""

    @abstractmethod
    def _recording(self, shared: NDArray, local: NDArray) -> Recording:
        """Return what is recorded with the effects in force."""

    def points(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return the predicted points (B, K, 3), m, in the model's frame."""
        return self._recording(shared, local).state.points

    def turns(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return how recorded points follow shifts along the axes of the bodies' surveys, (B, K, 3, 3)."""
        recording = self._recording(shared, local)
        return recording.recorded(recording.state.turn)

    def _fill_instruments(self, by_shared: NDArray, shared: NDArray, recording: Recording) -> None:
        """Fill in the derivatives by the parameters of instruments' effects."""
        for effect in self.effects(shared):
            cause = effect.cause
            if cause.step is Step.INSTRUMENT and len(effect.values):
                slope = cause.change(recording.at(cause), effect.values).fields["points"] * self.effect_sigma(cause)
                by_shared[..., self.layout[cause.key]] = recording.recorded(slope, cause)
