"""Base class `NonparametricEffect`: a smooth dependence on inputs x (and y) by basis functions, without a physical
name.

It competes with the causes of the catalogue, so that none of them absorbs an effect of unknown form. A subclass defines
the quantity that moves (channel, leg, target, camera parameter) and the inputs that a campaign offers.
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
from truing.simulation.settling import settling

POLYNOMIAL, WAVES = "polynomial", "waves"
# Forms of time: exponential settling, with the time constant as a share of the range. Temperatures settle so, too, and
# must not be the only inputs of this shape. Together the forms are as probable as proportionality.
SETTLINGS = {f"settling {share}": share for share in (1.0, 0.7, 0.5, 0.35, 0.25, 0.18, 0.125)}
# Least number of observations per basis function.
PER_FUNCTION = 4
# Prior weight of proportionality to one input, relative to any other form.
_IN_PROPORTION = 4.0
# Largest number of higher-order terms added to an accepted form.
_MORE_TERMS = 2
# Relative tolerance at the ends of a range, for rounding.
_EDGE = 1e-6
# The settings of a dependence; see `dependence`.
Dependence = dict[str, Any]


@dataclass(frozen=True)
class NonparametricEffect(Cause[SceneT_contra]):
    """Basis functions of the product of ``columns``, each scaled to -1 .. 1 by its centre and half range.

    They are Chebyshev polynomials of degree ``first`` .. ``degree``, or cosines of ``first`` .. ``degree`` half periods
    over the range, or one exponential settling. A subclass may add forms.
    """

    columns: tuple[str, ...] = (TIME,)
    centres: tuple[float, ...] = (0.0,)
    half_ranges: tuple[float, ...] = (1.0,)
    form: str = POLYNOMIAL
    degree: int = 1
    first: int = 1

    id = "unexplained"
    catalogued = False
    of_time: ClassVar[frozenset[str]] = frozenset({TIME, ORDER})  # effects of these end with the campaign
    letters: ClassVar[dict[str, str]] = {POLYNOMIAL: "degree", WAVES: "wave", **dict.fromkeys(SETTLINGS, "settling")}
    series: ClassVar[frozenset[str]] = frozenset({POLYNOMIAL, WAVES})  # forms that have higher-order terms
    boundless: ClassVar[frozenset[str]] = frozenset()  # forms that are also valid outside the range of their inputs

    @property
    def key(self) -> str:
        """Unique name of the candidate: subject, inputs, form and terms."""
        before, after = self._in_key
        parts = (self.id, *before, *self.columns, self.form, self._terms, *after)
        return " ".join(part for part in parts if part)

    @property
    def is_higher_order(self) -> bool:
        """True if this holds the higher-order terms of a form of lower degree."""
        return self.first > 1

    @property
    def is_persistent(self) -> bool:
        """True if the effect stays with the machine; False if it depends on time."""
        return self.of_time.isdisjoint(self.columns)

    def covers(self, covariates: Mapping[str, NDArray], poses: int) -> NDArray:
        """Return the mask (B,) of epochs within the range of the inputs, outside which the form is undefined."""
        inside = np.ones(poses, bool)
        if self.form in self.boundless:
            return inside
        # A subclass without columns has ranges that limit nothing.
        for column, centre, half in zip(self.columns, self.centres, self.half_ranges, strict=bool(self.columns)):
            if (values := covariates.get(column)) is not None and values.ndim == 1:
                inside &= np.abs(values - centre) <= half * (1.0 + _EDGE)
        return inside

    def higher_order_terms(self, scene: SceneT_contra) -> Sequence[Self]:
        """Return the candidates with the next terms of the series; none if the form is no series."""
        if self.form not in self.series:
            return ()
        degrees = range(self.degree + 1, self.degree + _MORE_TERMS + 1)
        return [replace(self, first=self.degree + 1, degree=degree) for degree in degrees]

    def prior(self, scene: SceneT_contra) -> float:
        """Return the relative prior weight: proportionality to one input is more probable than the other forms."""
        if self.form in SETTLINGS:
            return _IN_PROPORTION / len(SETTLINGS)
        return _IN_PROPORTION if self.form == POLYNOMIAL and len(self.columns) == self.degree == 1 else 1.0

    def inputs(self, legs: int) -> tuple[str, ...]:
        """Return the input columns as in the tables."""
        return tuple(dict.fromkeys(TIME if column in self.of_time else column for column in self.columns))

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return one amplitude for each function and each independently moving part."""
        unit, si, scale = self._amplitude
        terms = [f"{self.letters[self.form]}{k}" for k in range(self.first, self.first + self._count(legs))]
        return tuple(Parameter(f"{owner}{term}", unit, scale, si) for owner in self._owners(legs) for term in terms)

    def scaled(self, value: Callable[[str], NDArray]) -> list[NDArray]:
        """Return the inputs scaled to -1 .. 1; ``value`` gives the values of a column."""
        ranges = zip(self.columns, self.centres, self.half_ranges, strict=True)
        return [(value(column) - centre) / half for column, centre, half in ranges]

    def basis(self, value: Callable[[str], NDArray]) -> NDArray:
        """Return the values (..., m) of the basis functions at inputs (...); ``value`` gives the values of a column."""
        if self.form in SETTLINGS:
            passed = np.asarray(prod(self.scaled(value)) + 1.0) / 2.0
            return 2.0 * settling(passed, 1.0 / SETTLINGS[self.form])[0][..., None] - 1.0
        functions = waves if self.form == WAVES else chebyshev
        return functions(np.asarray(prod(self.scaled(value))), self.degree)[..., self.first - 1 :]

    def _count(self, legs: int) -> int:
        """Return the number of basis functions m."""
        return self.degree - self.first + 1

    @property
    def _terms(self) -> str:
        return f"{self.first} to {self.degree}" if self.first > 1 else str(self.degree)

    @property
    def _in_key(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Words of the key before and after the inputs."""
        raise NotImplementedError

    @property
    def _amplitude(self) -> tuple[str, float, float]:
        """Unit of the amplitudes, its SI value, and the plausible size of an amplitude, SI."""
        raise NotImplementedError

    def _owners(self, legs: int) -> Sequence[str]:
        """Return the prefixes of parameter names, one for each independently moving part."""
        return ("",)


def dependence(
    columns: Sequence[str], range_of: Callable[[str], tuple[float, float]], form: str = POLYNOMIAL, degree: int = 1
) -> Dependence:
    """Return the settings of a dependence on columns; ``range_of`` gives the centre and half range of a column."""
    centres, half_ranges = zip(*map(range_of, columns), strict=True)
    inputs = {"columns": tuple(columns), "centres": centres, "half_ranges": half_ranges}
    return {**inputs, "form": form, "degree": degree}


def chebyshev(x: NDArray, degree: int) -> NDArray:
    """Return the Chebyshev polynomials T_1 .. T_degree at x (...), as (..., degree)."""
    values = [np.ones_like(x), x]
    while len(values) <= degree:
        values.append(2 * x * values[-1] - values[-2])
    return np.stack(values[1 : degree + 1], -1)


def waves(x: NDArray, count: int) -> NDArray:
    """Return cosines of 1 .. ``count`` half periods over -1 .. 1 at x (...), as (..., count)."""
    return np.asarray(np.cos(np.pi / 2 * (x[..., None] + 1) * np.arange(1, count + 1)))
