"""What a model brings to be fitted, and to take up causes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

from truing.inference.arrays import Array, Integers, Mask

# The pathway on which a cause acts on the observations themselves, whose motions are the identity.
OBSERVED = "observed"


class ParameterLike(Protocol):
    """A parameter of a cause: its name and unit as in the tables, and one sigma of a plausible size, SI."""

    @property
    def name(self) -> str: ...
    @property
    def unit(self) -> str: ...
    @property
    def scale(self) -> float: ...


class CauseLike(Protocol):
    """What is asked of a cause. Causes of one sort belong to one sort of model; `SceneLike` tells which to propose."""

    @property
    def id(self) -> str:
        """Name of its kind."""

    @property
    def key(self) -> str:
        """Name that tells it from all other candidates."""

    @property
    def share(self) -> float:
        """Weight of its kind in the budget of false alarms and among the probabilities beforehand."""

    @property
    def catalogued(self) -> bool:
        """Whether its form was declared; else it is a nonparametric effect, in a form that nobody declared."""

    @property
    def subject(self) -> str:
        """What it concerns, as tables name it; empty for the whole."""

    @property
    def concerns_several(self) -> bool:
        """Whether it concerns several things, named one by one."""

    @property
    def is_higher_order(self) -> bool:
        """Whether this adds higher-order terms to a cause that must be accepted first."""

    def excludes(self, other: Self, /) -> bool:
        """Whether a model that holds this cause has no place for another."""

    def parameters(self, parts: int, /) -> Sequence[ParameterLike]:
        """Return the parameters for so many like parts."""

    def alike(self, parts: int, /) -> Sequence[int]:
        """Return the positions of parameters that are of like size."""

    def one_sided(self, parts: int, /) -> Sequence[int]:
        """Return the positions of parameters that nature makes no less than zero."""

    def refined(self) -> Self:
        """Return the form that is fitted once it is chosen, with its shape among the parameters."""

    def with_fixed_shape(self, shape: Array, /) -> Self | None:
        """Return the form with its shape held; None where that need not be asked."""

    def narrowed(self, values: Array, covariance: Array, parts: int, /) -> Self:
        """Return the cause without the parts that clearly do nothing once it is fitted."""

    def covers(self, covariates: Mapping[str, Array], epochs: int, /) -> Mask:
        """Return at which epochs (B,) it claims to hold."""


CauseT = TypeVar("CauseT", bound=CauseLike)


class ConditionsLike(Protocol):
    """What is known of some epochs, and all that a model needs there."""

    @property
    def covariates(self) -> Mapping[str, Array]:
        """Columns (B,) or (B, L), by name."""


ConditionsT = TypeVar("ConditionsT", bound=ConditionsLike)
ConditionsT_co = TypeVar("ConditionsT_co", bound=ConditionsLike, covariant=True)
ConditionsT_contra = TypeVar("ConditionsT_contra", bound=ConditionsLike, contravariant=True)


@dataclass(frozen=True)
class ChannelCandidates(Generic[CauseT]):
    """Candidates that each shift one of T channels, along the axes of its group, by one of S shapes over the epochs.

    Their parameters are the shifts, d for each of m columns. There are as many as channels times shapes, so that they
    are scored by their shapes; ``member(t, s)`` is the cause for the t-th of ``channels`` and shape s. With
    ``patterns`` each shifts n channels together, and its parameters, q for every column, are those of the pattern.
    """

    values: Array  # (S, B, m), without dimension: what a shift is multiplied with
    channels: Integers  # (T,) places of the channels; (T, n) with patterns
    usable: Mask  # (S, T) whether that channel was seen often enough for that shape
    scale: float  # one sigma of a plausible shift, SI
    member: Callable[[int, int], CauseT]
    patterns: Array | None = None  # (T, n, d, q), shifts over a plausible one


@dataclass(frozen=True)
class ScatterCandidate(Generic[CauseT]):
    """A cause that moves nothing on average: it makes the inputs, or observations, that ``own`` (B, C) marks scatter
    more than the others."""

    cause: CauseT
    own: Mask
    of_inputs: bool


class SceneLike(Protocol[CauseT]):
    """What a campaign offers to causes of one sort: which candidates are worth testing there."""

    @property
    def covariates(self) -> Mapping[str, Array]:
        """Columns (B,) or (B, L) known at every epoch; of these, ``order`` ranks the epochs in time."""

    @property
    def inputs(self) -> Mapping[str, Array]:
        """Columns (B,) of what was asked at every epoch, by name."""

    @property
    def shape(self) -> Array:
        """Places (K, 0 to 3) of the channels on their groups, m."""

    def with_seen(self, seen: Mask) -> Self:
        """Return the scene of which so many observations (B, K) were seen."""

    def candidates(self, kind: CauseT, /) -> Sequence[CauseT]:
        """Return the candidates of a kind worth testing."""

    def channel_candidates(self, kind: CauseT, /) -> Sequence[ChannelCandidates[CauseT]]:
        """Return those over single channels, too many to be told one by one."""

    def higher_order_terms(self, cause: CauseT, /) -> Sequence[CauseT]:
        """Return the forms that go on where a cause ends."""

    def prior(self, cause: CauseT, /) -> float:
        """Return a candidate's share of its kind's probability beforehand."""

    def scatters(self, kind: CauseT, /) -> Sequence[ScatterCandidate[CauseT]]:
        """Return the candidates of a kind that make inputs or observations scatter."""


class PredictionLike(Protocol):
    """What a model predicts, with derivatives per prior sigma, and whitened rows of knowledge, which concern no
    epoch."""

    @property
    def values(self) -> Array:
        """Observations (B, K, d), SI, in the model's frame."""

    @property
    def by_shared(self) -> Array:
        """Their derivatives (B, K, d, G) by the shared unknowns."""

    @property
    def by_local(self) -> Array:
        """Their derivatives (B, K, d, H) by the local unknowns."""

    @property
    def known_residual(self) -> Array:
        """Rows (E,) of knowledge, known minus predicted."""

    @property
    def known_by_shared(self) -> Array:
        """Their derivatives (E, G)."""

    @property
    def shared_known(self) -> Mask:
        """Which shared unknowns (G,) have a prior that is knowledge, and not merely wide."""

    @property
    def local_known(self) -> Mask:
        """Which local unknowns (H,) have such a prior."""


class Predict(Protocol):
    """Observations as a function of unknowns, which are counted in standard deviations of their priors."""

    def __call__(self, shared: Array, local: Array, by_shared: bool = True) -> PredictionLike:
        """Return observations and derivatives at shared (G,) and local (B, H) unknowns; by the shared ones if asked
        for."""


@dataclass(frozen=True)
class Split:
    """Shared unknowns (P,) that split into what is common to all like parts and each part's own: their places, which of
    them are common, and the share of their variance that is."""

    places: Integers
    common: Mask
    share: float


class Model(Protocol[CauseT]):
    """A model of observations that takes up causes of one sort; each brings parameters and a design per pathway."""

    @property
    def predict(self) -> Predict:
        """Observations and their derivatives by the unknowns."""

    @property
    def layout(self) -> Mapping[str, slice]:
        """Return where each kind of shared unknown stands; effects by their key."""

    @property
    def survey(self) -> slice:
        """Return where the shared unknowns stand whose prior is the survey's noise; empty where nothing is surveyed."""

    @property
    def local_size(self) -> int:
        """Return the number of local unknowns H."""

    @property
    def unpredicted(self) -> Mask:
        """Return which local unknowns (H,) the model does not claim to predict."""

    @property
    def channel_word(self) -> str:
        """Return what one channel is called, in words."""

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Return the names (K,) of the channels, as tables have them."""

    @property
    def channel_kinds(self) -> tuple[str, ...]:
        """Return what each channel (K,) belongs to, or what sort of channel it is; none where none is told."""

    @property
    def channel_groups(self) -> Integers:
        """Return the number of each channel's group (K,)."""

    @property
    def part_count(self) -> int:
        """Return the number of like parts L, each of which has parameters of its own in some causes."""

    @property
    def zero_groups(self) -> Integers | None:
        """Return which observations (B, K) share a zero, by number, -1 for none; None where observations have
        frames."""

    @property
    def error_groups(self) -> Integers | None:
        """Return which epochs (B,) err together, by number: those of a run; None where each stands for itself."""

    @property
    def split(self) -> Split | None:
        """Return which shared unknowns split into what is common to all parts and each part's own; None where none
        do."""

    @property
    def blocks(self) -> Integers | None:
        """Return which epochs (B,) can be left out of a fit together, by number in time; None where none can be, since
        they would have to be predicted from others before and after."""

    @property
    def scene(self) -> SceneLike[CauseT]:
        """Return what the campaign offers to causes."""

    def with_causes(self, causes: Sequence[CauseT], /) -> Self:
        """Return the model with these causes among its unknowns."""

    def rescaled(self, inputs: float, survey: float, /) -> Self:
        """Return the model with the noise of inputs and survey so many times as large."""

    @property
    def input_scale(self) -> Array:
        """Return one prior sigma of each input (H,), SI."""

    def with_input_factor(self, factor: Array, /) -> Self:
        """Return the model whose inputs at each epoch have prior sigmas (B, H) so many times as large."""

    def with_share(self, share: float, /) -> Self:
        """Return the model with another share of what splits in common."""

    def embedded(self, shared: Array, model: Self, /) -> Array:
        """Return shared unknowns of this model as those of another."""

    def pathways(self, shared: Array, local: Array) -> Mapping[str, Array]:
        """Return how the observations (B, K, d, C) follow each pathway."""

    def design_matrix(self, shared: Array, local: Array) -> Callable[[CauseT], Mapping[str, Array]]:
        """Return what tells a cause's change (B or 1, C, P) of each pathway that it acts on, per plausible scale."""

    def rotations(self, shared: Array, local: Array) -> Array:
        """Return the rotations (B, K, d, d) from the axes of the channels' groups to those of the observations."""

    def effect_sigma(self, cause: CauseT, /) -> Array:
        """Return the prior sigma (P,), SI, that a cause's parameters are fitted with."""


class CampaignModel(Model[CauseT], Protocol[CauseT, ConditionsT_contra]):
    """A model that can be brought to other epochs of its campaign."""

    def at(self, conditions: ConditionsT_contra, /) -> Self:
        """Return the model at other epochs."""
