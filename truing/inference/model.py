"""Protocols of a model that can be fitted and to which causes can be added."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from truing.inference.arrays import Array, Integers, Mask

# Pathway of causes that act on the observations themselves; its motions are the identity.
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
    """Properties of a cause that inference uses. Causes of one sort belong to one sort of model; `SceneLike` proposes
    candidates."""

    @property
    def id(self) -> str:
        """Name of its kind."""

    @property
    def key(self) -> str:
        """Name that identifies this candidate among all others."""

    @property
    def share(self) -> float:
        """Weight of its kind in the budget of false alarms and in the prior probabilities."""

    @property
    def catalogued(self) -> bool:
        """True if its form is in the catalogue; otherwise it is a nonparametric effect."""

    @property
    def subject(self) -> str:
        """Name in the tables of the thing it concerns; empty for the whole."""

    @property
    def affected_part(self) -> str:
        """Subject that an effect without a name in its place would have."""

    @property
    def concerns_several(self) -> bool:
        """True if it concerns several things, named one by one."""

    @property
    def is_higher_order(self) -> bool:
        """True if this adds higher-order terms to a cause that must be accepted first."""

    @property
    def is_persistent(self) -> bool:
        """True if the effect stays with the machine; False if it ends with the campaign, as drifts do."""

    @property
    def has_law(self) -> bool:
        """True if it claims a law; False if it only claims which input something follows."""

    @property
    def is_assumed(self) -> bool:
        """True if it assumes a quantity that was not declared, and fits no deviation of it."""

    @property
    def recurs(self) -> bool:
        """True for a sudden change that a part may well show several times in one campaign."""

    @property
    def plain_id(self) -> str:
        """Id of the plainer cause whose place it takes for the same subject; empty for most causes."""

    @property
    def assumes(self) -> str:
        """Declared values on which its size depends, such as weights; empty for most causes."""

    @property
    def denies(self) -> str:
        """Assumption of other causes that it contradicts; empty for most causes."""

    @property
    def has_set_shape(self) -> bool:
        """True if the machine sets its shape, so that it was not searched among many."""

    @property
    def shifts_with_others(self) -> bool:
        """True if its best shape, such as a period, may be another one next to other causes."""

    @property
    def has_known_scale(self) -> bool:
        """True if its parameters are properties of materials, hardly larger than their plausible scales."""

    def excludes(self, other: Self, /) -> bool:
        """True if a model that holds this cause cannot take up another."""

    def parameters(self, parts: int, /) -> Sequence[ParameterLike]:
        """Return the parameters for a number of like parts."""

    def like_sized(self, parts: int, /) -> Sequence[int]:
        """Return the positions of parameters of like size."""

    def one_sided(self, parts: int, /) -> Sequence[int]:
        """Return the positions of parameters that cannot be negative."""

    def inputs(self, parts: int, /) -> tuple[str, ...]:
        """Return the input columns that a nonparametric effect depends on; empty for a cause of the catalogue."""

    @property
    def moved_quantity(self) -> str:
        """Quantity of the subject that a nonparametric effect changes; empty where it has only one."""

    def refined(self) -> Self:
        """Return the form that is fitted once it is chosen, with its shape among the parameters."""

    def with_fixed_shape(self, shape: Array, /) -> Self | None:
        """Return the form with its shape held fixed; None where the shape needs no check."""

    def narrowed(self, values: Array, covariance: Array, parts: int, /) -> Self:
        """Return the cause, after a fit, without the parts that clearly have no effect."""

    def is_distinct(self, values: Array, covariance: Array, /) -> bool:
        """True if fitted values clearly distinguish it from the plainer cause whose place it takes."""

    def with_known_part(self, values: Array, /) -> Array:
        """Return fitted values (P,) with the part that was known before the fit."""

    def covers(self, covariates: Mapping[str, Array], epochs: int, /) -> Mask:
        """Return True for the epochs (B,) at which the cause claims to hold."""


CauseT = TypeVar("CauseT", bound=CauseLike)


class ConditionsLike(Protocol):
    """Known conditions of some epochs: all that a model needs there."""

    @property
    def covariates(self) -> Mapping[str, Array]:
        """Columns (B,) or (B, L), by name."""


ConditionsT = TypeVar("ConditionsT", bound=ConditionsLike)
ConditionsT_co = TypeVar("ConditionsT_co", bound=ConditionsLike, covariant=True)
ConditionsT_contra = TypeVar("ConditionsT_contra", bound=ConditionsLike, contravariant=True)


@dataclass(frozen=True)
class ChannelCandidates(Generic[CauseT]):
    """Candidates that each shift one of T channels, along the axes of its group, by one of S shapes over the epochs.

    The parameters are the shifts, d for each of m columns. The T times S candidates are scored together by their
    shapes; ``member(t, s)`` makes the cause for the t-th of ``channels`` and shape s. With ``patterns`` each candidate
    shifts n channels together, and has q parameters per column.
    """

    values: Array  # (S, B, m) dimensionless factors of a shift
    channels: Integers  # (T,) places of the channels; (T, n) with patterns
    usable: Mask  # (S, T) True where the channel was seen often enough for the shape
    scale: float  # one sigma of a plausible shift, SI
    member: Callable[[int, int], CauseT]
    patterns: Array | None = None  # (T, n, d, q) shifts relative to a plausible one


@dataclass(frozen=True)
class ScatterCandidate(Generic[CauseT]):
    """A cause with zero mean effect that makes the inputs or observations marked by ``own`` (B, C) scatter more than
    others."""

    cause: CauseT
    own: Mask
    of_inputs: bool


@dataclass(frozen=True)
class Onsets(Generic[CauseT]):
    """Onsets that a cause can have: epochs (n,) in order of time, of which the campaign's candidates have every
    ``spacing``-th.

    ``own``: epoch of its own onset; ``begun_at`` returns the same cause from another epoch on.
    """

    epochs: Integers
    spacing: int
    own: int
    begun_at: Callable[[int], CauseT]

    def moved(self, by: int) -> CauseT | None:
        """Return the cause with its onset ``by`` places later in time; None where there is no possible onset."""
        place = np.flatnonzero(self.epochs == self.own)
        moved = int(place[0]) + by if len(place) else -1
        return self.begun_at(int(self.epochs[moved])) if 0 <= moved < len(self.epochs) else None


def onsets_in_time(
    order: Array, fewest: int, spacing: int, from_order: float, begun_at: Callable[[int], CauseT]
) -> Onsets[CauseT]:
    """Return the onsets with at least ``fewest`` epochs before and from them, for a cause that acts from the rank
    ``from_order`` in time on; ``order`` (B,) ranks the epochs."""
    in_time = np.argsort(order, kind="stable")
    nearest = int(in_time[min(int(np.sum(order < from_order)), len(order) - 1)])
    return Onsets(in_time[fewest : len(in_time) - fewest + 1], spacing, nearest, begun_at)


class SceneLike(Protocol[CauseT]):
    """Candidates of one sort of cause that are worth testing in a campaign."""

    @property
    def covariates(self) -> Mapping[str, Array]:
        """Columns (B,) or (B, L) known at every epoch; of these, ``order`` ranks the epochs in time."""

    @property
    def inputs(self) -> Mapping[str, Array]:
        """Columns (B,) of the commanded values of every epoch, by name."""

    @property
    def histories(self) -> Mapping[str, Array]:
        """History (B, m) of some inputs, by name, in which epochs that the fit leaves out count too."""

    @property
    def shape(self) -> Array:
        """Places (K, 0 to 3) of the channels on their groups, m."""

    def with_observed(self, is_observed: Mask) -> Self:
        """Return the scene in which only the observations ``is_observed`` (B, K) were seen."""

    def candidates(self, kind: CauseT, /) -> Sequence[CauseT]:
        """Return the candidates of a kind worth testing."""

    def channel_candidates(self, kind: CauseT, /) -> Sequence[ChannelCandidates[CauseT]]:
        """Return the candidates over single channels, which are too many to list one by one."""

    def onsets(self, cause: CauseT, /) -> Onsets[CauseT] | None:
        """Return the onsets that a cause can have; None where it has no free onset."""

    def higher_order_terms(self, cause: CauseT, /) -> Sequence[CauseT]:
        """Return the causes that add higher-order terms to a cause."""

    def prior(self, cause: CauseT, /) -> float:
        """Return a candidate's share of the prior probability of its kind."""

    def scatters(self, kind: CauseT, /) -> Sequence[ScatterCandidate[CauseT]]:
        """Return the candidates of a kind that make inputs or observations scatter."""

    def single_errors(self, kind: CauseT, /) -> Sequence[ScatterCandidate[CauseT]]:
        """Return single inputs, at all epochs, whose errors may be mostly small and sometimes large."""


@dataclass(frozen=True)
class PartialDesign:
    """Design (B, n, P) of a candidate over the places (n,) of a pathway that it moves; all others stay."""

    places: Integers
    values: Array


@dataclass(frozen=True)
class ZeroColumns:
    """Derivatives by the first Z shared unknowns, of which each number observed follows at most one: zeros of runs.

    ``place`` (B, K) is the unknown, -1 for none; ``slope`` (B, K) the derivative by it.
    """

    size: int
    place: Integers
    slope: Array

    @property
    def acting(self) -> Mask:
        """True for unknowns that act in each epoch, (B, Z)."""
        is_nonzero = np.zeros((len(self.place), self.size + 1), bool)
        epochs = np.arange(len(self.place))[:, None]
        is_nonzero[epochs, np.where(self.slope != 0.0, self.place, self.size)] = True
        return is_nonzero[:, : self.size]

    def at(self, columns: Integers) -> Array:
        """Return the derivatives (B, K, 1, n) by unknowns (B, n), or (n,) if they are the same in all epochs; zero for
        other unknowns."""
        same = self.place[..., None] == (columns if columns.ndim == 1 else columns[:, None])
        return np.asarray((same * self.slope[..., None])[:, :, None])

    def before(self, slopes: Array) -> Array:
        """Return derivatives (B, K, 1, G) by all unknowns, from those (B, K, 1, G - Z) by the others."""
        return np.concatenate([self.at(np.arange(self.size)), slopes], -1)


class PredictionLike(Protocol):
    """Prediction of a model, with derivatives per prior sigma, and whitened rows of prior knowledge that concern no
    epoch."""

    @property
    def values(self) -> Array:
        """Observations (B, K, d), SI, in the model's frame."""

    @property
    def by_shared(self) -> Array:
        """Their derivatives (B, K, d, G) by the shared unknowns; without the first Z if there are zero columns."""

    @property
    def zero_columns(self) -> ZeroColumns | None:
        """Their derivatives by the first Z shared unknowns, if these are zeros of runs."""

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
        """True for shared unknowns (G,) whose prior is knowledge, not only a wide scale."""

    @property
    def local_known(self) -> Mask:
        """The same for local unknowns (H,)."""


class Predict(Protocol):
    """Observations as a function of unknowns, which are in standard deviations of their priors."""

    def __call__(self, shared: Array, local: Array, by_shared: bool = True) -> PredictionLike:
        """Return observations and derivatives at shared (G,) and local (B, H) unknowns; by the shared ones only if
        requested."""


@dataclass(frozen=True)
class Split:
    """Shared unknowns (P,) of like parts, split into a common part and each part's own.

    ``places`` are their indices, ``common`` marks the common ones, ``share`` is the common share of the variance.
    """

    places: Integers
    common: Mask
    share: float


@dataclass(frozen=True)
class ErrorPathway:
    """Column of a pathway along which the errors of one part act: a subject, and the scene's input that moves it.

    The subject and the input of the frame of the measurement are empty.
    """

    pathway: str
    column: int
    subject: str = ""
    input: str = ""


class Model(Protocol[CauseT]):
    """A model of observations that can take up causes of one sort, each with parameters and a design per pathway."""

    @property
    def predict(self) -> Predict:
        """Observations and their derivatives by the unknowns."""

    @property
    def layout(self) -> Mapping[str, slice]:
        """Places of each kind of shared unknown; effects by their key."""

    @property
    def survey(self) -> slice:
        """Places of the shared unknowns whose prior is the survey's noise; empty where nothing is surveyed."""

    @property
    def setup(self) -> Mask:
        """True for shared unknowns (G,) of the measurement's set-up that no prior knowledge fixes, such as the place of
        a base."""

    @property
    def local_size(self) -> int:
        """Number of local unknowns H."""

    @property
    def unpredicted(self) -> Mask:
        """True for local unknowns (H,) that the model does not claim to predict."""

    @property
    def channel_word(self) -> str:
        """Word for one channel."""

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names (K,) of the channels, as in the tables."""

    @property
    def channel_kinds(self) -> tuple[str, ...]:
        """Sort of each channel (K,), or the thing it belongs to; empty where none is known."""

    @property
    def channel_groups(self) -> Integers:
        """Number of each channel's group (K,)."""

    @property
    def part_count(self) -> int:
        """Number of like parts L, each of which has parameters of its own in some causes."""

    @property
    def zero_groups(self) -> Integers | None:
        """Number (B, K) of the zero that observations share, -1 for none; None where observations have frames."""

    @property
    def error_groups(self) -> Integers | None:
        """Number (B,) of the run whose epochs have correlated errors; None where epochs are independent."""

    @property
    def split(self) -> Split | None:
        """Shared unknowns with a common part and each part's own; None where there are none."""

    @property
    def blocks(self) -> Integers | None:
        """Numbers (B,), in time, of epochs that can be left out of a fit together.

        None where they cannot be predicted from epochs before and after.
        """

    @property
    def scene(self) -> SceneLike[CauseT]:
        """Candidates that the campaign offers."""

    def with_causes(self, causes: Sequence[CauseT], /) -> Self:
        """Return the model with these causes among its unknowns."""

    def rescaled(self, inputs: float, survey: float, /) -> Self:
        """Return the model with the noise of inputs and survey multiplied by factors."""

    @property
    def input_scale(self) -> Array:
        """Prior sigma of each input (H,), SI."""

    @property
    def error_pathways(self) -> Sequence[ErrorPathway]:
        """Directions of errors of single parts; none where no part moves the observations."""

    def with_input_factor(self, factor: Array, /) -> Self:
        """Return the model with the prior sigmas of each epoch's inputs multiplied by factors (B, H)."""

    def with_share(self, share: float, /) -> Self:
        """Return the model with another common share of the variance of like parts."""

    def embedded(self, shared: Array, model: Self, /) -> Array:
        """Return the shared unknowns of this model as those of another."""

    def pathways(self, shared: Array, local: Array) -> Mapping[str, Array]:
        """Return the derivatives (B, K, d, C) of the observations by each pathway."""

    def design_matrix(self, shared: Array, local: Array) -> Callable[[CauseT], Mapping[str, Array]]:
        """Return the function from a cause to its change (B or 1, C, P) of each pathway, per plausible scale."""

    def partial_designs(self, shared: Array, local: Array) -> Callable[[CauseT], Mapping[str, Array | PartialDesign]]:
        """Return the same function, for candidates; its designs may hold only the places that move."""

    def rotations(self, shared: Array, local: Array) -> Array:
        """Return the rotations (B, K, d, d) from the axes of the channels' groups to those of the observations."""

    def effect_sigma(self, cause: CauseT, /) -> Array:
        """Return the prior sigma (P,), SI, of a cause's parameters in the fit."""


class CampaignModel(Model[CauseT], Protocol[CauseT, ConditionsT_contra]):
    """A model that can be evaluated at other epochs of its campaign."""

    def at(self, conditions: ConditionsT_contra, /) -> Self:
        """Return the model at other epochs."""
