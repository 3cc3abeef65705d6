"""Table rows on repeats and lack of fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from truing.arrays import Array, Index
from truing.estimation.repeatability import LackOfFit, Squares, equal_scatter
from truing.stages.common.rows import Rows

POOLED = "all, over stated"  # subjects of one kind together, in units of their stated sigmas, as if independent


@dataclass(frozen=True)
class Repeated:
    """Repeated quantity (pose, point, attachment, reading, signal): C subjects with their units."""

    kind: str
    subjects: tuple[str, ...]
    units: tuple[str, ...]


@dataclass(frozen=True)
class Repeats:
    """Rows of ``repeats`` and ``lack_of_fit`` from groups of repeated measurements, and the source of the grouping.

    ``within``: squares of values (B, C) about their group means.
    """

    groups: Sequence[Index]
    how: str
    within: Callable[[Array, Sequence[Index]], Squares]
    repeats: Rows = field(default_factory=lambda: Rows("repeats"))
    fits: Rows = field(default_factory=lambda: Rows("lack_of_fit"))

    def add(self, repeated: Repeated, values: Array, declared: Array) -> None:
        """Add values (B, C) in their units, with the stated sigma (C,) of one value, NaN if none.

        Equality of the groups' variances is tested.
        """
        each = [self.within(values, [group]) for group in self.groups]
        alike = [equal_scatter([g.square[c] for g in each], [g.freedom[c] for g in each]) for c in range(len(declared))]
        p = np.array([np.nan if test is None else test.p_value for test in alike])
        self.add_squares(repeated, self.within(values, self.groups), declared, p)

    def add_squares(self, repeated: Repeated, squares: Squares, declared: Array, p_equal: Array | None = None) -> None:
        """Add a row per repeated subject and one for all, relative to the stated sigma (C,); ``p_equal`` (C,):
        probability of equal variance in all groups."""
        self._add(repeated, squares, declared, p_equal)
        stated = (squares.freedom > 0) & (np.nan_to_num(declared) > 0.0)
        if stated.sum() > 1:
            square = np.array([np.sum(squares.square[stated] / declared[stated] ** 2)])
            pooled = Squares(square, np.array([squares.freedom[stated].sum()]))
            self._add(Repeated(repeated.kind, (POOLED,), ("1",)), pooled, np.ones(1), None)

    def _add(self, repeated: Repeated, squares: Squares, declared: Array, p_equal: Array | None) -> None:
        lower, upper = squares.interval()
        evaluated = np.flatnonzero(squares.freedom > 0)
        if len(evaluated):
            self.repeats.add(
                repeated=repeated.kind,
                subject=[repeated.subjects[c] for c in evaluated],
                pure_error=squares.sigma[evaluated],
                lower=lower[evaluated],
                upper=upper[evaluated],
                declared_sigma=declared[evaluated],
                unit=[repeated.units[c] for c in evaluated],
                freedom_of_error=squares.freedom[evaluated],
                groups=len(self.groups),
                told_by=self.how,
                p_equal=None if p_equal is None else p_equal[evaluated],
            )

    def add_fit(self, repeated: Repeated, model: str, lack_of_fit: LackOfFit) -> None:
        """Add a row per subject whose model residuals can be compared with pure error."""
        evaluated = np.flatnonzero(np.isfinite(lack_of_fit.p_value))
        if len(evaluated):
            self.fits.add(
                repeated=repeated.kind,
                contender=model,
                subject=[repeated.subjects[c] for c in evaluated],
                f_ratio=lack_of_fit.ratio[evaluated],
                freedom_of_fit=lack_of_fit.of_fit[evaluated],
                freedom_of_error=lack_of_fit.of_error[evaluated],
                p_value=lack_of_fit.p_value[evaluated],
            )
