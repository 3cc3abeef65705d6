"""Nonparametric effects on a mechanism or on bodies: legs, targets or the scale depend smoothly on inputs.

A dependence of exactly the form of a catalogued cause (readings proportional to the own drive: a gain) is no candidate,
because data could not distinguish the two.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import combinations
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from truing.inference.model import ChannelCandidates
from truing.simulation.cause import Step
from truing.simulation.change import Change
from truing.simulation.inputs import (
    LAST_STEP,
    LOOKING_BACK,
    MEMORY,
    ORDER,
    OWN_DRIVE,
    PER_ACTUATOR,
    RELAXING,
    STOPPED,
    TEMPERATURE,
    TIME,
    drive_of,
    middle_and_half,
    varying_columns,
)
from truing.simulation.mechanisms.causes.per_leg import choice_share, choices, legs_with_effect
from truing.simulation.mechanisms.point_causes import PointCause, PointScene
from truing.simulation.mechanisms.state import State
from truing.simulation.nonparametric import (
    PER_FUNCTION,
    POLYNOMIAL,
    WAVES,
    Dependence,
    NonparametricEffect,
    dependence,
)

ALL_DRIVES, HISTORY, RELAXATION = "all drives", "history", "relaxation"
_SMOOTH = 3  # degree of the polynomials that represent a smooth dependence
_WAVES = 6  # half periods of slow waves over a campaign
_FEWEST_SEEN = 6
_FEWEST_PATTERNED = 4
_PATTERNS = ("slope1", "slope2", "bend1", "twist", "bend2")
_MM = 1e-3


class Quantity(StrEnum):
    """Quantity that depends on the inputs."""

    READINGS = "readings"
    LENGTHS = "lengths"
    ATTACHMENTS = "attachments"
    ATTACHMENTS_SIDEWAYS = "attachments sideways"
    SCALE = "scale"
    TARGETS = "targets"


_STEPS = {Quantity.READINGS: Step.DRIVE, Quantity.SCALE: Step.INSTRUMENT}
# Quantities of one leg along one axis, with the field of the state that moves.
_ALONG = {Quantity.READINGS: "rho", Quantity.LENGTHS: "l", Quantity.ATTACHMENTS: "delta_bz"}
# Plausible amplitudes: m; relative for the scale.
_PLAUSIBLE = {Quantity.SCALE: 2e-5, Quantity.TARGETS: 2e-5}
_PLAUSIBLE_M = 5e-6
# All drives: share of the drives' half range, as that of platform-deformation-matrix, which gives the same poses. With
# a smaller scale, this rival of the matrix would lose on machines of long travel by its scale alone.
_PER_DRIVE = 0.01
_AXES = {Quantity.ATTACHMENTS_SIDEWAYS: ("_x", "_y"), Quantity.TARGETS: ("_x", "_y", "_z")}


@dataclass(frozen=True)
class NonparametricMechanismEffect(NonparametricEffect[PointScene], PointCause):
    """A quantity of all legs, of ``legs``, or of the ``targets`` of a body depends on inputs.

    Inputs are columns of the configurations, and movements of the actuators. ``rho3_mm`` is the displacement of
    actuator 3, m, and ``own drive`` that of each leg's own actuator. ``approach`` and ``last step`` are direction and
    size of its last movement, ``memory`` is the fading sum of all. The form ``all drives`` is linear in the
    displacements of all actuators; ``history`` is a sum of stop operators of each own drive: friction with memory.
    ``relaxation`` is a sum of states that follow the movements of each own drive and relax: a viscoelastic part.

    Several targets move by smooth patterns over the body if ``places`` gives two coordinates of each, from -1 to 1;
    otherwise one by one.
    """

    columns: tuple[str, ...] = (OWN_DRIVE,)
    half_ranges: tuple[float, ...] = (1e-3,)
    quantity: str = Quantity.READINGS
    legs: tuple[int, ...] = ()
    body: str = ""
    targets: tuple[str, ...] = ()
    places: tuple[float, ...] = ()

    reads = frozenset({"indicated"})
    letters: ClassVar[dict[str, str]] = {
        **NonparametricEffect.letters,
        ALL_DRIVES: "drive",
        HISTORY: "stop",
        RELAXATION: "relaxing",
    }

    def __post_init__(self) -> None:
        """Raise ValueError for an unknown quantity."""
        Quantity(self.quantity)

    @property
    def step(self) -> Step:  # type: ignore[override]
        """Step of the chain at which the quantity is changed."""
        return _STEPS.get(Quantity(self.quantity), Step.STRUCTURE)

    @property
    def subject(self) -> str:
        """Legs or target concerned, as the tables name them."""
        if len(self.targets) == 1:
            return f"target {self.targets[0]}"
        return " ".join(f"leg{leg}" for leg in self.legs)

    @property
    def moved_quantity(self) -> str:
        """Quantity that depends on the inputs."""
        return str(self.quantity)

    @property
    def is_persistent(self) -> bool:
        """True if the effect stays with the machine; False if it depends on time or on poses before, or concerns
        targets."""
        return super().is_persistent and self.quantity != Quantity.TARGETS and not self._has_states

    def candidates(self, scene: PointScene) -> Sequence[NonparametricMechanismEffect]:
        """Return all dependences of legs, bodies and the scale that a campaign could show."""
        return [NonparametricMechanismEffect(**settings) for settings in _dependences(scene)]

    def channel_candidates(self, scene: PointScene) -> Sequence[ChannelCandidates[NonparametricMechanismEffect]]:
        """Return dependences of single targets: on one function of drives and columns, and on several slow waves of
        time."""
        inputs = _Inputs(scene)
        shapes = [list(inputs.target_dependences()), list(inputs.waves())]
        return [_profiles(scene, inputs, shape) for shape in shapes if shape and len(scene.shape)]

    def higher_order_terms(self, scene: PointScene) -> Sequence[NonparametricMechanismEffect]:
        """Return the candidates with the next terms, for all legs concerned or for single ones, as far as the poses
        suffice."""
        several = self._leg_numbers(scene.legs) if self._is_of_legs and not self._has_one_subject else ()
        chosen = (self.legs, *((leg,) for leg in several))
        most = len(scene.poses) // PER_FUNCTION
        return [
            replace(term, legs=legs)
            for term in super().higher_order_terms(scene)
            if isinstance(term, NonparametricMechanismEffect) and term.degree <= most
            for legs in chosen
        ]

    def prior(self, scene: PointScene) -> float:
        """Return the relative prior weight: all legs are more probable than a single leg, a single leg than a pair."""
        return super().prior(scene) * (choice_share(len(self.legs), scene.legs) if scene.legs else 1.0)

    def inputs(self, legs: int) -> tuple[str, ...]:
        """Return the columns of the configurations that it depends on."""
        concerned = self._leg_numbers(legs)
        if self.form == ALL_DRIVES:
            return tuple(f"rho{leg}_mm" for leg in range(1, legs + 1))
        columns: list[str] = []
        for column in self.columns:
            is_actuator = column in PER_ACTUATOR
            columns += [f"rho{leg}_mm" for leg in concerned] if is_actuator else [TIME if column == ORDER else column]
        return tuple(dict.fromkeys(columns))

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the columns that a prediction of the platform needs; the time too, if it depends on previous
        movements."""
        if not self._is_of_legs:
            return ()
        looks_back = any(column in (*LOOKING_BACK, ORDER) for column in self.columns)
        return tuple(dict.fromkeys((*self.inputs(legs), *([TIME] if looks_back else []))))

    def like_sized(self, legs: int) -> tuple[int, ...]:
        """Return the amplitudes of the legs concerned; with several functions, those of the last."""
        if self.quantity not in _ALONG:
            return ()
        functions = self._count(legs)
        return tuple(range(functions - 1, len(self._leg_numbers(legs)) * functions, functions))

    def narrowed(self, values: NDArray, covariance: NDArray, legs: int) -> Self:
        """Return a dependence of several legs on their own drives without the legs of zero effect."""
        concerned = self._leg_numbers(legs)
        if self.quantity not in _ALONG or len(concerned) == 1 or not set(self.columns) & set(PER_ACTUATOR):
            return self
        leg_of = np.repeat(concerned, self._count(legs))
        return replace(self, legs=legs_with_effect(values, covariance, leg_of, self.legs, legs))

    def functions(self, state: State) -> NDArray:
        """Return the values (B, L or 1, m) of the functions at the poses of a state."""
        moved = state.indicated - state.legs.rho0
        if self.form == ALL_DRIVES:
            return np.asarray((moved / self.half_ranges[0])[:, None, :])
        if self._has_states:
            return np.stack(self.scaled(state.covariates.__getitem__), -1)
        return self.basis(lambda column: _value(column, moved, state.covariates))

    def change(self, state: State, values: NDArray) -> Change:
        """Return the derivative of the quantity by the amplitudes."""
        basis = self.functions(state)
        size = len(self.parameters(state.legs.count))
        if self.quantity == Quantity.SCALE:
            return Change({"points": state.points[..., None] * basis[:, :1, None, :]}, size)
        if self.quantity == Quantity.TARGETS:
            return Change(
                {} if state.targets is None else {"moved": self._target_derivatives(state, basis[:, 0])}, size
            )
        rows = np.eye(state.legs.count)[:, np.array(self._leg_numbers(state.legs.count)) - 1]
        derivative = rows[:, :, None] * basis[:, :, None, :]
        if self.quantity == Quantity.ATTACHMENTS_SIDEWAYS:
            sideways = derivative[:, :, None, :, None, :] * np.eye(3)[:, None, :2, None]
            return Change({"b": sideways.reshape(*sideways.shape[:3], size)}, size)
        return Change({_ALONG[Quantity(self.quantity)]: derivative.reshape(*derivative.shape[:2], size)}, size)

    def recorded(self, points: NDArray, state: State, values: NDArray) -> NDArray:
        """Return points, or their motions, (B, K, 3, ...), as an instrument with this scale records them."""
        if self.quantity != Quantity.SCALE:
            return points
        factor = 1 + self.functions(state)[:, 0] @ values
        return points * factor.reshape(-1, *([1] * (points.ndim - 1)))

    def _target_derivatives(self, state: State, basis: NDArray) -> NDArray:
        """Return the derivative of ``moved`` (B, K, 3, P), for each target or pattern, axis and function."""
        names = tuple(zip(state.targets.bodies, state.targets.names, strict=True)) if state.targets is not None else ()
        shares = _patterns(np.reshape(self.places, (-1, 2))) if self.places else np.eye(len(self.targets))
        over = np.zeros((len(names), shares.shape[1]))
        for index, target in enumerate(self.targets):
            if (self.body, target) in names:
                over[names.index((self.body, target))] = shares[index]
        moved = np.einsum("kq,ij,bm->bkiqjm", over, np.eye(3), basis)
        return moved.reshape(*moved.shape[:3], -1)

    def _leg_numbers(self, legs: int) -> tuple[int, ...]:
        return self.legs or tuple(range(1, legs + 1))

    def _count(self, legs: int) -> int:
        return legs if self.form == ALL_DRIVES else super()._count(legs)

    @property
    def _has_states(self) -> bool:
        return self.form in (HISTORY, RELAXATION)

    @property
    def _is_of_legs(self) -> bool:
        return self.quantity not in (Quantity.SCALE, Quantity.TARGETS)

    @property
    def _has_one_subject(self) -> bool:
        return len(self.legs) == 1 or len(self.targets) == 1 or self.quantity == Quantity.SCALE

    @property
    def _in_key(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        return (str(self.quantity),), (self.body, self.subject)

    @property
    def _amplitude(self) -> tuple[str, float, float]:
        unit, si = ("1", 1.0) if self.quantity == Quantity.SCALE else ("mm", _MM)
        if self.form == ALL_DRIVES:
            return unit, si, max(_PLAUSIBLE_M, _PER_DRIVE * self.half_ranges[0])
        return unit, si, _PLAUSIBLE.get(Quantity(self.quantity), _PLAUSIBLE_M)

    def _owners(self, legs: int) -> Sequence[str]:
        if self.quantity == Quantity.SCALE:
            return ("",)
        patterns = tuple(f"{self.body}_{pattern}" for pattern in _PATTERNS) if self.places else self.targets
        names = patterns or tuple(f"leg{leg}" for leg in self._leg_numbers(legs))
        return [f"{name}{axis}_" for name in names for axis in _AXES.get(Quantity(self.quantity), ("",))]


def _value(column: str, moved: NDArray, covariates: Mapping[str, NDArray]) -> NDArray:
    """Return the values (B, L or 1) of an input, from the actuators' displacements (B, L), m, and the covariates."""
    leg = drive_of(column)
    if leg is not None and leg <= moved.shape[1]:  # bodies without legs may have such a column, too
        return moved[:, leg - 1 : leg]
    if column == OWN_DRIVE:
        return moved
    value = covariates[column]
    return value if value.ndim == 2 else value[:, None]


def _patterns(positions: NDArray) -> NDArray:
    """Return smooth patterns (T, 5) over a body at positions (T, 2): two slopes, two curvatures and a twist."""
    s, t = positions.T
    return np.stack([s, t, s * s, s * t, t * t], -1)


def _dependences(scene: PointScene) -> Iterator[Dependence]:
    """Yield the settings of all dependences of legs, bodies and the scale."""
    inputs = _Inputs(scene)
    kinds: dict[Quantity, Callable[[tuple[int, ...]], Iterator[Dependence]]] = {
        Quantity.READINGS: inputs.reading_dependences,
        Quantity.LENGTHS: inputs.length_dependences,
        Quantity.ATTACHMENTS: inputs.attachment_dependences,
        Quantity.ATTACHMENTS_SIDEWAYS: inputs.sideways_attachment_dependences,
    }
    for legs in choices(scene.legs, 1) if scene.legs else []:
        for quantity, kind in kinds.items():
            yield from ({"quantity": str(quantity), "legs": legs, **settings} for settings in kind(legs))
    for legs in [chosen for chosen in choices(scene.legs, 2) if len(chosen) == 2]:
        yield from ({"quantity": "readings", "legs": legs, **column} for column in inputs.columns(1))
        if scene.lengths_apart:
            other_inputs = inputs.columns(1, apart_from=(TIME, TEMPERATURE))
            yield from ({"quantity": "lengths", "legs": legs, **settings} for settings in other_inputs)
    yield from ({"quantity": "scale", **settings} for settings in inputs.scale_dependences())
    for body in _patterned(scene) if scene.legs else ():
        yield from ({"quantity": "targets", **body, **settings} for settings in (*inputs.columns(1), *inputs.drives(1)))


class _Inputs:
    """Inputs that a campaign offers, and the dependences of each quantity on them."""

    def __init__(self, scene: PointScene) -> None:
        self._scene = scene
        self.moved = scene.readings - scene.rho0 if scene.legs else np.zeros((len(scene.poses), 0))
        self._columns = {name: v for name, v in varying_columns(scene.covariates).items() if name not in LOOKING_BACK}
        self._distinct = {name: len(np.unique(values)) for name, values in self._columns.items()}
        stroke = 0.0, float(np.abs(self.moved).max(initial=0.0)) or 1.0
        self._drives = [f"rho{leg}_mm" for leg in range(1, scene.legs + 1)]
        self._ranges = {name: middle_and_half(values) for name, values in self._columns.items()}
        self._ranges |= dict.fromkeys((*self._drives, OWN_DRIVE), stroke)

    def reading_dependences(self, legs: tuple[int, ...]) -> Iterator[Dependence]:
        """Yield dependences of readings."""
        reading_columns = tuple(f"rho{leg}_mm" for leg in legs)
        yield from self.columns(1)
        yield from self.columns(_SMOOTH)
        yield from self.waves()
        yield from (self._dependence(OWN_DRIVE, degree=2), self._dependence(OWN_DRIVE, degree=_SMOOTH))
        yield from self._gain_by_columns()
        yield from self._previous_movements()
        yield from self.drives(1, apart_from=reading_columns)
        yield from self.drives(2, apart_from=reading_columns)
        yield from self._products()
        half = (self._ranges[OWN_DRIVE][1],)
        yield {"columns": (), "centres": (), "half_ranges": half, "form": ALL_DRIVES, "degree": 1}

    def length_dependences(self, legs: tuple[int, ...]) -> Iterator[Dependence]:
        """Yield dependences of leg lengths; none if the leg itself is the actuator, since readings cover them."""
        if self._scene.lengths_apart:
            yield from self.columns(1, apart_from=(TIME, TEMPERATURE))
            yield from self.columns(_SMOOTH)
            yield from self.waves()
            yield self._dependence(OWN_DRIVE)

    def attachment_dependences(self, legs: tuple[int, ...]) -> Iterator[Dependence]:
        """Yield dependences of attachments along z."""
        yield from self.columns(1)
        yield from self.columns(_SMOOTH)
        yield from self.waves()
        yield from self._gain_by_columns()
        yield from self._squares(self._drives)
        yield from self._products()
        if not legs:
            yield from self.drives(_SMOOTH)

    def sideways_attachment_dependences(self, legs: tuple[int, ...]) -> Iterator[Dependence]:
        """Yield dependences of attachments across z."""
        yield from self.columns(1)
        yield from (self._dependence(OWN_DRIVE), self._dependence(OWN_DRIVE, degree=2))

    def scale_dependences(self) -> Iterator[Dependence]:
        """Yield dependences of the scale of the measurement."""
        yield from self.columns(1, apart_from=(TEMPERATURE,))
        yield from self.columns(_SMOOTH)
        yield from self.waves()
        yield from self.drives(1)

    def target_dependences(self) -> Iterator[Dependence]:
        """Yield dependences of a single target on one function."""
        yield from self.drives(1)
        yield from self._squares(self._drives)
        yield from self._products()
        yield from self.columns(1)
        yield from self._squares([name for name, distinct in self._distinct.items() if distinct > _SMOOTH])

    def columns(self, degree: int, apart_from: Iterable[str] = ()) -> Iterator[Dependence]:
        """Yield polynomials of a degree in every column with more distinct values than the degree."""
        for name, distinct in self._distinct.items():
            if name not in apart_from and distinct > degree:
                yield self._dependence(name, degree=degree)

    def waves(self) -> Iterator[Dependence]:
        """Yield slow waves of time, as many as the poses allow."""
        name = TIME if TIME in self._columns else ORDER
        count = min(_WAVES, len(self._scene.poses) // PER_FUNCTION)
        if name in self._columns and count > _SMOOTH:
            yield self._dependence(name, form=WAVES, degree=count)

    def drives(self, degree: int, apart_from: Iterable[str] = ()) -> Iterator[Dependence]:
        """Yield polynomials of a degree in every single drive."""
        yield from (self._dependence(drive, degree=degree) for drive in self._drives if drive not in apart_from)

    def _gain_by_columns(self) -> Iterator[Dependence]:
        """Yield the product of each leg's own drive with a column: a gain that depends on it."""
        yield from (self._dependence(OWN_DRIVE, name) for name in self._columns)

    def _previous_movements(self) -> Iterator[Dependence]:
        """Yield the last step, the memory and the friction of each actuator; its direction alone is backlash."""
        stops = self._scene.covariates.get(STOPPED[0])
        if stops is not None and np.ptp(stops) > 0 and len(stops) >= PER_FUNCTION * len(STOPPED):
            yield dependence(STOPPED, lambda _: (0.0, 1.0), HISTORY, len(STOPPED))
        relaxing = self._scene.covariates.get(RELAXING[0])
        if relaxing is not None and np.ptp(relaxing) > 0 and len(relaxing) >= PER_FUNCTION * len(RELAXING):
            yield dependence(RELAXING, lambda _: (0.0, 1.0), RELAXATION, len(RELAXING))
        for name in (LAST_STEP, MEMORY):
            steps = self._scene.covariates.get(name)
            if steps is not None and np.ptp(steps) > 0:
                half = float(np.abs(steps).max())
                yield dependence((name,), lambda _, half=half: (0.0, half))  # type: ignore[misc]

    def _squares(self, names: Iterable[str]) -> Iterator[Dependence]:
        yield from (self._dependence(name, name) for name in names)

    def _products(self) -> Iterator[Dependence]:
        yield from (self._dependence(*pair) for pair in combinations(self._drives, 2))

    def _dependence(self, *columns: str, form: str = POLYNOMIAL, degree: int = 1) -> Dependence:
        return dependence(columns, self._ranges.__getitem__, form, degree)


def _profiles(
    scene: PointScene, inputs: _Inputs, shapes: list[Dependence]
) -> ChannelCandidates[NonparametricMechanismEffect]:
    def member(target: int, shape: int) -> NonparametricMechanismEffect:
        targets = scene.targets
        whose = {"quantity": "targets", "body": targets.bodies[target], "targets": (targets.names[target],)}
        return NonparametricMechanismEffect(**(shapes[shape] | whose))

    def value(column: str) -> NDArray:
        return _value(column, inputs.moved, scene.covariates)[:, 0]

    values = np.stack([NonparametricMechanismEffect(**shape).basis(value) for shape in shapes])
    seen = np.full(len(scene.shape), len(scene.poses)) if scene.is_observed is None else scene.is_observed.sum(0)
    enough = np.broadcast_to(seen >= _FEWEST_SEEN * values.shape[-1], (len(shapes), len(scene.shape)))
    return ChannelCandidates(values, np.arange(len(scene.shape)), enough, _PLAUSIBLE[Quantity.TARGETS], member)


def _patterned(scene: PointScene) -> Iterator[Dependence]:
    """Yield the bodies, except legs, whose targets may move together, with positions along their two longest axes."""
    for body in dict.fromkeys(scene.targets.bodies):
        members = [n for n, other in enumerate(scene.targets.bodies) if other == body]
        members = [n for n in members if not scene.targets.at_attachment[n]]
        if len(members) >= _FEWEST_PATTERNED and not body.startswith("leg"):
            away = scene.shape[members] - scene.shape[members].mean(0)
            along = away @ np.linalg.svd(away, full_matrices=False)[2][:2].T
            shares = along / np.maximum(np.abs(along).max(0), 1e-9)
            names = tuple(scene.targets.names[n] for n in members)
            yield {"body": body, "targets": names, "places": tuple(float(value) for value in shares.ravel())}
