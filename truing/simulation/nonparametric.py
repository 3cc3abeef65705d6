"""A nonparametric effect: something depends on inputs x (and y) by basis functions, in no form that a cause declares.

It competes with the catalogue on equal terms, so that no named cause absorbs what it does not explain. A subclass says
what it moves (a channel, a leg, a target, a number of a camera) and which inputs a campaign offers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Cause, Parameter, SceneT_contra
from truing.simulation.inputs import ORDER, TIME

POLYNOMIAL, WAVES = "polynomial", "waves"
# A smooth dependence wants this many observations per function.
PER_FUNCTION = 4
# What is in proportion to one input is so many times as likely beforehand as any other form.
_IN_PROPORTION = 4.0
# So many higher-order terms may a form have that was found of lower degree.
_MORE_TERMS = 2
# A range counts as reached a hair beyond its ends.
_EDGE = 1e-6
# The settings of a dependence; see `dependence`.
Dependence = dict[str, Any]


@dataclass(frozen=True)
class NonparametricEffect(Cause[SceneT_contra]):
    """Basis functions of ``columns`` (several: their product), each brought to -1 .. 1 by its centre and half range.

    They are Chebyshev polynomials of degree ``first`` .. ``degree``, or so many slow waves: cosines of half a period,
    one, .. over the range. A subclass may know further forms.
    """

    columns: tuple[str, ...] = (TIME,)
    centres: tuple[float, ...] = (0.0,)
    half_ranges: tuple[float, ...] = (1.0,)
    form: str = POLYNOMIAL
    degree: int = 1
    first: int = 1

    id = "unexplained"
    catalogued = False
    of_time: ClassVar[frozenset[str]] = frozenset({TIME, ORDER})  # what depends on these ends with the campaign
    letters: ClassVar[dict[str, str]] = {POLYNOMIAL: "degree", WAVES: "wave"}
    series: ClassVar[frozenset[str]] = frozenset({POLYNOMIAL, WAVES})  # forms that have higher-order terms
    boundless: ClassVar[frozenset[str]] = frozenset()  # forms that hold beyond the range of their inputs, too

    @property
    def key(self) -> str:
        """Return the name that tells it from others of its kind."""
        before, after = self._in_key
        parts = (self.id, *before, *self.columns, self.form, self._terms, *after)
        return " ".join(part for part in parts if part)

    @property
    def is_higher_order(self) -> bool:
        """Return whether it holds the higher-order terms of a form of lower degree."""
        return self.first > 1

    @property
    def is_persistent(self) -> bool:
        """Return whether it stays with what it concerns: not what depends on the time."""
        return self.of_time.isdisjoint(self.columns)

    def covers(self, covariates: Mapping[str, NDArray], poses: int) -> NDArray:
        """Return the epochs (B,) within the range of its inputs, beyond which its form says nothing."""
        inside = np.ones(poses, bool)
        if self.form in self.boundless:
            return inside
        # What has a range and names no column is everywhere within reach.
        for column, centre, half in zip(self.columns, self.centres, self.half_ranges, strict=bool(self.columns)):
            if (values := covariates.get(column)) is not None and values.ndim == 1:
                inside &= np.abs(values - centre) <= half * (1.0 + _EDGE)
        return inside

    def higher_order_terms(self, scene: SceneT_contra) -> Sequence[Self]:
        """Return its next terms; none of a form that is no series."""
        if self.form not in self.series:
            return ()
        degrees = range(self.degree + 1, self.degree + _MORE_TERMS + 1)
        return [replace(self, first=self.degree + 1, degree=degree) for degree in degrees]

    def prior(self, scene: SceneT_contra) -> float:
        """Return the weight: what is in proportion to one input is likelier than other forms."""
        return _IN_PROPORTION if self.form == POLYNOMIAL and len(self.columns) == self.degree == 1 else 1.0

    def inputs(self, legs: int) -> tuple[str, ...]:
        """Return the columns of the tables that it depends on."""
        return tuple(dict.fromkeys(TIME if column in self.of_time else column for column in self.columns))

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return one amplitude per function of everything that moves by its own."""
        unit, si, scale = self._amplitude
        terms = [f"{self.letters[self.form]}{k}" for k in range(self.first, self.first + self._count(legs))]
        return tuple(Parameter(f"{own}{term}", unit, scale, si) for own in self._owners(legs) for term in terms)

    def scaled(self, value: Callable[[str], NDArray]) -> list[NDArray]:
        """Return the inputs brought to -1 .. 1, of which ``value`` tells the columns."""
        ranges = zip(self.columns, self.centres, self.half_ranges, strict=True)
        return [(value(column) - centre) / half for column, centre, half in ranges]

    def basis(self, value: Callable[[str], NDArray]) -> NDArray:
        """Return the functions' values (..., m) at inputs (...), of which ``value`` tells the columns."""
        functions = waves if self.form == WAVES else chebyshev
        return functions(np.asarray(prod(self.scaled(value))), self.degree)[..., self.first - 1 :]

    def _count(self, legs: int) -> int:
        """Return the number of functions m."""
        return self.degree - self.first + 1

    @property
    def _terms(self) -> str:
        return f"{self.first} to {self.degree}" if self.first > 1 else str(self.degree)

    @property
    def _in_key(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return what tells it from others before and after its inputs."""
        raise NotImplementedError

    @property
    def _amplitude(self) -> tuple[str, float, float]:
        """Return the unit of the amplitudes, what one is in SI, and how large they plausibly are, SI."""
        raise NotImplementedError

    def _owners(self, legs: int) -> Sequence[str]:
        """Return what moves by its own, as the names of parameters begin."""
        return ("",)


def dependence(
    columns: Sequence[str], range_of: Callable[[str], tuple[float, float]], form: str = POLYNOMIAL, degree: int = 1
) -> Dependence:
    """Return the settings of a dependence on columns, of which ``range_of`` tells the centre and half the range."""
    centres, half_ranges = zip(*map(range_of, columns), strict=True)
    inputs = {"columns": tuple(columns), "centres": centres, "half_ranges": half_ranges}
    return {**inputs, "form": form, "degree": degree}


def chebyshev(x: NDArray, degree: int) -> NDArray:
    """Return T_1 .. T_degree of x (...), (..., degree)."""
    values = [np.ones_like(x), x]
    while len(values) <= degree:
        values.append(2 * x * values[-1] - values[-2])
    return np.stack(values[1 : degree + 1], -1)


def waves(x: NDArray, count: int) -> NDArray:
    """Return the first cosines of x (...) over -1 .. 1, of half a period, one, .., (..., count)."""
    return np.asarray(np.cos(np.pi / 2 * (x[..., None] + 1) * np.arange(1, count + 1)))
