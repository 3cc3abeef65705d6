"""What every model shares: effects among its unknowns; and what instruments make of points."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Cause, Effect, Step
from truing.simulation.mechanisms.recording import Recording

if TYPE_CHECKING:
    from truing.simulation.prior_campaign import CampaignPrior


@dataclass(frozen=True)
class Photographed:
    """That points come from photographs: with so many ``errors`` common to all poses (of cameras, of scale bars) and so
    many that the points of each pose share (its scale, ..), each of one standard deviation; and the bars that gave them
    their scale, and at which height in the model's frame, m."""

    errors: int = 0
    pose_errors: int = 0
    scale_bars: tuple[str, ...] = ()
    scale_height_m: float = 0.0


@dataclass(frozen=True)
class Split:
    """Which shared unknowns (P,) split a variance, by their place; which of them (P,) all legs have in common; and the
    share of the variance that is in common."""

    places: NDArray
    common: NDArray
    share: float


@dataclass(frozen=True)
class Prediction:
    """What a model predicts at shared and local unknowns, with derivatives per prior sigma.

    Points are readings of a bench, numbers of rays; rows of knowledge concern no pose (survey, a prior campaign).
    """

    values: NDArray  # (B, K, 3) m, base frame
    by_shared: NDArray  # (B, K, 3, G) m
    by_local: NDArray  # (B, K, 3, H) m
    known_residual: NDArray  # (E,) whitened, measured - predicted
    known_by_shared: NDArray  # (E, G) whitened
    shared_known: NDArray  # (G,) whose prior is knowledge, and not merely wide
    local_known: NDArray  # (H,)


@dataclass(frozen=True)
class EffectsModel(ABC):
    """Points as a function of unknowns that all poses share (G,) and of each pose's own (B, H), with some effects."""

    causes: tuple[Cause, ...] = field(default=(), kw_only=True)
    prior_campaign: CampaignPrior | None = field(default=None, kw_only=True)

    @property
    @abstractmethod
    def layout(self) -> dict[str, slice]:
        """Return where each kind of shared unknown stands in the vector."""

    @property
    @abstractmethod
    def part_count(self) -> int:
        """Return the number of legs L."""

    @property
    def zero_groups(self) -> NDArray | None:
        """Return which readings share a zero: none, since points have frames."""
        return None

    @property
    def error_groups(self) -> NDArray | None:
        """Return which poses err together: each stands for itself."""
        return None

    @property
    def split(self) -> Split | None:
        """Return how parameters split into what is common to all legs and each leg's own: none do."""
        return None

    def with_share(self, share: float) -> Self:
        """Return the model with another share in common, of parameters that split."""
        return self

    def with_causes(self, causes: Sequence[Cause]) -> Self:
        """Return the model with these effects among its unknowns, and those that a prior campaign found."""
        given = () if self.prior_campaign is None else self.prior_campaign.causes
        keys = {cause.key for cause in given}
        return replace(self, causes=(*given, *(cause for cause in causes if cause.key not in keys)))

    def scale_of(self, name: str) -> NDArray:
        """Return what a unit of the unknowns of a part of the layout is in SI: (n,) or ()."""
        return self.effect_sigma(next(cause for cause in self.causes if cause.key == name))

    def _known_rows(self, shared: NDArray) -> tuple[NDArray, NDArray]:
        """Return what a prior campaign says beforehand: whitened residual and derivative."""
        prior = self.prior_campaign
        return (np.empty(0), np.empty((0, self.shared_size))) if prior is None else prior.rows(self, shared)

    @property
    def shared_size(self) -> int:
        """Return the number of shared unknowns G."""
        return max(part.stop for part in self.layout.values())

    def embedded(self, shared: NDArray, model: Self) -> NDArray:
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
        return np.array([parameter.scale for parameter in cause.parameters(self.part_count)])

    def effect_sigma(self, cause: Cause) -> NDArray:
        """Return the prior sigma (P,) that a cause's parameters are fitted with, SI."""
        return cause.reach * self.effect_scale(cause)


def laid_out(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Return where parts of given sizes stand, one after the other."""
    ends = np.cumsum(list(sizes.values())).tolist()
    return {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}


# What photographs of all poses have in common, among the shared unknowns.
COMMON = "photographs"


@dataclass(frozen=True)
class RecordedModel(EffectsModel):
    """Points of bodies in space, which instruments record; ``photographed`` where they were computed from images."""

    photographed: Photographed | None = field(default=None, kw_only=True)

    @abstractmethod
    def _recording(self, shared: NDArray, local: NDArray) -> Recording:
        """Return what is recorded with the effects in force."""

    def points(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return the predicted points (B, K, 3), m, in the model's frame."""
        return self._with_errors(self._recording(shared, local).state.points, shared, local)

    def rotations(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return how recorded points follow shifts along the axes of the bodies' surveys, (B, K, 3, 3)."""
        return self._recording(shared, local).turn

    @property
    @abstractmethod
    def unpredicted(self) -> NDArray:
        """Return which local unknowns (H,) the model does not claim to predict."""

    @property
    @abstractmethod
    def _common_errors(self) -> NDArray | None:
        """Return how points (B, K, 3, Q) follow the errors that photographs of all poses share; None where none do."""

    @property
    def _common_sizes(self) -> dict[str, int]:
        """Return how many unknowns photographs of all poses have in common; nothing where there are none."""
        return {} if self.photographed is None else {COMMON: self.photographed.errors}

    @property
    @abstractmethod
    def _pose_errors(self) -> NDArray | None:
        """Return how points (B, K, 3, E) follow the errors that photographs of each pose share; None where none do."""

    @property
    def _pose_size(self) -> int:
        """Return how many errors the points of a pose share, the last ones of the local unknowns."""
        return 0 if self.photographed is None else self.photographed.pose_errors

    @property
    def _local_known(self) -> NDArray:
        """Return which local unknowns (H,) have a prior that is knowledge."""
        known = ~self.unpredicted
        return np.asarray(known | (np.arange(len(known)) >= len(known) - self._pose_size))

    def _with_errors(self, points: NDArray, shared: NDArray, local: NDArray) -> NDArray:
        """Return points (B, K, 3) with the errors that photographs of all poses, and of each, share."""
        if self._common_errors is not None:
            points = points + self._common_errors @ shared[self.layout[COMMON]]
        if self._pose_errors is not None:
            own = local[:, None, local.shape[1] - self._pose_size :, None]
            points = points + (self._pose_errors @ own)[..., 0]
        return points

    def _fill_pose_errors(self, by_local: NDArray) -> None:
        """Fill in the derivatives by the errors that photographs of each pose share."""
        if self._pose_errors is not None:
            by_local[..., by_local.shape[-1] - self._pose_size :] = self._pose_errors

    def _fill_common(self, by_shared: NDArray) -> None:
        """Fill in the derivatives by the errors that photographs of all poses share."""
        if self._common_errors is not None:
            by_shared[..., self.layout[COMMON]] = self._common_errors

    def _fill_instruments(self, by_shared: NDArray, shared: NDArray, recording: Recording) -> None:
        """Fill in the derivatives by the parameters of instruments' effects."""
        for effect in self.effects(shared):
            cause = effect.cause
            if cause.step is Step.INSTRUMENT and len(effect.values):
                slope = cause.change(recording.at(cause), effect.values).fields["points"] * self.effect_sigma(cause)
                by_shared[..., self.layout[cause.key]] = recording.recorded(slope, cause)
