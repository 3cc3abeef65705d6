"""Fitted response models as table rows, for attachments, targets and loads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from truing.arrays import Array
from truing.estimation.response import ResponseFit
from truing.stages.common.rows import Rows


def add_figures(rows: Rows, model: str, figures: Mapping[str, float], subject: str | None = None) -> None:
    """Add figures without unit of a model, by name."""
    for figure, value in figures.items():
        rows.add(model=model, figure=figure, value=float(value), unit="1", subject=subject)


@dataclass(frozen=True)
class ReportedResponses:
    """Responses of one unit as rows: those in ``part`` of all columns, in ``unit``, which ``scale`` gives from SI.

    ``names``: subject of each column of the fit; None: legs, counted from 1; empty: no rows of single responses.
    ``subject``: subject of the rows on all responses together.
    """

    unit: str = "um"
    scale: float = 1e6
    names: tuple[str, ...] | None = None
    part: slice = field(default_factory=lambda: slice(None))
    subject: str | None = None

    def single(self, count: int) -> list[tuple[int, dict[str, object]]]:
        """Columns, out of ``count``, with a row each, and the key of that row."""
        if self.names == ():
            return []
        columns = range(*self.part.indices(count))
        return [(k, {"leg": k + 1} if self.names is None else {"subject": self.names[k]}) for k in columns]


LEGS_UM = ReportedResponses()


def error_rows(
    rows: Rows, name: str, fit: ResponseFit, sets: Mapping[str, Array], responses: ReportedResponses = LEGS_UM
) -> None:
    """The error figures of one model, for all responses and for each.

    ``sets``: residuals (N, L) of the fit and of held-out data, by the prefix of their figures; `residual_sets` has
    those that every fit has.
    """
    unit, scale = responses.unit, responses.scale
    for prefix, residual in sets.items():
        _size_rows(rows, name, prefix, residual[:, responses.part] * scale, unit, {"subject": responses.subject})
        for k, where in responses.single(fit.residuals.shape[1]):
            _size_rows(rows, name, prefix, residual[:, k] * scale, unit, where)
    ratio = float(np.sqrt(fit.chi_square / max(fit.dof, 1)))
    add_figures(rows, name, {"noise_ratio": ratio, "degrees_of_freedom": fit.dof}, responses.subject)


def _size_rows(rows: Rows, name: str, prefix: str, residual: Array, unit: str, where: dict[str, object]) -> None:
    size = np.abs(residual[np.isfinite(residual)])
    if not len(size):
        return
    for figure, value in (
        ("max_error", size.max()),
        ("mean_error", size.mean()),
        ("rms_error", np.sqrt((size**2).mean())),
    ):
        rows.add(model=name, figure=prefix + figure, value=float(value), unit=unit, **where)
