"""Fitted response models as table rows, for attachments, targets and loads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from truing.arrays import Array
from truing.estimation.response import ResponseFit
from truing.stages.common.rows import Rows


def add_figures(rows: Rows, model: str, figures: Mapping[str, float], subject: str | None = None) -> None:
    """Add figures without unit of a model, by name."""
    for figure, value in figures.items():
        rows.add(model=model, figure=figure, value=float(value), unit="1", subject=subject)


def error_rows(
    rows: Rows,
    name: str,
    fit: ResponseFit,
    sets: Mapping[str, Array],
    unit: str,
    scale: float,
    responses: tuple[str, ...] | None,
    *,
    part: slice = slice(None),
    subject_of_all: str | None = None,
) -> None:
    """The error figures of one model, for all responses and for each.

    ``sets`` are residuals (N, L), of the fit and of what was held out, by what stands before a figure's name;
    `residual_sets` has those that every fit has. ``scale`` turns SI into ``unit``. Responses are legs counted from 1
    if ``responses`` is None, and named if it names them. If it is empty, they are reported together, with the subject
    ``subject_of_all``.
    """
    chosen = range(*part.indices(fit.residuals.shape[1])) if responses != () else ()
    for prefix, residual in sets.items():
        _size_rows(rows, name, prefix, residual[:, part] * scale, unit, {"subject": subject_of_all})
        for k in chosen:
            where = {"leg": k + 1} if responses is None else {"subject": responses[k]}
            _size_rows(rows, name, prefix, residual[:, k] * scale, unit, where)
    ratio = float(np.sqrt(fit.chi_square / max(fit.dof, 1)))
    add_figures(rows, name, {"noise_ratio": ratio, "degrees_of_freedom": fit.dof}, subject_of_all)


def _size_rows(rows: Rows, name: str, prefix: str, residual: Array, unit: str, where: dict[str, Any]) -> None:
    size = np.abs(residual[np.isfinite(residual)])
    if not len(size):
        return
    for figure, value in (
        ("max_error", size.max()),
        ("mean_error", size.mean()),
        ("rms_error", np.sqrt((size**2).mean())),
    ):
        rows.add(model=name, figure=prefix + figure, value=float(value), unit=unit, **where)
