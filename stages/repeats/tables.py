"""The rows that tell of repeats and of what models leave beside them; and the stage's closing words on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.repeatability import LackOfFit, Squares, equal_scatter
from truing.stages.common.rows import Rows

Array = NDArray[np.float64]

POOLED = "all, over stated"  # subjects of one kind together, in units of their stated sigmas, as if independent


@dataclass(frozen=True)
class Repeated:
    """What was repeated (pose, point, attachment, reading, signal): C subjects with their units.

    how: how that is known; groups: how many of them there are.
    """

    kind: str
    subjects: tuple[str, ...]
    units: tuple[str, ...]
    how: str
    groups: int

    def add_to(self, rows: Rows, found: Squares, declared: Array, each: Sequence[Squares] = ()) -> None:
        """A row per subject that was repeated, and one of all over what is stated.

        declared (C,): the stated sigma of one of them, NaN where none is. each: the same group by group, by which it is
        tested whether one number holds for all.
        """
        alike = [equal_scatter([g.square[c] for g in each], [g.freedom[c] for g in each]) for c in range(len(declared))]
        p = np.array([np.nan if one is None else one.p_value for one in alike])
        self._add(rows, self.subjects, self.units, found, np.asarray(declared, float), p)
        stated = (found.freedom > 0) & (np.nan_to_num(declared) > 0.0)
        if stated.sum() > 1:
            square = np.sum(found.square[stated] / np.asarray(declared, float)[stated] ** 2, keepdims=True)
            pooled = Squares(square, found.freedom[stated].sum(keepdims=True))
            self._add(rows, (POOLED,), ("1",), pooled, np.ones(1), np.array([np.nan]))

    def _add(
        self,
        rows: Rows,
        subjects: tuple[str, ...],
        units: tuple[str, ...],
        found: Squares,
        declared: Array,
        p_equal: Array,
    ) -> None:
        lower, upper = found.interval()
        told = np.flatnonzero(found.freedom > 0)
        if len(told):
            rows.add(
                repeated=[self.kind] * len(told),
                subject=[subjects[c] for c in told],
                pure_error=found.sigma[told],
                lower=lower[told],
                upper=upper[told],
                declared_sigma=declared[told],
                unit=[units[c] for c in told],
                freedom_of_error=found.freedom[told],
                groups=[self.groups] * len(told),
                told_by=[self.how] * len(told),
                p_equal=p_equal[told],
            )

    def add_fit(self, rows: Rows, model: str, found: LackOfFit) -> None:
        """A row per subject of which a model could be held against pure error."""
        told = np.flatnonzero(np.isfinite(found.p_value))
        if len(told):
            rows.add(
                repeated=[self.kind] * len(told),
                contender=[model] * len(told),
                subject=[self.subjects[c] for c in told],
                f_ratio=found.ratio[told],
                freedom_of_fit=found.of_fit[told],
                freedom_of_error=found.of_error[told],
                p_value=found.p_value[told],
            )
