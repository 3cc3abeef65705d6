"""Statements of uncertainty and budgets as rows of the two artifacts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from truing.arrays import Array
from truing.estimation.uncertainty_budget import Budget
from truing.stages.common.rows import Rows

_MANY = 1e9  # degrees of freedom that make no difference to infinitely many


@dataclass
class Statement:
    """Rows of ``uncertainty`` and ``uncertainty_budget``, identified by subject and quantity."""

    stated: Rows = field(default_factory=lambda: Rows("uncertainty"))
    parts: Rows = field(default_factory=lambda: Rows("uncertainty_budget"))

    def state(
        self,
        result: str,
        subject: Sequence[str] | str,
        quantity: Sequence[str],
        estimate: Array,
        unit: Sequence[str] | str,
        budget: Budget,
        interval: Array | None = None,
    ) -> None:
        """State N results with their budgets; ``interval`` (N,): expanded uncertainties not from Student's
        distribution."""
        count = len(quantity)
        names = {
            "result": result,
            "subject": _one_per_result(subject, count),
            "quantity": list(quantity),
            "unit": _one_per_result(unit, count),
        }
        expanded = budget.expanded if interval is None else interval
        standard = budget.standard
        factor = np.divide(expanded, standard, out=np.full(count, np.nan), where=standard > 0.0)
        self.stated.add(
            **names,
            estimate=estimate,
            standard_uncertainty=standard,
            degrees_of_freedom=np.where(budget.dof < _MANY, budget.dof, np.nan),
            coverage_factor=np.where(np.isfinite(factor), factor, np.nan),
            expanded_uncertainty=expanded,
            stated=True,
        )
        for source, contribution, share in zip(budget.sources, budget.contributions, budget.shares, strict=True):
            self.parts.add(
                **names,
                input_source=source.name,
                evaluation=source.evaluation,
                distribution=source.distribution,
                contribution=contribution,
                degrees_of_freedom=None if np.isinf(source.dof) else source.dof,
                share_of_variance=np.minimum(share, 1.0),
            )

    def not_evaluated(self, result: str, quantity: str, why: str, subject: str | None = None) -> None:
        """Record that no uncertainty is stated for a kind of result or a single one, with the reason."""
        self.stated.add(result=result, subject=subject, quantity=quantity, stated=False, reason=why)

    def omitted(self, result: str, source: str, why: str) -> None:
        """Record a source that the budgets of a kind of result omit, with the reason."""
        self.parts.add(result=result, quantity="all", input_source=source, evaluation="not evaluated", reason=why)


def _one_per_result(values: Sequence[str] | str, count: int) -> list[str]:
    return [values] * count if isinstance(values, str) else list(values)
