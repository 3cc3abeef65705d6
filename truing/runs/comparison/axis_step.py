"""Changes from one run of an axis to the next: sizes of the effects that both runs found."""

from __future__ import annotations

from collections import Counter
from itertools import product

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from truing.runs.comparison.steps import (
    NAMES,
    RunStep,
    not_assessed,
    owner,
    shift_without_effects,
    tested_changes,
)
from truing.simulation.axis.causes import AxisCause
from truing.simulation.axis.extended_model import ExtendedAxis
from truing.simulation.cause import ReportedParameter

# They count from the zero of the command, or from a point that each campaign chooses.
_FROM_ZERO, _NO_TEST = {"phase", "shift"}, "counts from another zero"


def axis_numbers(extended: ExtendedAxis) -> pd.DataFrame:
    """Return the reported numbers of the persistent effects: NAMES, value and sigma in the tables' units."""
    rows = [
        ("effect", owner(cause), None, number.name, number.value, number.sigma, number.unit)
        for cause, numbers in _reported(extended, set()).items()
        for number in numbers
    ]
    return pd.DataFrame(rows, columns=[*NAMES, "value", "sigma", "unit"])


def axis_step(before: ExtendedAxis, now: ExtendedAxis) -> RunStep:
    """Return the changes of the effects that both models hold, such as lost motion.

    Sigmas include the possible bias by an effect that only one model holds. Zeros of encoders are free, so they are not
    compared; neither are several effects of one kind and subject, whose order is arbitrary.
    """
    if (before.axis.kind, before.axis.loop) != (now.axis.kind, now.axis.loop):
        return not_assessed("their campaign.toml name other axes")
    both = _single_owners(before) & _single_owners(now)
    if not both:
        return not_assessed("no effect was found in both")
    old, new = (
        {owner(cause): numbers for cause, numbers in _reported(one, both).items() if owner(cause) in both}
        for one in (before, now)
    )
    pairs = [
        (name, first, second)
        for name in sorted(both)
        for first, second in product(old[name], new[name])
        if first.name == second.name
    ]
    names: list[tuple[object, ...]] = [("effect", name, None, first.name) for name, first, _ in pairs]
    difference = np.array([float(second.value) - float(first.value) for _, first, second in pairs])
    spread = np.array([np.hypot(first.sigma or 0.0, second.sigma or 0.0) for _, first, second in pairs])
    counts = np.array([first.name not in _FROM_ZERO for _, first, _ in pairs])
    step = tested_changes(names, difference, spread, counts)
    reasons = step.rows["reason"].where(counts, _NO_TEST)
    return RunStep(step.rows.assign(reason=reasons))


def _single_owners(extended: ExtendedAxis) -> set[str]:
    """Return the names of persistent catalogued effects that the model holds once."""
    counted = Counter(owner(effect.cause) for effect in extended.effects if effect.cause.is_persistent)
    catalogued = {owner(effect.cause) for effect in extended.effects if effect.cause.catalogued}
    return {name for name, count in counted.items() if count == 1 and name in catalogued}


def _reported(extended: ExtendedAxis, common: set[str]) -> dict[AxisCause, tuple[ReportedParameter, ...]]:
    """Return the numbers of each persistent effect; with owners in ``common``, sigmas include the bias that another
    effect would cause by its absence."""
    every = np.concatenate([extended.zeros, *(effect.values for effect in extended.effects)])
    effects = [effect for effect in extended.effects if effect.cause.is_persistent]
    indices_of_others = [_places(extended, e.cause) for e in effects if common and owner(e.cause) not in common]
    result: dict[AxisCause, tuple[ReportedParameter, ...]] = {}
    for effect in effects:
        at = _places(extended, effect.cause)
        covariance = extended.covariance[np.ix_(at, at)]
        rivals = [one for one in indices_of_others if not np.array_equal(one, at)]
        covariance = covariance + shift_without_effects(every, extended.covariance, at, rivals)
        reported = effect.cause.reported(effect.values, covariance, 0)
        result[effect.cause] = tuple(number for number in reported if not isinstance(number.value, str))
    return result


def _places(extended: ExtendedAxis, cause: AxisCause) -> NDArray:
    return np.r_[extended.layout[cause.key]]
