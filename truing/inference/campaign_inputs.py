"""Inputs of a campaign as columns over its epochs, and the history of an input."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from truing.inference.arrays import Array, Integers, Mask
from truing.inference.fitted_model import FittedModel
from truing.inference.model import CauseT
from truing.inference.random_functions import centred, standard

_ORDER = "order"
_THRESHOLDS = 0.08, 0.2, 0.4  # widths of play operators, relative to the range of an input
_COPY = 1e-9  # largest relative difference of two copies


def columns_of(fitted: FittedModel[CauseT], groups: Integers | None) -> dict[str, Array]:
    """Return the inputs (B,) that vary, without the order of the epochs. Of copies, in other units or of one clock, the
    first: functions of the others would count twice."""
    scene = fitted.scene
    result: dict[str, Array] = {}
    for name, values in {**scene.covariates, **scene.inputs}.items():
        column = numbers(values)
        if name == _ORDER or column is None:
            continue
        if not any(is_copy(column[:, None], other[:, None], groups) for other in result.values()):
            result[name] = column
    return result


def numbers(values: ArrayLike) -> Array | None:
    """Return a column (B,) of numbers; None if it holds something else, a gap, or a constant."""
    if np.ndim(values) != 1 or np.asarray(values).dtype.kind not in "fiu":
        return None
    finite_values: Array = np.asarray(values, float)
    return finite_values if np.isfinite(finite_values).all() and np.ptp(finite_values) > 0.0 else None


def is_copy(first: Array, second: Array, groups: Integers | None) -> bool:
    """Return True if two columns (B, 1) differ only by a factor, and by a constant in each group."""
    one, other = (centred(own / np.ptp(own), groups) for own in (first, second))
    product = float(np.sum(one * other))
    of_one, of_other = (max(float(np.sum(own**2)), 1e-300) for own in (one, other))
    left = one - product / of_other * other, other - product / of_one * one
    return bool(max(np.abs(own).max() for own in left) < _COPY)


def column_of(values: ArrayLike, columns: Mapping[str, Array]) -> str | None:
    """Return the name of the column that holds the same values (B,), in any unit; None if none does."""
    if (column := numbers(values)) is None:
        return None
    return next((name for name, other in columns.items() if is_copy(column[:, None], other[:, None], None)), None)


@dataclass(frozen=True)
class InTime:
    """Order in time (n,) of the epochs and the groups (n,) within which they follow each other; None where unknown.

    ``known``: inputs (n,) whose history (n, m) is known, with it. Epochs that are left out are part of it.
    """

    order: Array | None
    groups: Array | None
    known: tuple[tuple[Array, Array], ...] = ()

    @property
    def _sorted(self) -> tuple[Integers, Integers]:
        """Epochs sorted by time within each group, and their groups."""
        assert self.order is not None
        groups = np.zeros(len(self.order), int) if self.groups is None else self.groups.astype(int)
        in_time = np.lexsort((self.order, groups))
        return in_time, groups[in_time]

    def history(self, values: Array) -> Array | None:
        """Return the history of an input (n,): its lead over play operators of several widths, and its previous value
        (n, 4). None where no order is known."""
        for reading, past in self.known:
            if np.ptp(reading) > 0.0 and is_copy(values[:, None], reading[:, None], None):
                return past
        if self.order is None:
            return None
        x, (in_time, groups) = standard(values[:, None])[:, 0], self._sorted
        result = np.zeros((len(x), len(_THRESHOLDS) + 1))
        reach = np.array(_THRESHOLDS) * max(float(np.ptp(x)), 1e-12)
        ahead = np.zeros(len(reach))
        for index, now in enumerate(in_time):
            first = index == 0 or groups[index] != groups[index - 1]
            last = now if first else in_time[index - 1]
            ahead = 0.0 * ahead if first else np.clip(ahead + x[now] - x[last], -reach, reach)
            result[now] = [*(ahead / reach), x[last]]
        return result


def in_time_of(fitted: FittedModel[CauseT], at: Mask) -> InTime:
    """Return the order, the groups and the known histories of the epochs ``at`` (B,)."""
    scene = fitted.scene
    order = _at_epochs(scene.covariates.get(_ORDER), at)
    known = [(np.asarray(scene.inputs[name], float)[at], history[at]) for name, history in scene.histories.items()]
    return InTime(order, _at_epochs(fitted.model.error_groups, at), tuple(known))


def _at_epochs(values: Array | Integers | None, at: Mask) -> Array | None:
    return None if values is None else np.asarray(values, float)[at]


def time_columns(columns: Mapping[str, Array], in_time: InTime) -> frozenset[str]:
    """Return the columns that never decrease in time: a dependence on these may itself be serial correlation."""
    if in_time.order is None:
        return frozenset()
    order = np.argsort(in_time.order, kind="stable")
    return frozenset(name for name, values in columns.items() if np.all(np.diff(values[order]) >= 0.0))
