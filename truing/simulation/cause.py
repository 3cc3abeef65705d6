"""A cause: a way in which nature departs from the plain simulation, as one change to one step of its chain.

A subclass says what it is called, which parameters it has and how the state changes with them; its simulated effect,
derivative, test, fit, place in model.toml and the facts of its sentence follow from that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from truing.simulation.inputs import Missing

if TYPE_CHECKING:
    from truing.inference.model import ChannelCandidates, ScatterCandidate


# The pathway by which a cause acts on what is observed itself, as `truing.inference.model` calls it.
OBSERVED = "observed"


class Step(StrEnum):
    """Where in the chain a cause acts."""

    DRIVE = "drive"
    STRUCTURE = "structure"
    INSTRUMENT = "instrument"


@dataclass(frozen=True)
class Parameter:
    """A parameter of a cause: its name and unit as in the tables, how large it plausibly is (one sigma), in SI.

    ``si`` is what one unit of the tables is in SI.
    """

    name: str
    unit: str
    scale: float
    si: float = 1.0


@dataclass(frozen=True)
class ReportedParameter:
    """A parameter as the tables tell it: in its own unit; text and counts have no sigma."""

    name: str
    value: float | str
    sigma: float | None
    unit: str


SceneT_contra = TypeVar("SceneT_contra", bound="Scene[Any]", contravariant=True)
CauseT = TypeVar("CauseT", bound="Cause[Any]")


@dataclass(frozen=True)
class Scene(Generic[CauseT]):
    """What a campaign offers to causes of one sort; ``seen`` (B, K): which observations there are, all where it is
    not told.

    Whoever knows causes and scenes of any sort asks the scene, which hands itself to the cause: so a cause never meets
    a scene of another sort.
    """

    seen: NDArray | None = field(default=None, kw_only=True)

    @property
    def inputs(self) -> Mapping[str, NDArray]:
        """The columns (B,) of what was asked of the machine, by name: none where nothing was."""
        return {}

    def with_seen(self, seen: NDArray) -> Self:
        """The scene of which so many observations (B, K) were seen."""
        return replace(self, seen=seen)

    def candidates(self, kind: CauseT) -> Sequence[CauseT]:
        """Candidates of a kind worth testing."""
        return kind.candidates(self)

    def channel_candidates(self, kind: CauseT) -> Sequence[ChannelCandidates[CauseT]]:
        """Candidates over single channels."""
        return kind.channel_candidates(self)

    def higher_order_terms(self, cause: CauseT) -> Sequence[CauseT]:
        """Forms that go on where a cause ends."""
        return cause.higher_order_terms(self)

    def prior(self, cause: CauseT) -> float:
        """A candidate's share of its kind's probability beforehand."""
        return cause.prior(self)

    def scatters(self, kind: CauseT) -> Sequence[ScatterCandidate[CauseT]]:
        """Candidates of a kind that make inputs or observations scatter."""
        return kind.scatters(self)


@dataclass(frozen=True)
class ChannelScene(Scene[CauseT]):
    """What a campaign offers to causes that act on channels, which have no place: readings, or what rays tell."""

    @property
    def size(self) -> tuple[int, int]:
        """The number of epochs B and of channels K."""
        raise NotImplementedError

    @property
    def shape(self) -> NDArray:
        """The places (K, 0) of the channels: they have none."""
        return np.zeros((self.size[1], 0))

    @property
    def recorded(self) -> NDArray:
        """Which readings (B, K) there are: all, where it is not told."""
        return np.ones(self.size, bool) if self.seen is None else self.seen


@dataclass(frozen=True)
class Cause(Generic[SceneT_contra]):
    """A way in which nature departs from the plain simulation; a frozen dataclass per kind of cause.

    The fields of an instance are its settings (which legs, which onset, which pitch): together with the values of its
    parameters all that model.toml keeps. An instance without settings stands for the kind in the catalogue and
    proposes candidates. ``share`` is its weight in the budget of false alarms and among the probabilities beforehand.
    Causes of one sort have a base class of their own (`PointCause`, `ReadingCause`, ...), which says what they change.
    """

    id: ClassVar[str]
    step: ClassVar[Step]
    share: ClassVar[float] = 1.0
    reach: ClassVar[float] = 10.0  # plausible scales that its fit is held within: its prior must not shrink it
    catalogued: ClassVar[bool] = True  # False: a dependence in a form that nobody declared
    lacking: ClassVar[Missing | None] = None  # without what it has no candidates

    @property
    def says(self) -> str:
        """Return what nature does, in words that fit "The data show that ..."; of a lab's own cause alone, as those of
        the catalogue have their wording in the report."""
        return ""

    @property
    def confirm(self) -> str:
        """Return what to measure to confirm it; of a lab's own cause alone."""
        return ""

    @property
    def subject(self) -> str:
        """Return what it concerns as the tables name it (``leg3``, ``target P07``); empty for the whole."""
        return ""

    @property
    def concerns_several(self) -> bool:
        """Whether it concerns several legs or targets, named one by one, and not a single one or the whole."""
        return self.subject.startswith("targets ") or (self.subject.startswith("leg") and " " in self.subject.strip())

    @property
    def key(self) -> str:
        """Return the name that tells this candidate from all others."""
        text = " ".join(f"{name}={value}" for name, value in self.settings().items())
        return f"{self.id} {text}".strip()

    @property
    def family(self) -> str:
        """Return what this is one of several forms of: a model takes up one of them."""
        return self.key

    @property
    def is_higher_order(self) -> bool:
        """Return whether it is a further form of one that has to be accepted before."""
        return False

    @property
    def is_persistent(self) -> bool:
        """Return whether it stays with the machine; what hangs on a campaign's own time or targets ends with it."""
        return True

    def excludes(self, other: Self) -> bool:
        """Return whether a model that holds this cause has no place for another: the same in another form."""
        return self.family == other.family

    def settings(self) -> dict[str, Any]:
        """Return its fields, all that a model needs beside the parameters to know the cause again."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def with_settings(self, **settings: Any) -> Self:
        """Return the cause with settings as read from TOML, whose arrays are lists."""
        return replace(self, **{key: tuple(v) if isinstance(v, list) else v for key, v in settings.items()})

    def covers(self, covariates: Mapping[str, NDArray], poses: int) -> NDArray:
        """Return at which poses (B,) it claims to hold: everywhere, unless its form is known within a range only."""
        return np.ones(poses, bool)

    def candidates(self, scene: SceneT_contra) -> Sequence[Self]:
        """Return the candidates worth testing in a campaign; none where it could not show."""
        return (self,)

    def lacks(self, scene: SceneT_contra) -> Missing | None:
        """What was not recorded or varied, where a campaign has no candidates of this kind; None where that is no
        reason, as on a machine to which it does not apply."""
        return self.lacking

    def channel_candidates(self, scene: SceneT_contra) -> Sequence[ChannelCandidates[Self]]:
        """Return candidates over single targets, which are too many to be told one by one; none for most causes."""
        return ()

    def scatters(self, scene: SceneT_contra) -> Sequence[ScatterCandidate[Self]]:
        """Return what may scatter more than the rest by it, where it moves nothing on average; none for most causes."""
        return ()

    def higher_order_terms(self, scene: SceneT_contra) -> Sequence[Self]:
        """Return forms that go on where this one ends: what it leaves once it is accepted is as likely theirs as that
        of any other form of its kind."""
        return ()

    def prior(self, scene: SceneT_contra) -> float:
        """Return this candidate's share of its kind's probability beforehand; 1 where alike ones share evenly."""
        return 1.0

    def alike(self, legs: int) -> tuple[int, ...]:
        """Return the positions of parameters that are of like size: those of parts that were made alike; or none."""
        return ()

    def one_sided(self, legs: int) -> tuple[int, ...]:
        """Return the positions of parameters that nature makes no less than zero: a gap, a loss; or none."""
        return ()

    def inputs(self, legs: int) -> tuple[str, ...]:
        """Return the columns that it follows where it is no cause of the catalogue; else none."""
        return ()

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the columns of configurations, beside the readings, without which it cannot be predicted."""
        return self.inputs(legs)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the parameters for a mechanism with that many legs; none for a discrete cause."""
        raise NotImplementedError

    def refined(self) -> Self:
        """Return the form that is fitted once it is chosen, with its shape (pitch, time constant) among the parameters.

        The first parameters are those of this form; further ones start from zero.
        """
        return self

    def with_fixed_shape(self, shape: NDArray) -> Self | None:
        """Return the form with its shape held where the further parameters (P - p,) of a refined one have it.

        By it is asked how surely data tell a shape that is far from linear; None where that need not be asked.
        """
        return None

    def narrowed(self, values: NDArray, covariance: NDArray, legs: int) -> Self:
        """Return the cause without the parts that clearly do nothing once it is fitted, from values (P,) and covariance
        (P, P) in SI: where an effect is large, what is linear in it only nearly needs them to be chosen."""
        return self

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the parameters as the tables name them, from values (P,) and covariance (P, P) in SI."""
        sigma = np.sqrt(np.diag(covariance))
        named = zip(self.parameters(legs), values, sigma, strict=True)
        return tuple(ReportedParameter(p.name, float(v / p.si), float(s / p.si), p.unit) for p, v, s in named)


@dataclass(frozen=True)
class Effect(Generic[CauseT]):
    """A cause with the values of its parameters, in their units' SI form."""

    cause: CauseT
    values: NDArray  # (P,)
