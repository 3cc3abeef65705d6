"""A cause: a way in which nature departs from the plain simulation, as one change to one step of its chain.

A subclass says what it is called, which parameters it has and how the state changes with them; its simulated effect,
derivative, test, fit, place in model.toml and the facts of its sentence follow from that.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from truing.simulation.bench.load_steps import LoadSteps
    from truing.simulation.change import Change
    from truing.simulation.mechanisms.state import State
    from truing.simulation.photographs.ray_poses import RayPoses
    from truing.simulation.targets import Targets


# The fields of the state that an effect may depend on leg by leg.
LEG_FIELDS = frozenset({"indicated", "rho", "a", "b", "u", "l", "delta_bz"})


# What a cause may act on.
POINTS, READINGS, RAYS = "points", "readings", "rays"
# The pathway by which a cause acts on what is observed itself, as `truing.inference.model` calls it.
OBSERVED = "observed"


class Step(StrEnum):
    """Where in the chain a cause acts."""

    DRIVE = "drive"
    STRUCTURE = "structure"
    INSTRUMENT = "instrument"


class Kind(StrEnum):
    """How a cause is searched for: by amplitudes alone, over a grid of shapes, or by enumeration."""

    LINEAR = "linear"
    SHAPED = "shaped"
    DISCRETE = "discrete"


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


@dataclass(frozen=True)
class Scene:
    """What a campaign offers to causes when they propose candidates; calibration poses B, legs L, targets K; m, s.

    ``covariates`` are the columns that are known at every pose, (B,) or (B, L): ``time_s``, ``temperature_c``, others,
    ``order`` (the pose's rank in time over the whole campaign) and ``approach``. ``span_s`` is the first and last time
    of the whole campaign; ``seen`` (B, K) which targets were seen, all where it is not told. ``lengths_apart`` says
    whether a leg's length is another thing than what its actuator moves. A body without mechanism has no legs.
    """

    targets: Targets
    shape: NDArray  # (K, 3) in the bodies' frames
    readings: NDArray  # (B, L)
    rho0: NDArray  # (L,)
    poses: tuple[int | str, ...]  # (B,)
    covariates: Mapping[str, NDArray] = field(default_factory=dict)
    span_s: tuple[float, float] | None = None
    reference_temperature_c: float = 20.0
    pitch_m: float | None = None
    flexure_length_m: float | None = None
    seen: NDArray | None = None  # (B, K)
    lengths_apart: bool = True
    drives: tuple[str, ...] = ()  # columns that bodies without a mechanism may deform with
    still: tuple[str, ...] = ()  # bodies without a mechanism that should stand still
    loads: LoadSteps | None = None  # of a bench that loads a sensor, whose steps stand for poses
    placed: tuple[str, ...] = ()  # bodies whose places x, y, z are known as columns, seen from another one
    word_of_target: str = "target"  # what one of the K is called: a target, a channel
    rays: RayPoses | None = None  # of photographs, in place of points
    scale_bars: tuple[str, ...] = ()  # that the points' scale was taken from
    scale_height_m: float = 0.0  # at which height that was done
    photographed: bool = False  # whether points were computed from photographs

    @property
    def legs(self) -> int:
        """Return the number of legs L."""
        return len(self.rho0)

    def varies(self, column: str) -> bool:
        """Return whether a covariate is there and takes more than one value."""
        found = self.covariates.get(column)
        return found is not None and bool(np.ptp(found) > 0)


@dataclass(frozen=True)
class ChannelCandidates:
    """Candidates that each shift one target of the bodies' surveys by one of S shapes over the poses, m columns each.

    Their parameters are the shifts x, y, z along column 1, then those along column 2. There are as many as targets
    times shapes, so that they are scored by their shapes; ``member(t, s)`` is the cause for the t-th of ``channels``
    and shape s. With ``patterns`` each moves n targets together, and its parameters, q for every column, are those of
    the pattern.
    """

    values: NDArray  # (S, B, m), without dimension: what a shift is multiplied with
    channels: NDArray  # (T,) indices into the targets; (T, n) with patterns
    usable: NDArray  # (S, T) whether that target was seen often enough for that shape
    scale: float  # m, one sigma of a plausible shift
    member: Callable[[int, int], Cause]
    patterns: NDArray | None = None  # (T, n, d, q), shifts over a plausible one


@dataclass(frozen=True)
class Cause:
    """A way in which nature departs from the plain simulation; a frozen dataclass per kind of cause.

    The fields of an instance are its settings (which legs, which onset, which pitch): together with the values of its
    parameters all that model.toml keeps. An instance without settings stands for the kind in the catalogue and
    proposes candidates. ``share`` is its weight in the budget of false alarms and among the probabilities beforehand.
    ``reads`` names the fields of the state that its effect depends on, beside covariates: what moves them moves the
    effect. One that names less than it reads has a wrong derivative; ``pose`` stands for p and R, which are found only
    after the structure's effects, so that a cause that reads it costs a few rounds. A ``moved`` target may depend on
    its own ``shape``, and on no other target's; nothing else may depend on shapes.
    """

    id: ClassVar[str]
    step: ClassVar[Step]
    kind: ClassVar[Kind] = Kind.LINEAR
    share: ClassVar[float] = 1.0
    reach: ClassVar[float] = 10.0  # plausible scales that its fit is held within: its prior must not shrink it
    acts_on: ClassVar[str] = POINTS  # of bodies in space, READINGS of a bench, or RAYS of photographs
    catalogued: ClassVar[bool] = True  # False: a dependence in a form that nobody declared
    reads: ClassVar[frozenset[str]] = LEG_FIELDS | {"shape"}

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
        told = " ".join(f"{name}={value}" for name, value in self.settings().items())
        return f"{self.id} {told}".strip()

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

    def excludes(self, other: Cause) -> bool:
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

    def candidates(self, scene: Scene) -> Sequence[Cause]:
        """Return the candidates worth testing in a campaign; none where it could not show."""
        return (self,)

    def channel_candidates(self, scene: Scene) -> Sequence[ChannelCandidates]:
        """Return candidates over single targets, which are too many to be told one by one; none for most causes."""
        return ()

    def higher_order_terms(self, scene: Scene) -> Sequence[Cause]:
        """Return forms that go on where this one ends: what it leaves once it is accepted is as likely theirs as that
        of any other form of its kind."""
        return ()

    def prior(self, scene: Scene) -> float:
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

    def change(self, state: State, values: NDArray) -> Change:
        """Return the derivative of the state's fields by the parameters at values (P,), in SI; complex-safe.

        Causes that are linear in their parameters need no values.
        """
        raise NotImplementedError

    def shift(self, state: State, values: NDArray) -> dict[str, NDArray]:
        """Return by how much the state's fields change at values (P,); for a linear cause, change times values."""
        return {name: slope @ values for name, slope in self.change(state, values).fields.items()}

    def recorded(self, points: NDArray, state: State, values: NDArray) -> NDArray:
        """Return how an instrument passes on points, or their motions, (B, K, 3, ...): linear, without offset."""
        return points

    def refined(self) -> Cause:
        """Return the form that is fitted once it is chosen, with its shape (pitch, time constant) among the parameters.

        The first parameters are those of this form; further ones start from zero.
        """
        return self

    def with_fixed_shape(self, shape: NDArray) -> Cause | None:
        """Return the form with its shape held where the further parameters (P - p,) of a refined one have it.

        By it is asked how surely data tell a shape that is far from linear; None where that need not be asked.
        """
        return None

    def narrowed(self, values: NDArray, covariance: NDArray, legs: int) -> Cause:
        """Return the cause without the parts that clearly do nothing once it is fitted, from values (P,) and covariance
        (P, P) in SI: where an effect is large, what is linear in it only nearly needs them to be chosen."""
        return self

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the parameters as the tables name them, from values (P,) and covariance (P, P) in SI."""
        sigma = np.sqrt(np.diag(covariance))
        named = zip(self.parameters(legs), values, sigma, strict=True)
        return tuple(ReportedParameter(p.name, float(v / p.si), float(s / p.si), p.unit) for p, v, s in named)


@dataclass(frozen=True)
class Effect:
    """A cause with the values of its parameters, in their units' SI form."""

    cause: Cause
    values: NDArray  # (P,)

    def apply(self, state: State) -> State:
        """Return the state as this effect leaves it."""
        return state.shifted(self.cause.shift(state, self.values))
