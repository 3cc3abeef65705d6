"""Bodies without a mechanism that are not rigid after all: what all of these have in common, and those that deform.

A pattern over the targets has no part that a motion of the body as a whole would explain: that is the body's pose. Only
a body that stands still can be seen to move as a whole.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import rigid_motions
from truing.simulation.bodies.causes.terms import (
    CAME_FROM,
    TIMES,
    counted,
    named_term,
    place_columns,
    proposed_terms,
    runs_with_time,
)
from truing.simulation.cause import Parameter, ReportedParameter, Step
from truing.simulation.change import Change
from truing.simulation.inputs import Missing
from truing.simulation.mechanisms.point_causes import PointCause, PointScene
from truing.simulation.mechanisms.state import State

_MM = 1e-3
# A plausible shift of a target over its distance from the middle of the body.
_PLAUSIBLE = 1e-4
_FEWEST = 3
# With more targets a pattern has so many parameters that only what is in proportion to something is tried.
_MANY_TARGETS = 30
_SHARE_OF_OTHERS = 0.25


@dataclass(frozen=True)
class BodyCause(PointCause):
    """What happens to the targets of one body; ``places`` are where they sit on it, m, one after the other.

    They shift by a pattern, or, with ``whole``, together with the body, which should stand still.
    """

    body: str = ""
    targets: tuple[str, ...] = ()
    places: tuple[float, ...] = ()
    whole: bool = False

    step = Step.STRUCTURE
    reads = frozenset()

    @property
    def subject(self) -> str:
        """Return the body."""
        return self.body

    def lacks(self, scene: PointScene) -> Missing | None:
        """What was not recorded; None of a mechanism, whose platform and base have causes of their own."""
        return None if scene.legs else self.lacking

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return no column: it moves no platform."""
        return ()

    @cached_property
    def _arms(self) -> NDArray:
        """Return where the targets sit (k, 3) from their middle."""
        places = np.reshape(self.places, (-1, 3))
        return np.asarray(places - places.mean(0))

    @cached_property
    def _radius(self) -> float:
        return float(np.sqrt(np.mean(np.sum(self._arms**2, -1))))

    @cached_property
    def _rigid(self) -> NDArray:
        """Return how the targets (3k, 6) follow a shift and a rotation of the body."""
        return rigid_motions(self._arms).reshape(-1, 6)

    @cached_property
    def _shape_only(self) -> NDArray:
        """Return the matrix (3k, 3k) that takes the motion as a whole out of shifts of the targets."""
        return np.eye(len(self._rigid)) - self._rigid @ np.linalg.pinv(self._rigid)

    @cached_property
    def _pattern(self) -> NDArray:
        """Return how the targets (3k, Q) follow the parameters of one function."""
        return self._rigid if self.whole else self._shape_only

    def _moved(self, state: State, functions: NDArray) -> NDArray:
        """Return the derivative of `moved` (B, K, 3, m Q) for the pattern times functions (B, m)."""
        pattern = self._pattern
        known = () if state.targets is None else tuple(zip(state.targets.bodies, state.targets.names, strict=True))
        poses, count = functions.shape
        moved = np.zeros((poses, len(known), 3, count, pattern.shape[1]), functions.dtype)
        for row, target in enumerate(self.targets):
            if (self.body, target) in known:
                own = pattern[3 * row : 3 * row + 3]
                moved[:, known.index((self.body, target))] = functions[:, None, :, None] * own[:, None, :]
        return moved.reshape(poses, len(known), 3, -1)

    def _of_pattern(self, suffix: str = "") -> tuple[Parameter, ...]:
        """Return each target's shift, or shift and turn of the body as a whole."""
        scale, whose = _PLAUSIBLE * self._radius, ("shift",) if self.whole else self.targets
        shifts = tuple(Parameter(f"{name}_{axis}{suffix}", "mm", scale, _MM) for name in whose for axis in "xyz")
        turns = tuple(Parameter(f"turn_{axis}{suffix}", "rad", _PLAUSIBLE) for axis in "xyz")
        return (*shifts, *turns) if self.whole else shifts

    def _free_of_motion(self, values: NDArray, covariance: NDArray) -> tuple[NDArray, NDArray]:
        """Return values and covariance of a pattern without the motion as a whole, which is no part of it."""
        if self.whole:
            return values, covariance
        own = np.kron(np.eye(len(values) // len(self._shape_only)), self._shape_only)
        return own @ values, own @ covariance @ own.T


@dataclass(frozen=True)
class BodyDeformation(BodyCause):
    """A body's targets shift by a pattern times columns of the campaign.

    ``terms`` are columns or products of two, as ``a*b``; ``columns`` are all that occur in them, counted from ``zeros``
    in units of ``ranges``, so that a parameter is a shift over the range that the campaign went through. ``with_time``
    says that time ran along with them: no data of the campaign tell such a deformation from a drift.
    """

    terms: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    zeros: tuple[float, ...] = ()
    ranges: tuple[float, ...] = ()
    with_time: bool = False

    id = "body-deformation"
    lacking = Missing.DRIVES

    @property
    def key(self) -> str:
        """Return the name that tells this candidate from all others."""
        return f"{self.id} {self.body} {'whole ' if self.whole else ''}{' '.join(self.terms)}"

    def candidates(self, scene: PointScene) -> Sequence[BodyDeformation]:
        """Return every body with every drive, the temperature, squares, products and directions of approach."""
        if scene.legs:
            return ()
        proposed = list(proposed_terms(scene))
        return [
            BodyDeformation(*own, whole, terms, *counted(scene, terms), runs_with_time(scene, terms))
            for own in bodies_of(scene)
            for whole in wholes(scene, own[0])
            for terms in proposed
            if terms != place_columns(own[0])
            if whole or not is_large(own[1]) or (len(terms) == 1 and TIMES not in terms[0])
        ]

    def prior(self, scene: PointScene) -> float:
        """Return the share of these terms: what is in proportion to one column is likelier than all else."""
        alone = len(self.terms) == 1 and TIMES not in self.terms[0] and not self.terms[0].startswith(CAME_FROM)
        return 1.0 if alone else _SHARE_OF_OTHERS

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return each target's shift x, y, z over the range of each term, mm."""
        if len(self.terms) == 1:
            return self._of_pattern()
        return tuple(parameter for n in range(len(self.terms)) for parameter in self._of_pattern(f"_{n + 1}"))

    def change(self, state: State, values: NDArray) -> Change:
        """Return d moved / d shift = the term's value, free of a motion of the body as a whole."""
        return Change({"moved": self._moved(state, self._functions(state))}, len(self.terms) * self._pattern.shape[1])

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the pattern, and what it follows."""
        found = super().reported(*self._free_of_motion(values, covariance), legs)
        return (*found, ReportedParameter("driver", " ".join(map(named_term, self.terms)), None, ""))

    def _functions(self, state: State) -> NDArray:
        """Return the terms' values (B, m)."""
        counted = {
            name: (np.asarray(state.covariates[name]) - zero) / span
            for name, zero, span in zip(self.columns, self.zeros, self.ranges, strict=True)
        }
        return np.stack([np.prod([counted[name] for name in term.split(TIMES)], axis=0) for term in self.terms], -1)


def bodies_of(scene: PointScene) -> Iterator[tuple[str, tuple[str, ...], tuple[float, ...]]]:
    """Yield each body with enough targets: its name, its targets, where they sit."""
    for body in dict.fromkeys(scene.targets.bodies):
        own = [n for n, other in enumerate(scene.targets.bodies) if other == body]
        if len(own) >= _FEWEST:
            yield body, tuple(scene.targets.names[n] for n in own), tuple(float(x) for x in scene.shape[own].ravel())


def is_large(targets: tuple[str, ...]) -> bool:
    return len(targets) > _MANY_TARGETS


def wholes(scene: PointScene, body: str) -> tuple[bool, ...]:
    """Return whether a body may shift as a pattern, or also as a whole."""
    return (False, True) if body in scene.still else (False,)
