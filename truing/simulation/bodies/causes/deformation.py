"""Base class `BodyCause` of causes that deform a body, and the cause `BodyDeformation` by drives or temperature.

A pattern of shifts of the targets contains no rigid motion of the body, because that would be part of its pose. Only
for a body that stands still is a motion as a whole observable.
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
    column_scaling,
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
# Plausible shift of a target, relative to its distance from the body's centre.
_PLAUSIBLE = 1e-4
_FEWEST = 3
# With more targets, a pattern has many parameters, and only proportional terms are tried.
_MANY_TARGETS = 30
_SHARE_OF_OTHERS = 0.25


@dataclass(frozen=True)
class BodyCause(PointCause):
    """Shifts of the targets of one body; ``places`` are their positions on it, m, flattened.

    They shift by a pattern or, if ``whole``, together with the body, which should stand still.
    """

    body: str = ""
    targets: tuple[str, ...] = ()
    places: tuple[float, ...] = ()
    whole: bool = False

    step = Step.STRUCTURE
    reads = frozenset()

    @property
    def subject(self) -> str:
        """Body concerned."""
        return self.body

    @property
    def has_law(self) -> bool:
        """False: a body follows an input by no known law, and is described by smooth functions of it."""
        return False

    def missing_input(self, scene: PointScene) -> Missing | None:
        """Return the input that was not recorded; None for a mechanism, whose platform and base have other causes."""
        return None if scene.legs else self.lacking

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return no column: the effect does not move the platform."""
        return ()

    @cached_property
    def _arms(self) -> NDArray:
        """Positions (k, 3) of the targets relative to their centroid."""
        positions = np.reshape(self.places, (-1, 3))
        return np.asarray(positions - positions.mean(0))

    @cached_property
    def _radius(self) -> float:
        return float(np.sqrt(np.mean(np.sum(self._arms**2, -1))))

    @cached_property
    def _rigid(self) -> NDArray:
        """Derivatives (3k, 6) of the targets by a shift and a rotation of the body."""
        return rigid_motions(self._arms).reshape(-1, 6)

    @cached_property
    def _shape_only(self) -> NDArray:
        """Matrix (3k, 3k) that removes the rigid motion from shifts of the targets."""
        return np.eye(len(self._rigid)) - self._rigid @ np.linalg.pinv(self._rigid)

    @cached_property
    def _pattern(self) -> NDArray:
        """Derivatives (3k, Q) of the targets by the parameters of one function."""
        return self._rigid if self.whole else self._shape_only

    def _derivative_of_moved(self, state: State, functions: NDArray) -> NDArray:
        """Return the derivative of `moved` (B, K, 3, m Q) for the pattern times functions (B, m)."""
        pattern = self._pattern
        known = () if state.targets is None else tuple(zip(state.targets.bodies, state.targets.names, strict=True))
        poses, count = functions.shape
        moved = np.zeros((poses, len(known), 3, count, pattern.shape[1]), functions.dtype)
        for row, target in enumerate(self.targets):
            if (self.body, target) in known:
                pattern_of_row = pattern[3 * row : 3 * row + 3]
                moved[:, known.index((self.body, target))] = functions[:, None, :, None] * pattern_of_row[:, None, :]
        return moved.reshape(poses, len(known), 3, -1)

    def _pattern_parameters(self, suffix: str = "") -> tuple[Parameter, ...]:
        """Return the parameters of the pattern: each target's shift, or shift and rotation of the whole body."""
        scale, whose = _PLAUSIBLE * self._radius, ("shift",) if self.whole else self.targets
        shifts = tuple(Parameter(f"{name}_{axis}{suffix}", "mm", scale, _MM) for name in whose for axis in "xyz")
        turns = tuple(Parameter(f"turn_{axis}{suffix}", "rad", _PLAUSIBLE) for axis in "xyz")
        return (*shifts, *turns) if self.whole else shifts

    def _free_of_motion(self, values: NDArray, covariance: NDArray) -> tuple[NDArray, NDArray]:
        """Return values and covariance of a pattern without its rigid motion, which has no effect."""
        if self.whole:
            return values, covariance
        projection = np.kron(np.eye(len(values) // len(self._shape_only)), self._shape_only)
        return projection @ values, projection @ covariance @ projection.T


@dataclass(frozen=True)
class BodyDeformation(BodyCause):
    """A body's targets shift by a pattern times columns of the campaign.

    ``terms`` are columns or products of two, as ``a*b``. ``columns`` are all that occur in them, relative to ``zeros``
    and in units of ``ranges``: a parameter is the shift over the range in the campaign. ``with_time``: the columns
    changed nearly linearly with time, so that the campaign cannot distinguish the deformation from a drift.
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
        """Unique name of the candidate."""
        return f"{self.id} {self.body} {'whole ' if self.whole else ''}{' '.join(self.terms)}"

    def candidates(self, scene: PointScene) -> Sequence[BodyDeformation]:
        """Return every body with every drive, the temperature, squares, products and directions of approach."""
        if scene.legs:
            return ()
        proposed = list(proposed_terms(scene))
        return [
            BodyDeformation(
                *body, whole_body_option, terms, *column_scaling(scene, terms), runs_with_time(scene, terms)
            )
            for body in bodies_of(scene)
            for whole_body_option in whole_body_options(scene, body[0])
            for terms in proposed
            if terms != place_columns(body[0])
            if whole_body_option or not is_large(body[1]) or (len(terms) == 1 and TIMES not in terms[0])
        ]

    def prior(self, scene: PointScene) -> float:
        """Return the relative prior weight: proportionality to one column is more probable than other terms."""
        alone = len(self.terms) == 1 and TIMES not in self.terms[0] and not self.terms[0].startswith(CAME_FROM)
        return 1.0 if alone else _SHARE_OF_OTHERS

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return each target's shift x, y, z over the range of each term, mm."""
        if len(self.terms) == 1:
            return self._pattern_parameters()
        return tuple(parameter for n in range(len(self.terms)) for parameter in self._pattern_parameters(f"_{n + 1}"))

    def change(self, state: State, values: NDArray) -> Change:
        """Return d moved / d shift: the value of the term, without a rigid motion of the body."""
        return Change(
            {"moved": self._derivative_of_moved(state, self._functions(state))},
            len(self.terms) * self._pattern.shape[1],
        )

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the pattern, and the columns that drive it."""
        parameters = super().reported(*self._free_of_motion(values, covariance), legs)
        return (*parameters, ReportedParameter("driver", " ".join(map(named_term, self.terms)), None, ""))

    def _functions(self, state: State) -> NDArray:
        """Return the values (B, m) of the terms."""
        counted = {
            name: (np.asarray(state.covariates[name]) - zero) / span
            for name, zero, span in zip(self.columns, self.zeros, self.ranges, strict=True)
        }
        return np.stack([np.prod([counted[name] for name in term.split(TIMES)], axis=0) for term in self.terms], -1)


def bodies_of(scene: PointScene) -> Iterator[tuple[str, tuple[str, ...], tuple[float, ...]]]:
    """Yield each body with enough targets: its name, its targets, and their positions."""
    for body in dict.fromkeys(scene.targets.bodies):
        at = [n for n, other in enumerate(scene.targets.bodies) if other == body]
        if len(at) >= _FEWEST:
            yield (
                body,
                tuple(scene.targets.names[n] for n in at),
                tuple(float(x) for x in scene.shape[at].ravel()),
            )


def is_large(targets: tuple[str, ...]) -> bool:
    """True for a body with a number of targets for which only simple forms of its deformation are searched."""
    return len(targets) > _MANY_TARGETS


def whole_body_options(scene: PointScene, body: str) -> tuple[bool, ...]:
    """Return the options for a body: shift by a pattern, and also as a whole if it should stand still."""
    return (False, True) if body in scene.still else (False,)
