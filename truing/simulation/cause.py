"""Base class `Cause`: a physical effect that the plain simulation lacks, acting on one step of the chain.

A subclass defines an id, parameters and the derivative of the state by them. The test, the fit, the entry in model.toml
and the row in the tables follow from these.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from truing.simulation.inputs import Missing

if TYPE_CHECKING:
    from truing.inference.model import ChannelCandidates, Onsets, ScatterCandidate


# Name of the pathway of causes that act directly on the observations; see `truing.inference.model`.
OBSERVED = "observed"


class Step(StrEnum):
    """Step of the simulated chain at which a cause acts."""

    DRIVE = "drive"
    STRUCTURE = "structure"
    INSTRUMENT = "instrument"


@dataclass(frozen=True)
class Parameter:
    """Parameter of a cause: name and unit as in the tables, and one sigma of a plausible size, SI.

    ``si`` is the SI value of one unit of the tables (1e-3 for mm).
    """

    name: str
    unit: str
    scale: float
    si: float = 1.0


@dataclass(frozen=True)
class ReportedParameter:
    """Value of a parameter in the unit of the tables; ``sigma`` is None for text and counts."""

    name: str
    value: float | str
    sigma: float | None
    unit: str


SceneT_contra = TypeVar("SceneT_contra", bound="Scene[Any]", contravariant=True)
CauseT = TypeVar("CauseT", bound="Cause[Any]")


@dataclass(frozen=True)
class Scene(Generic[CauseT]):
    """Inputs, geometry and visibility of a campaign, from which causes of one sort propose candidates.

    ``is_observed`` (B, K) marks the observations that exist; None means all. General code calls the methods of the
    scene, which passes itself to the cause: thus a cause only meets scenes of its own sort.
    """

    is_observed: NDArray | None = field(default=None, kw_only=True)

    @property
    def inputs(self) -> Mapping[str, NDArray]:
        """Commanded inputs (B,) by column name; empty if nothing was commanded."""
        return {}

    @property
    def histories(self) -> Mapping[str, NDArray]:
        """History (B, m) of inputs by name, from all rows of the campaign; empty where only these rows are known."""
        return {}

    def with_observed(self, is_observed: NDArray) -> Self:
        """Return the scene with the mask ``is_observed`` (B, K) of existing observations."""
        return replace(self, is_observed=is_observed)

    def candidates(self, kind: CauseT) -> Sequence[CauseT]:
        """Return the candidates of a kind of cause that are worth testing."""
        return kind.candidates(self)

    def channel_candidates(self, kind: CauseT) -> Sequence[ChannelCandidates[CauseT]]:
        """Return the candidates of a kind that concern single channels."""
        return kind.channel_candidates(self)

    def onsets(self, cause: CauseT) -> Onsets[CauseT] | None:
        """Return the onsets that a cause can have; None where it has no free onset."""
        return cause.onsets(self)

    def higher_order_terms(self, cause: CauseT) -> Sequence[CauseT]:
        """Return the causes that add higher-order terms to an accepted cause."""
        return cause.higher_order_terms(self)

    def prior(self, cause: CauseT) -> float:
        """Return the relative prior weight of a candidate within its kind."""
        return cause.prior(self)

    def scatters(self, kind: CauseT) -> Sequence[ScatterCandidate[CauseT]]:
        """Return the candidates of a kind that enlarge the scatter of inputs or observations."""
        return kind.scatters(self)

    def single_errors(self, kind: CauseT) -> Sequence[ScatterCandidate[CauseT]]:
        """Return the inputs whose errors may be mostly small and sometimes large."""
        return kind.single_errors(self)


@dataclass(frozen=True)
class ChannelScene(Scene[CauseT]):
    """Scene of causes that act on channels without a position: readings, or camera and scale-bar parameters."""

    @property
    def size(self) -> tuple[int, int]:
        """Number of epochs B and of channels K."""
        raise NotImplementedError

    @property
    def shape(self) -> NDArray:
        """Positions (K, 0) of the channels: channels have none."""
        return np.zeros((self.size[1], 0))

    @property
    def recorded(self) -> NDArray:
        """Mask (B, K) of the existing readings: ``is_observed``, or all."""
        return np.ones(self.size, bool) if self.is_observed is None else self.is_observed


@dataclass(frozen=True)
class Cause(Generic[SceneT_contra]):
    """Physical effect that the plain simulation lacks; each kind of cause is a frozen dataclass.

    The fields of an instance are its settings, such as leg, onset or pitch. model.toml keeps them with the values of
    the parameters. The instance with default settings represents the kind in the catalogue and proposes candidates.
    Causes of one sort share a base class (`PointCause`, `ReadingCause`, ...), which defines the quantities that they
    change.

    ``share`` is the weight of the kind in the budget of false alarms and in the prior probabilities.
    """

    id: ClassVar[str]
    step: ClassVar[Step]
    share: ClassVar[float] = 1.0
    reach: ClassVar[float] = 10.0  # prior sigma of its fit in plausible scales; wide, to avoid shrinkage
    catalogued: ClassVar[bool] = True  # False: a nonparametric effect
    has_known_scale: ClassVar[bool] = False  # True: its parameters are properties of materials, whose range is known
    recurs: ClassVar[bool] = False  # True: a sudden change that a part may well show several times in one campaign
    assumes: ClassVar[str] = ""  # what its size rests on, such as declared weights
    denies: ClassVar[str] = ""  # what it contradicts of what others assume
    plain_id: ClassVar[str] = ""  # id of the plainer cause whose place it takes for the same subject
    lacking: ClassVar[Missing | None] = None  # input without which it has no candidates

    @property
    def says(self) -> str:
        """Words after "The data show that ..."; only for a lab's own cause: the catalogue is worded in
        truing/report/wordings."""
        return ""

    @property
    def confirm(self) -> str:
        """Measurement that would confirm the cause; only for a lab's own cause."""
        return ""

    @property
    def subject(self) -> str:
        """Leg, target or axis that the cause concerns, as in the tables (``leg3``, ``target P07``); empty for the whole
        machine."""
        return ""

    @property
    def affected_part(self) -> str:
        """Subject that an effect without a name in its place would have: for most causes, their own."""
        return self.subject

    @property
    def concerns_several(self) -> bool:
        """True if the subject lists several legs or targets by name."""
        return False

    @cached_property
    def key(self) -> str:
        """Unique name of the candidate: id and settings."""
        text = " ".join(f"{name}={value}" for name, value in self.settings().items())
        return f"{self.id} {text}".strip()

    @property
    def family(self) -> str:
        """Key of the family of mutually exclusive forms; a model holds at most one of them."""
        return self.key

    @property
    def is_higher_order(self) -> bool:
        """True if this adds higher-order terms to a cause that must be accepted first."""
        return False

    @property
    def has_law(self) -> bool:
        """True if the cause claims a law; False if it only claims which input something follows."""
        return True

    @property
    def is_assumed(self) -> bool:
        """True if the cause assumes a quantity that was not declared, and fits no deviation of it."""
        return False

    @property
    def has_set_shape(self) -> bool:
        """True if the machine sets its shape, such as one period a turn; False if it was searched among many."""
        return False

    @property
    def shifts_with_others(self) -> bool:
        """True if its best shape, such as a period, may be another one next to other causes."""
        return False

    @property
    def is_persistent(self) -> bool:
        """True if the effect stays with the machine; False if it depends on the time or the targets of one campaign."""
        return True

    def excludes(self, other: Self) -> bool:
        """True if a model that holds this cause cannot also hold the other: both are forms of one family."""
        return self.family == other.family

    def settings(self) -> dict[str, object]:
        """Return the fields of the cause by name, as model.toml keeps them."""
        return {name: getattr(self, name) for name in _names_of_fields(type(self))}

    def with_settings(self, **settings: Any) -> Self:
        """Return the cause with settings read from TOML, where tuples are lists."""
        return replace(self, **{key: tuple(v) if isinstance(v, list) else v for key, v in settings.items()})

    def covers(self, covariates: Mapping[str, NDArray], poses: int) -> NDArray:
        """Return the mask (B,) of poses where the cause is valid; all, unless its form holds only within a range of
        inputs."""
        return np.ones(poses, bool)

    def candidates(self, scene: SceneT_contra) -> Sequence[Self]:
        """Return the candidates worth testing in a campaign; none if the effect could not show in it."""
        return (self,)

    def missing_input(self, scene: SceneT_contra) -> Missing | None:
        """Return the input that was not recorded or varied, if that is why the campaign has no candidates of this kind.

        None if there is another reason, for example a machine to which the cause does not apply.
        """
        return self.lacking

    def shared_with(self, scene: SceneT_contra) -> Mapping[str, object]:
        """Return the other subjects (``alike``) to which the effect may belong, because the same effect there changes
        all predictions equally, and why; empty for most causes."""
        return {}

    def channel_candidates(self, scene: SceneT_contra) -> Sequence[ChannelCandidates[Self]]:
        """Return candidates for single targets or channels, scored together because they are many; none for most
        causes."""
        return ()

    def scatters(self, scene: SceneT_contra) -> Sequence[ScatterCandidate[Self]]:
        """Return candidates that enlarge the scatter of inputs or observations without moving their mean; none for most
        causes."""
        return ()

    def single_errors(self, scene: SceneT_contra) -> Sequence[ScatterCandidate[Self]]:
        """Return single inputs, at all epochs, whose errors may be mostly small and sometimes large; none for most
        causes."""
        return ()

    def onsets(self, scene: SceneT_contra) -> Onsets[Self] | None:
        """Return the onsets that it can have, of which `candidates` are every few; None without a free onset."""
        return None

    def higher_order_terms(self, scene: SceneT_contra) -> Sequence[Self]:
        """Return the causes that add higher-order terms to this one after its acceptance.

        They share the prior probability of their kind with its other forms.
        """
        return ()

    def prior(self, scene: SceneT_contra) -> float:
        """Return the relative prior weight of this candidate within its kind; 1 if all are equally probable."""
        return 1.0

    def like_sized(self, legs: int) -> tuple[int, ...]:
        """Return the positions of parameters of like size, such as those of legs of one design; empty if there are
        none."""
        return ()

    def one_sided(self, legs: int) -> tuple[int, ...]:
        """Return the positions of parameters that cannot be negative, such as a clearance or a loss; empty if there are
        none."""
        return ()

    def inputs(self, legs: int) -> tuple[str, ...]:
        """Return the input columns that a nonparametric effect depends on; empty for a cause of the catalogue."""
        return ()

    @property
    def moved_quantity(self) -> str:
        """Quantity of the subject that a nonparametric effect changes; empty where it has only one."""
        return ""

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the columns of configurations, except the readings, that a prediction needs."""
        return self.inputs(legs)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the parameters for a mechanism with ``legs`` legs; empty for a discrete cause."""
        raise NotImplementedError

    def refined(self) -> Self:
        """Return the form that is fitted after selection, with its shape (pitch, time constant) among the parameters.

        The parameters of this form come first; the added ones start from zero.
        """
        return self

    def with_fixed_shape(self, shape: NDArray) -> Self | None:
        """Return the form with its shape fixed at values (P - p,) of the parameters that `refined` adds.

        It serves to find the uncertainty of a shape that acts far from linearly; None if linearisation suffices.
        """
        return None

    def narrowed(self, values: NDArray, covariance: NDArray, legs: int) -> Self:
        """Return the fitted cause without parts whose parameters are clearly zero, from values (P,) and covariance (P,
        P), SI.

        A large effect may need such parts while it is selected, because linearised effects only approximate it.
        """
        return self

    def is_distinct(self, values: NDArray, covariance: NDArray) -> bool:
        """True if what distinguishes it from a plainer cause (`plain_id`) is clear in values (P,) and covariance (P,
        P), SI, of the fitted form."""
        return True

    def with_known_part(self, values: NDArray) -> NDArray:
        """Return the values (P,), SI, with the part that was known before the fit."""
        return values

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the parameters in the units of the tables, from values (P,) and covariance (P, P), SI."""
        sigma = np.sqrt(np.diag(covariance))
        named = zip(self.parameters(legs), values, sigma, strict=True)
        return tuple(ReportedParameter(p.name, float(v / p.si), float(s / p.si), p.unit) for p, v, s in named)


_FIELDS: dict[type, tuple[str, ...]] = {}  # names by class: thousands of candidates are asked for their settings


def _names_of_fields(kind: type[Cause[Any]]) -> tuple[str, ...]:
    if kind not in _FIELDS:
        _FIELDS[kind] = tuple(own.name for own in fields(kind))
    return _FIELDS[kind]


@dataclass(frozen=True)
class Effect(Generic[CauseT]):
    """A cause with the values of its parameters, SI."""

    cause: CauseT
    values: NDArray  # (P,)
