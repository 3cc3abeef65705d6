"""Inputs that may deform a body without a mechanism: drives, temperature, other bodies, and their squares and
products."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from truing.schemas.covariates import own_name
from truing.simulation.inputs import ORDER, TEMPERATURE, TIME
from truing.simulation.mechanisms.point_causes import PointScene

CAME_FROM = "approach "  # prefix of a drive's name, for the direction of its last movement
TIMES = "*"
_MOST_TOGETHER = 6
# Columns with a larger correlation cannot be distinguished in a campaign.
_SAME_COURSE = 0.99


def proposed_terms(scene: PointScene) -> Iterator[tuple[str, ...]]:
    """Yield the terms of possible deformations."""
    drives = [drive for drive in scene.drives if _varies_and_is_finite(scene, drive)]
    for column in (*drives, *((TEMPERATURE,) if _varies_and_is_finite(scene, TEMPERATURE) else ())):
        yield (column,)
        if len(np.unique(scene.covariates[column])) > 2:
            yield (f"{column}{TIMES}{column}",)
            yield (column, f"{column}{TIMES}{column}")
        if _varies_and_is_finite(scene, CAME_FROM + column):
            yield (CAME_FROM + column,)
    yield from (place_columns(body) for body in scene.placed)
    yield from ((f"{first}{TIMES}{second}",) for first, second in combinations(drives, 2))
    if 2 <= len(drives) <= _MOST_TOGETHER:
        yield tuple(drives)


def place_columns(body: str) -> tuple[str, ...]:
    """Return the columns with the position of a body, m."""
    return tuple(f"{body} {axis}" for axis in "xyz")


def _varies_and_is_finite(scene: PointScene, column: str) -> bool:
    return scene.varies(column) and bool(np.isfinite(scene.covariates[column]).all())


def column_scaling(
    scene: PointScene, terms: tuple[str, ...]
) -> tuple[tuple[str, ...], tuple[float, ...], tuple[float, ...]]:
    """Return the columns of terms, their zeros (the reference, otherwise the value nearest to zero) and their
    ranges."""
    columns = tuple(dict.fromkeys(column for term in terms for column in term.split(TIMES)))
    found = [np.asarray(scene.covariates[column]) for column in columns]
    nearest = [float(np.clip(0.0, values.min(), values.max())) for values in found]
    zeros = [scene.reference_temperature_c if c == TEMPERATURE else z for c, z in zip(columns, nearest, strict=True)]
    return columns, tuple(zeros), tuple(float(np.ptp(values)) for values in found)


def runs_with_time(scene: PointScene, terms: tuple[str, ...]) -> bool:
    """True if the terms' columns changed nearly linearly with time, so that data cannot distinguish them from it."""
    time = scene.covariates.get(TIME if scene.varies(TIME) else ORDER)
    columns = [scene.covariates.get(c) for term in terms for c in term.split(TIMES) if not c.startswith(CAME_FROM)]
    if time is None or not columns or any(values is None or np.ptp(values) == 0 for values in columns):
        return False
    return all(abs(np.corrcoef(time, values)[0, 1]) > _SAME_COURSE for values in columns if values is not None)


def named_term(term: str) -> str:
    """Return a term with the laboratory's own column names."""
    return TIMES.join(
        f"{CAME_FROM if column.startswith(CAME_FROM) else ''}{own_name(column.removeprefix(CAME_FROM))}"
        for column in term.split(TIMES)
    )
