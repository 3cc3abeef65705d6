"""Base classes `EffectsModel` and `ChannelModel`: layout of unknowns, effects among them, and the prior campaign."""

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
    from truing.inference.model import ErrorPathway, PartialDesign, Split, ZeroColumns
    from truing.simulation.prior_campaign import CampaignPrior


@dataclass(frozen=True)
class Prediction:
    """Predicted observations at shared and local unknowns, with derivatives per prior sigma.

    The dimension d is 3 for points (m) and 1 for readings and camera parameters. Rows of prior knowledge (survey, prior
    campaign) belong to no epoch.
    """

    values: NDArray  # (B, K, d)
    by_shared: NDArray  # (B, K, d, G), or (B, K, d, G - Z) after zero columns
    by_local: NDArray  # (B, K, d, H)
    known_residual: NDArray  # (E,) whitened, measured - predicted
    known_by_shared: NDArray  # (E, G) whitened
    shared_known: NDArray  # (G,) whether the prior is knowledge, not a wide default
    local_known: NDArray  # (H,)
    zero_columns: ZeroColumns | None = None


@dataclass(frozen=True)
class EffectsModel(ABC, Generic[CauseT]):
    """Observations as a function of G unknowns shared by all epochs and H unknowns of each epoch, with effects."""

    causes: tuple[CauseT, ...] = field(default=(), kw_only=True)
    prior_campaign: CampaignPrior[CauseT] | None = field(default=None, kw_only=True)

    # Word for one channel in tables: target, encoder.
    channel_word: ClassVar[str]

    @property
    @abstractmethod
    def channel_names(self) -> tuple[str, ...]:
        """Names (K,) of the measured channels, as in the tables."""

    @property
    def channel_kinds(self) -> tuple[str, ...]:
        """Body or sort of each channel (K,), which distinguishes channels of the same name."""
        return (self.channel_word,) * len(self.channel_names)

    @property
    @abstractmethod
    def scene(self) -> Scene[CauseT]:
        """Scene from which causes propose candidates."""

    @property
    def survey(self) -> slice:
        """Slice of the shared unknowns that describe the survey of the channels: empty here."""
        return slice(0)

    @property
    @abstractmethod
    def _sizes(self) -> dict[str, int]:
        """Number of shared unknowns by kind, without those of effects."""

    @cached_property
    def layout(self) -> dict[str, slice]:
        """Slice of each kind of shared unknown in their vector; effects by their key."""
        return consecutive_slices(
            {**self._sizes, **{cause.key: len(cause.parameters(self.part_count)) for cause in self.causes}}
        )

    @property
    def part_count(self) -> int:
        """Number of like parts (legs) for which a cause may have separate parameters: none here."""
        return 0

    @property
    def setup(self) -> NDArray:
        """Mask (G,) of the shared unknowns of the set-up that are fitted anew without a known cause: none here."""
        return np.zeros(self.shared_size, bool)

    @property
    @abstractmethod
    def unpredicted(self) -> NDArray:
        """Mask (H,) of the local unknowns that the model does not predict."""

    @property
    @abstractmethod
    def _shared_known(self) -> NDArray:
        """Mask (G,) of the shared unknowns whose prior is knowledge, not a wide default."""

    @property
    def _local_known(self) -> NDArray:
        """Mask (H,) of the local unknowns whose prior is knowledge."""
        return np.asarray(~self.unpredicted)

    @property
    def zero_groups(self) -> NDArray | None:
        """Group number (B, K) of the readings that share an unknown zero; None here, since points have frames."""
        return None

    @property
    def error_groups(self) -> NDArray | None:
        """Group number (B,) of the epochs with a common error; None if all epochs are independent."""
        return None

    @property
    def input_scale(self) -> NDArray:
        """Prior sigma of each input (H,), SI; empty here."""
        return np.zeros(0)

    @property
    def error_pathways(self) -> tuple[ErrorPathway, ...]:
        """Directions of errors of single parts: none here."""
        return ()

    def with_input_factor(self, factor: NDArray) -> Self:
        """Return the model with the prior sigmas of the inputs multiplied by a factor; unchanged here: there are
        none."""
        return self

    @property
    def split(self) -> Split | None:
        """Parameters that split into a common part and one part per leg; None here."""
        return None

    def with_share(self, share: float) -> Self:
        """Return the model with another common share of the variance of split parameters."""
        return self

    def with_causes(self, causes: Sequence[CauseT]) -> Self:
        """Return the model with the effects of these causes, and those of the prior campaign, among its unknowns."""
        prior_causes = () if self.prior_campaign is None else self.prior_campaign.causes
        keys = {cause.key for cause in prior_causes}
        return replace(self, causes=(*prior_causes, *(cause for cause in causes if cause.key not in keys)))

    def scale_of(self, name: str) -> NDArray:
        """Return the SI value of one unit of the unknowns of a part of the layout, (n,) or ()."""
        return self.effect_sigma(next(cause for cause in self.causes if cause.key == name))

    def _known_rows(self, shared: NDArray) -> tuple[NDArray, NDArray]:
        """Return the knowledge of the prior campaign as whitened residuals (E,) and derivatives (E, G)."""
        prior = self.prior_campaign
        return (np.empty(0), np.empty((0, self.shared_size))) if prior is None else prior.rows(self, shared)

    def _prediction(self, shared: NDArray, values: NDArray, by_shared: NDArray | None, by_local: NDArray) -> Prediction:
        """Return the prediction with the rows of prior knowledge; without derivatives by shared unknowns if none are
        given."""
        residual, rows, slopes = np.empty(0), np.empty((0, 0)), np.empty((*values.shape, 0))
        if by_shared is not None:
            (residual, rows), slopes = self._known_rows(shared), by_shared
        return Prediction(values, slopes, by_local, residual, rows, self._shared_known, self._local_known)

    @property
    def shared_size(self) -> int:
        """Number of shared unknowns G."""
        return max(part.stop for part in self.layout.values())

    def embedded(self, shared: NDArray, model: Self) -> NDArray:
        """Return shared unknowns of this model in the layout of another model; zero for those that this model lacks."""
        wide = np.zeros(model.shared_size)
        if len(shared):
            for name in self.layout.keys() & model.layout.keys():
                wide[model.layout[name]] = shared[self.layout[name]]
        return wide

    def effects(self, shared: NDArray) -> tuple[Effect[CauseT], ...]:
        """Return the effects with their values, SI, at shared unknowns (G,)."""
        return tuple(Effect(cause, shared[self.layout[cause.key]] * self.effect_sigma(cause)) for cause in self.causes)

    def set_effects(self, shared: NDArray, effects: Iterable[Effect[CauseT]]) -> None:
        """Write the values of effects into the shared unknowns (G,), in place."""
        for effect in effects:
            shared[self.layout[effect.cause.key]] = effect.values / self.effect_sigma(effect.cause)

    @abstractmethod
    def design_matrix(self, shared: NDArray, local: NDArray) -> Callable[[CauseT], dict[str, NDArray]]:
        """Return the function from a cause to its change of each pathway (B, C_i, P) per plausible scale."""

    def partial_designs(
        self, shared: NDArray, local: NDArray
    ) -> Callable[[CauseT], Mapping[str, NDArray | PartialDesign]]:
        """Return the same function, for candidates; its designs may hold only the places that move."""
        return self.design_matrix(shared, local)

    def effect_scale(self, cause: CauseT) -> NDArray:
        """Return the plausible scale (P,) of a cause's parameters, SI."""
        return np.array([parameter.scale for parameter in cause.parameters(self.part_count)])

    def effect_sigma(self, cause: CauseT) -> NDArray:
        """Return the prior sigma (P,) in the fit of a cause's parameters, SI: ``reach`` times the plausible scale."""
        return cause.reach * self.effect_scale(cause)


def consecutive_slices(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Return consecutive slices of the given sizes."""
    ends = np.cumsum(list(sizes.values())).tolist()
    return {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}


class ChannelModel(EffectsModel[CauseT]):
    """Model of channels with one dimension and no position: readings, or camera and scale-bar parameters.

    Causes act directly on the observations.
    """

    @property
    def local_size(self) -> int:
        """Number of local unknowns H: none."""
        return 0

    @property
    def unpredicted(self) -> NDArray:
        """Mask (H,) of the local unknowns that the model does not predict: none."""
        return np.zeros(self.local_size, bool)

    @property
    def channel_groups(self) -> NDArray:
        """Noise group (K,) of each channel: one for all.

        A single channel has too few readings to distinguish its noise from an effect on most of them.
        """
        return np.zeros(len(self.channel_names), int)

    @abstractmethod
    def points(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return the predicted channels (B, K, 1) at shared (G,) and local (B, H) unknowns."""

    @abstractmethod
    def _slopes_at(self, shared: NDArray, local: NDArray) -> Callable[[CauseT, NDArray], NDArray]:
        """Return the function from a cause and values (P,), SI, to the derivative of the channels (B, K, P)."""

    def rotations(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return the derivatives (B, K, 1, 1) of the observations by shifts of the channels: one."""
        return np.ones((len(local), len(self.channel_names), 1, 1))

    def pathways(self, shared: NDArray, local: NDArray) -> dict[str, NDArray]:
        """Return the derivatives of the observations by pathway: none; causes act on the observations directly."""
        return {}

    def design_matrix(self, shared: NDArray, local: NDArray) -> Callable[[CauseT], dict[str, NDArray]]:
        """Return the function from a cause to its change of the pathway ``observed`` (B, K, P) per plausible scale."""
        slopes = self._slopes_at(shared, local)

        def found(cause: CauseT) -> dict[str, NDArray]:
            scale = self.effect_scale(cause)
            return {OBSERVED: slopes(cause, np.zeros(len(scale))) * scale}

        return found

    def _fill_effects(
        self,
        by_shared: NDArray,
        shared: NDArray,
        slopes: Callable[[CauseT, NDArray], NDArray],
        first: int = 0,
    ) -> None:
        """Fill the derivatives (B, K, G - first) by the parameters of effects, given the function ``slopes``; without
        those of the first shared unknowns."""
        for effect in self.effects(shared):
            columns = self.layout[effect.cause.key]
            derivative = slopes(effect.cause, effect.values) * self.effect_sigma(effect.cause)
            by_shared[..., columns.start - first : columns.stop - first] = derivative
