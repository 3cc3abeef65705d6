"""Lengths that contradict each other about the scale: which, by how much, against what; and what is not judged then."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.schemas.photograph_artifacts import LENGTH, LENGTH_SIGMA
from truing.stages.common.words import listed
from truing.stages.quality.bundle_figures import Figures
from truing.stages.quality.check import FAIL, NOT_EVALUATED, WARN, Check

Array = NDArray[np.float64]

_BEYOND = 5.0  # sigmas
# Relative, by which lengths differ: what is warm grows less, and less than that is told bar by bar.
_MATTERS = 5e-4
_LEAST = 1e-9
_SURVEY = "survey of "
# Checks that a wrong scale trips: nothing follows from them before it is mended.
_CONSEQUENCES = frozenset(
    (
        *("poses-determined", "gross-errors", "noise", "residuals-systematic", "image-noise", "bar-lengths"),
        *("camera-stability", "target-sizes", "length-errors", "points-against-survey"),
    )
)


@dataclass(frozen=True)
class Contradiction:
    """A length, or several, that contradict the others: names, by how much relative to these, its sigma."""

    odd: tuple[str, ...]
    others: tuple[str, ...]
    by: float
    sigma: float

    @property
    def told(self) -> str:
        """The sentence of the check ``scale``."""
        size = f"{1e3 * abs(self.by):.3g} ± {1e3 * self.sigma:.1g} mm/m {'larger' if self.by > 0 else 'smaller'}"
        one, others = listed(self.odd), listed(self.others)
        if len(self.others) == 1:
            said = f"{one} and {others} contradict each other about the scale: lengths by {one} are {size}."
            return f"{said} One of them is wrong; a third length would tell which."
        said = f"{one} contradicts {others} about the scale: lengths by {one} are {size}, and the others agree."
        return f"{said} Look at its length, its ends and its unit."


def scale_contradiction(figures: Figures) -> Contradiction | None:
    """What gives or checks the scale and differs from the others; None where all agree as well as lengths do."""
    names, x, s = _sources(figures)
    if len(names) < 2:
        return None
    odd = np.zeros(len(names), bool)
    odd[0 if len(names) == 2 else int(np.argmin([_chi2(np.delete(x, k), np.delete(s, k)) for k in range(len(x))]))] = (
        True
    )
    mean = [float(np.average(x[part], weights=s[part] ** -2)) for part in (odd, ~odd)]
    sigma = float(np.sqrt(sum(1.0 / np.sum(s[part] ** -2) for part in (odd, ~odd))))
    by = mean[0] / mean[1] - 1.0
    sides = [tuple(name for name, own in zip(names, part, strict=True) if own) for part in (odd, ~odd)]
    if abs(by) <= max(_MATTERS, _BEYOND * sigma):
        return None
    return Contradiction(sides[0], sides[1], by, sigma)


def _sources(figures: Figures) -> tuple[list[str], Array, Array]:
    """Names, ratios and sigmas of what states lengths; bodies of one survey that agree are one statement."""
    ratio, spread = figures.told(LENGTH), figures.told(LENGTH_SIGMA)
    bodies = [name for name in ratio if name.startswith(_SURVEY)]
    others = [name for name in ratio if name not in bodies]
    x, s = (np.array([told[name] for name in bodies]) for told in (ratio, spread))
    names, values, sigmas = others, [ratio[name] for name in others], [spread[name] for name in others]
    if len(bodies) > 1 and np.ptp(x) <= max(_MATTERS, _BEYOND * float(s.max())):
        names, values, sigmas = [*others, "the survey"], [*values, float(np.mean(x))], [*sigmas, float(s.max())]
    else:
        names, values, sigmas = [*others, *bodies], [*values, *x], [*sigmas, *s]
    return names, np.array(values), np.maximum(np.array(sigmas), _LEAST)


def _chi2(x: Array, s: Array) -> float:
    return float(np.sum((x - np.average(x, weights=s**-2)) ** 2 / s**2))


def without_consequences(checks: Iterable[Check]) -> Iterator[Check]:
    """Checks of a network whose scale is contradicted, of which those that this trips say nothing."""
    for check in checks:
        if check.check in _CONSEQUENCES and check.verdict in (FAIL, WARN):
            said = "Not evaluated: lengths contradict each other about the scale, as the check scale says."
            yield replace(check, value=None, limit=None, unit="", verdict=NOT_EVALUATED, message=said)
        else:
            yield check
