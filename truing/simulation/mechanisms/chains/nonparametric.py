"""Nonparametric effects on a chain: a joint's motion, or the place of a link or the base, depends smoothly on inputs.

The length of a link may depend on time: heat of motors that no recorded temperature shows. Its course alone resembles a
joint that jumps or a target that moves.

A joint may also depend on two readings, or on the load of weight on it. It may follow an input with the sign of its
direction of approach, as a delay follows the speed; or its own history, as friction remembers turning points.

Beyond the inputs at which nearly all poses were measured a dependence is held at its value there. Few poses outside
determine no curve, and a continued one would predict other poses worse than none.
A dependence of exactly the form of a catalogued cause is no candidate, because data could not distinguish the two.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from truing.inference.model import ScatterCandidate
from truing.simulation.cause import Parameter, Step
from truing.simulation.inputs import MEMORY, ORDER, STOPS, TIME, middle_and_half, varying_columns
from truing.simulation.mechanisms.chains.causes import ChainCause, ChainScene
from truing.simulation.mechanisms.chains.conditions import ChainInputs, usual_range
from truing.simulation.mechanisms.chains.link_causes import LinkGrowth, lengths_of_links
from truing.simulation.nonparametric import (
    PER_FUNCTION,
    POLYNOMIAL,
    SETTLINGS,
    WAVES,
    Dependence,
    NonparametricEffect,
    chebyshev,
    dependence,
)

BASE = "base"
# Smooth function of two readings, and of stop operators of the joint's own reading.
SURFACE, HISTORY = "surface", "history"
# Prior weights of friction with memory, and of each form of a joint's own reading, relative to another form. Next to
# some sixty other forms of a joint, its own place and its previous movements have about a fifth of the whole each.
_OF_HISTORY, _OF_PLACE = 25.0, 6.0
_MM = 1e-3
_PLAUSIBLE_RAD, _PLAUSIBLE_M = 3e-4, 2e-4
_SMOOTH, _WAVES_OF_TIME, _WAVES_OF_TRAVEL = (1, 2, 3), (2, 4, 8), (4, 8)
_BEYOND_COMPLIANCE = (2, 3)  # in proportion to its load a joint is compliant
_LEAST_SCATTER = 0.3  # of a column's root mean square: a constant explains the other 91 % of its squares
# Degrees in the two inputs of a surface's terms, by their sum; all of sum 2, or of sum 3.
_TERMS = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))
_SURFACES = 5, 9
_OF_BASE = ("x", "y", "z", "turn_x", "turn_y", "turn_z")


@dataclass(frozen=True)
class NonparametricChainEffect(NonparametricEffect[ChainScene], ChainCause):
    """The motion of one joint, or the place of the base, depends on columns of the configurations, or on a product of
    two.

    With a ``link`` it is the place of that measured link in its own frame, such as a tool on its flange. With
    ``length_of`` a link it is the length of that one.
    """

    joint: str = ""
    is_angle: bool = True
    link: str = ""
    length_of: str = ""

    reach = 10.0
    boundless = frozenset({POLYNOMIAL, WAVES, SURFACE, HISTORY, *SETTLINGS})
    letters = NonparametricEffect.letters | {SURFACE: "term", HISTORY: "stop"}

    @property
    def step(self) -> Step:  # type: ignore[override]
        """A joint's deviation belongs to the drive, that of a link to the structure, that of the base to the
        instrument."""
        return Step.DRIVE if self.joint else Step.STRUCTURE if self.link or self.length_of else Step.INSTRUMENT

    @property
    def subject(self) -> str:
        """The joint or the link; empty for the base."""
        link = self.link or self.length_of
        return f"joint {self.joint}" if self.joint else f"link {link}" if link else ""

    @property
    def is_of_own_place(self) -> bool:
        """True if the motion of a joint depends on the reading of the same joint alone, without its history."""
        columns = [column.rpartition("_")[0] for column in self.columns]
        return bool(self.joint) and columns == [self.joint] and self.form != HISTORY

    def prior(self, scene: ChainScene) -> float:
        """Return the relative prior weight: larger of friction, and of the joint's own place."""
        if self.form == HISTORY:
            return _OF_HISTORY
        machine = scene.inputs_of_machine
        column = self.joint and machine.conditions.columns[machine.tree.readings.index(self.joint)]
        return _OF_PLACE if self.columns == (column,) else super().prior(scene)

    def shared_with(self, scene: ChainScene) -> Mapping[str, object]:
        """Return the links to which a length may also belong, and the joints between, which do not turn it."""
        return LinkGrowth(link=self.length_of).shared_with(scene) if self.length_of else {}

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the columns, except times and what follows from the readings, that a prediction needs."""
        return tuple(column for column in self.columns if column not in (TIME, ORDER, *self._own_columns))

    @property
    def _own_columns(self) -> tuple[str, str]:
        """Names of the load of weight on the joint, and of its direction of approach, as among the inputs."""
        return load_column(self.joint, self.is_angle), f"approach_{self.joint}"

    def candidates(self, scene: ChainScene) -> Sequence[NonparametricChainEffect]:
        """Return all dependences of all joints that moved, of measured links and of the base, for which there are
        enough poses."""
        machine = scene.inputs_of_machine
        columns = varying_columns(scene.covariates)
        other_columns = {name: values for name, values in columns.items() if name not in machine.conditions.columns}
        result: list[NonparametricChainEffect] = []
        for k, name in enumerate(machine.tree.readings):
            if machine.moved[k]:
                joint = machine.conditions.columns[k]
                bare = replace(self, joint=name, is_angle=bool(machine.tree.is_revolute[k]))
                result += self._of(bare, _of_joint(columns, joint), columns, len(machine.readings))
                read = [column for column in machine.conditions.columns if column in columns]
                result += self._of(bare, _of_two(read), columns, len(machine.readings))
                if MEMORY in machine.conditions.covariates:
                    result += self._of(bare, iter([((joint,), HISTORY, len(STOPS))]), columns, len(machine.readings))
                load, came = bare._own_columns
                if machine.gravity is not None and machine.load_varies(k):
                    forms = (((load,), POLYNOMIAL, degree) for degree in _BEYOND_COMPLIANCE)
                    result += self._of(bare, forms, {load: machine.torque(k)}, len(machine.readings))
                if machine.approach is not None and np.ptp(machine.approach[:, k]) > 0.0:
                    result += [replace(bare, **form) for form in _of_reversals(came, other_columns)]
        for link in ("", *_moving_links(machine)):
            result += self._of(
                replace(self, joint="", link=link),
                _of_position(other_columns, link),
                other_columns,
                len(machine.readings),
            )
        for growth in lengths_of_links(machine):
            bare = replace(self, joint="", link="", length_of=growth.link)
            result += self._of(bare, _of_length(columns), columns, len(machine.readings))
        return result

    def single_errors(self, scene: ChainScene) -> Sequence[ScatterCandidate[NonparametricChainEffect]]:
        """Return each joint whose readings have errors, in all poses."""
        machine = scene.inputs_of_machine
        return [
            ScatterCandidate(
                replace(self, joint=machine.tree.readings[k], is_angle=bool(machine.tree.is_revolute[k])),
                np.ones((len(machine.readings), 1), bool) & (machine.noisy == k),
                True,
            )
            for k in machine.noisy
        ]

    def _of(
        self,
        bare: NonparametricChainEffect,
        forms: Iterator[tuple[tuple[str, ...], str, int]],
        columns: dict[str, NDArray],
        poses: int,
    ) -> list[NonparametricChainEffect]:
        @cache  # most inputs occur in several forms
        def range_of(column: str) -> tuple[float, float]:
            values, is_time = columns[column], column in (TIME, ORDER)
            centre, half = middle_and_half(values if is_time else usual_range(values))
            return (centre, half) if half > 0.0 else middle_and_half(values)

        return [
            replace(bare, **dependence(inputs, range_of, form, degree))
            for inputs, form, degree in forms
            if poses >= PER_FUNCTION * degree
        ]

    def scaled(self, value: Callable[[str], NDArray]) -> list[NDArray]:
        """Return the inputs scaled to -1 .. 1, held at the ends beyond their ranges."""
        return [np.clip(values, -1.0, 1.0) for values in super().scaled(value)]

    @property
    def is_persistent(self) -> bool:
        """True if the effect stays with the machine; False if it depends on time or on the poses before."""
        return super().is_persistent and self.form != HISTORY

    def basis(self, value: Callable[[str], NDArray]) -> NDArray:
        """Return the values (B, m) of the basis functions at inputs (B,)."""
        if self.form != SURFACE:
            return super().basis(value)
        degree = max(sum(term) for term in _TERMS[: self.degree])
        first, second = (np.insert(chebyshev(values, degree), 0, 1.0, axis=-1) for values in self.scaled(value))
        return np.stack([first[..., i] * second[..., j] for i, j in _TERMS[: self.degree]], -1)

    def deviations(self, machine: ChainInputs) -> NDArray | None:
        """Return the functions' values as deviations of the joint; None for a link or the base."""
        if not self.joint:
            return None
        reading = machine.tree.readings.index(self.joint)
        if self.form == HISTORY:
            return machine.of_joint(reading, machine.conditions.covariates[MEMORY][:, reading])
        load, came = self._own_columns
        own = {load: machine.torque(reading)} if load in self.columns else {}
        if came in self.columns and machine.approach is not None:
            own[came] = machine.approach[:, reading]
        known = {**machine.conditions.covariates, **own}
        return machine.of_joint(reading, self.basis(lambda column: np.asarray(known[column], float)))

    def twists(self, machine: ChainInputs) -> NDArray | None:
        """Return the functions' values as motions of the link or the base; None for a joint."""
        if self.joint:
            return None
        if self.length_of:
            along = LinkGrowth(link=self.length_of).unit_growth(machine)
            return np.einsum("bm,kj->bkjm", self.basis(partial(_values_of, machine)), along)
        node = next(k for k, each in enumerate(machine.tree.nodes) if each.link == self.link) if self.link else 0
        values = self.basis(partial(_values_of, machine))
        count = values.shape[-1]
        moved = np.einsum("bm,ij->bijm", values, np.eye(6)).reshape(len(values), 6, 6 * count)
        return machine.at_node(node, moved)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return one amplitude per function, for a link or the base one of each of six motions."""
        parameters = super().parameters(legs)
        if self.joint or self.length_of:
            return parameters
        return tuple(
            replace(p, unit="rad", scale=_PLAUSIBLE_RAD, si=1.0) if p.name.startswith("turn") else p for p in parameters
        )

    @property
    def _in_key(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        length = f"length of {self.length_of}" if self.length_of else ""
        return (self.joint or (f"link {self.link}" if self.link else length or BASE),), ()

    @property
    def _amplitude(self) -> tuple[str, float, float]:
        return ("rad", 1.0, _PLAUSIBLE_RAD) if self.joint and self.is_angle else ("mm", _MM, _PLAUSIBLE_M)

    def _owners(self, legs: int) -> Sequence[str]:
        return ("",) if self.joint or self.length_of else [f"{name}_" for name in _OF_BASE]


def load_column(joint: str, is_angle: bool) -> str:
    """Name of the torque of weight about a joint, N m, or of its force along a slide, N, as an input."""
    return f"torque_{joint}_nm" if is_angle else f"force_{joint}_n"


def _of_joint(columns: dict[str, NDArray], joint_column: str) -> Iterator[tuple[tuple[str, ...], str, int]]:
    """Yield inputs, form and degree of all dependences of a joint's motion; ``joint_column`` holds its reading."""
    for column in columns:
        # In proportion to its own reading is a gain.
        yield from (((column,), POLYNOMIAL, degree) for degree in _SMOOTH if column != joint_column or degree > 1)
        if column not in (joint_column, TIME, ORDER):
            yield (column, joint_column), POLYNOMIAL, 1
    for column, counts in ((TIME, _WAVES_OF_TIME), (ORDER, _WAVES_OF_TIME), (joint_column, _WAVES_OF_TRAVEL)):
        yield from (((column,), WAVES, count) for count in counts if column in columns)
    yield from (((TIME,), form, 1) for form in SETTLINGS if TIME in columns)


def _of_reversals(came: str, columns: Mapping[str, NDArray]) -> Iterator[Dependence]:
    """Yield dependences on columns with the sign of the direction of approach, as of a delay on the speed.

    A column in which a constant leaves little is no input: its effect is that of a backlash.
    """
    for name, values in columns.items():
        size, scatter = float(np.sqrt(np.mean(values**2))), float(np.std(values))
        if scatter > _LEAST_SCATTER * size:
            largest = {came: 1.0, name: float(np.abs(values).max())}
            yield dependence((name, came), {key: (0.0, half) for key, half in largest.items()}.__getitem__)


def _of_two(readings: Sequence[str]) -> Iterator[tuple[tuple[str, ...], str, int]]:
    """Yield inputs, form and degree of all functions of two readings."""
    yield from ((pair, SURFACE, terms) for pair in combinations(readings, 2) for terms in _SURFACES)


def _moving_links(machine: ChainInputs) -> list[str]:
    """Return the measured links that move with the joints."""
    nodes, links = machine.channels.node, machine.channels.links
    moving = [
        link for node, link in zip(nodes, links, strict=True) if node > 0 and machine.tree.nodes[node].parent >= 0
    ]
    return list(dict.fromkeys(moving))


def _of_position(columns: dict[str, NDArray], link: str) -> Iterator[tuple[tuple[str, ...], str, int]]:
    """Yield inputs, form and degree of all dependences of a link's position on ``columns`` that are no readings.

    An empty name is the base.
    """
    for column in columns:
        is_time = column in (TIME, ORDER)
        # In proportion to time the base drifts.
        yield from (((column,), POLYNOMIAL, degree) for degree in _SMOOTH if link or not is_time or degree > 1)
        if is_time:
            yield from (((column,), WAVES, count) for count in _WAVES_OF_TIME)


def _of_length(columns: dict[str, NDArray]) -> Iterator[tuple[tuple[str, ...], str, int]]:
    """Yield inputs, form and degree of all dependences of a link's length on time; on temperature it grows."""
    for column in (TIME, ORDER):
        yield from (((column,), POLYNOMIAL, degree) for degree in _SMOOTH if column in columns)
    yield from (((TIME,), form, 1) for form in SETTLINGS if TIME in columns)


def _values_of(machine: ChainInputs, column: str) -> NDArray:
    return np.asarray(machine.conditions.covariates[column], float)
