"""What every model shares: effects among its unknowns, and what a prior campaign says of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Generic, Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import OBSERVED, CauseT, Effect, Scene

if TYPE_CHECKING:
    from truing.inference.model import Split
    from truing.simulation.prior_campaign import CampaignPrior


@dataclass(frozen=True)
class Prediction:
    """What a model predicts at shared and local unknowns, with derivatives per prior sigma.

    Observations are of d dimensions: points of three, in m, readings and numbers of rays of one. Rows of knowledge
    concern no epoch (survey, a prior campaign).
    """

    values: NDArray  # (B, K, d)
    by_shared: NDArray  # (B, K, d, G)
    by_local: NDArray  # (B, K, d, H)
    known_residual: NDArray  # (E,) whitened, measured - predicted
    known_by_shared: NDArray  # (E, G) whitened
    shared_known: NDArray  # (G,) whose prior is knowledge, and not merely wide
    local_known: NDArray  # (H,)


@dataclass(frozen=True)
class EffectsModel(ABC, Generic[CauseT]):
    """Observations as a function of unknowns that all epochs share (G,) and of each one's own (B, H), with effects."""

    causes: tuple[CauseT, ...] = field(default=(), kw_only=True)
    prior_campaign: CampaignPrior[CauseT] | None = field(default=None, kw_only=True)

    # What one channel is called: a target, an encoder.
    channel_word: ClassVar[str]

    @property
    @abstractmethod
    def channel_names(self) -> tuple[str, ...]:
        """The names (K,) of what is measured, as tables have them."""

    @property
    def channel_kinds(self) -> tuple[str, ...]:
        """What tells (K,) channels of one name apart: the body of each, or what sort of channel it is."""
        return (self.channel_word,) * len(self.channel_names)

    @property
    @abstractmethod
    def scene(self) -> Scene[CauseT]:
        """What the campaign offers to causes when they propose candidates."""

    @property
    def survey(self) -> slice:
        """Where the unknowns of the channels' survey stand: nowhere."""
        return slice(0)

    @property
    @abstractmethod
    def _sizes(self) -> dict[str, int]:
        """Return how many shared unknowns there are of each kind, but for those of effects."""

    @cached_property
    def layout(self) -> dict[str, slice]:
        """Return where each kind of shared unknown stands in the vector."""
        return laid_out({**self._sizes, **{cause.key: len(cause.parameters(self.part_count)) for cause in self.causes}})

    @property
    def part_count(self) -> int:
        """Return the number of like parts, legs, that some causes have parameters of their own for: none."""
        return 0

    @property
    @abstractmethod
    def unpredicted(self) -> NDArray:
        """Return which local unknowns (H,) the model does not claim to predict."""

    @property
    @abstractmethod
    def _shared_known(self) -> NDArray:
        """Return which shared unknowns (G,) have a prior that is knowledge, and not merely wide."""

    @property
    def _local_known(self) -> NDArray:
        """Return which local unknowns (H,) have a prior that is knowledge."""
        return np.asarray(~self.unpredicted)

    @property
    def zero_groups(self) -> NDArray | None:
        """Return which readings share a zero: none, since points have frames."""
        return None

    @property
    def error_groups(self) -> NDArray | None:
        """Return which poses err together: each stands for itself."""
        return None

    @property
    def input_scale(self) -> NDArray:
        """Return one prior sigma of each input (H,), SI: there are none."""
        return np.zeros(0)

    def with_input_factor(self, factor: NDArray) -> Self:
        """Return the model with other prior sigmas of inputs: there are none."""
        return self

    @property
    def split(self) -> Split | None:
        """Return how parameters split into what is common to all legs and each leg's own: none do."""
        return None

    def with_share(self, share: float) -> Self:
        """Return the model with another share in common, of parameters that split."""
        return self

    def with_causes(self, causes: Sequence[CauseT]) -> Self:
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

    def _prediction(self, shared: NDArray, values: NDArray, by_shared: NDArray | None, by_local: NDArray) -> Prediction:
        """Return a prediction with what is known beforehand; without derivatives by shared unknowns where none are."""
        residual, rows, slopes = np.empty(0), np.empty((0, 0)), np.empty((*values.shape, 0))
        if by_shared is not None:
            (residual, rows), slopes = self._known_rows(shared), by_shared
        return Prediction(values, slopes, by_local, residual, rows, self._shared_known, self._local_known)

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

    def effects(self, shared: NDArray) -> tuple[Effect[CauseT], ...]:
        """Return the effects with the values that shared unknowns (G,) stand for."""
        return tuple(Effect(cause, shared[self.layout[cause.key]] * self.effect_sigma(cause)) for cause in self.causes)

    def set_effects(self, shared: NDArray, effects: Iterable[Effect[CauseT]]) -> None:
        """Put the values of effects among shared unknowns (G,)."""
        for effect in effects:
            shared[self.layout[effect.cause.key]] = effect.values / self.effect_sigma(effect.cause)

    def effect_scale(self, cause: CauseT) -> NDArray:
        """Return the plausible scale (P,) of a cause's parameters, SI."""
        return np.array([parameter.scale for parameter in cause.parameters(self.part_count)])

    def effect_sigma(self, cause: CauseT) -> NDArray:
        """Return the prior sigma (P,) that a cause's parameters are fitted with, SI."""
        return cause.reach * self.effect_scale(cause)


def laid_out(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Return where parts of given sizes stand, one after the other."""
    ends = np.cumsum(list(sizes.values())).tolist()
    return {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}


class ChannelModel(EffectsModel[CauseT]):
    """Channels of one dimension each, seen from no place: readings, or what rays tell.

    Causes act on what is observed itself, whatever it depends on.
    """

    @property
    def local_size(self) -> int:
        """Return the number of local unknowns."""
        return 0

    @property
    def unpredicted(self) -> NDArray:
        """Return which local unknowns the model says nothing of: none."""
        return np.zeros(self.local_size, bool)

    @property
    def channel_groups(self) -> NDArray:
        """Return the number of each channel's noise (K,): one for all, since a single channel has too few readings to
        tell its noise from an effect on most of them."""
        return np.zeros(len(self.channel_names), int)

    @abstractmethod
    def points(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return the predicted channels (B, K, 1) at shared (G,) and local (B, H) unknowns."""

    @abstractmethod
    def _slopes_at(self, shared: NDArray, local: NDArray) -> Callable[[CauseT, NDArray], NDArray]:
        """Return what tells how channels (B, K, P) follow a cause's parameters at values (P,), SI."""

    def rotations(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return how channels follow shifts of them, (B, K, 1, 1): by one."""
        return np.ones((len(local), len(self.channel_names), 1, 1))

    def pathways(self, shared: NDArray, local: NDArray) -> dict[str, NDArray]:
        """Return no pathway beside what is observed."""
        return {}

    def design_matrix(self, shared: NDArray, local: NDArray) -> Callable[[CauseT], dict[str, NDArray]]:
        """Return what tells a cause's change of the pathway ``observed``, (B, K, P), per plausible scale."""
        slopes = self._slopes_at(shared, local)

        def found(cause: CauseT) -> dict[str, NDArray]:
            scale = self.effect_scale(cause)
            return {OBSERVED: slopes(cause, np.zeros(len(scale))) * scale}

        return found

    def _fill_effects(self, by_shared: NDArray, shared: NDArray, slopes: Callable[[CauseT, NDArray], NDArray]) -> None:
        """Fill in the derivatives (B, K, G) by the parameters of effects, of which ``slopes`` tells."""
        for effect in self.effects(shared):
            own = slopes(effect.cause, effect.values) * self.effect_sigma(effect.cause)
            by_shared[..., self.layout[effect.cause.key]] = own
