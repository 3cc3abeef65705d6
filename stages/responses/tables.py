"""How fitted response models are told as table rows, for attachments, targets and loads alike."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stages.common.rows import Rows
from truing.estimation.response import ResponseFit, fit_response
from truing.estimation.response_structure import entry_p_values, holm_significant

if TYPE_CHECKING:
    pass

Array = NDArray[np.float64]

FALSE_ALARM = 0.05  # family-wise, over all entries of one table


def birge(fit: ResponseFit) -> float:
    """Factor on the standard deviations: above 1 only where the residuals are larger than declared noise allows."""
    from scipy.special import chdtrc

    if fit.dof <= 0 or chdtrc(fit.dof, fit.chi_square) > 0.01:
        return 1.0
    return float(np.sqrt(fit.chi_square / fit.dof))


def entry_tests(fit: ResponseFit) -> tuple[Array, Array, NDArray[np.bool_]]:
    """(L, D) sigma, p-value and significance of every entry, widened where the noise is larger than declared."""
    factor = birge(fit)
    p = entry_p_values(fit, factor)
    return fit.sigma * factor, p, holm_significant(p, FALSE_ALARM)


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
    whole: str | None = None,
) -> None:
    """The error figures of one model, for all responses and for each.

    ``sets`` are residuals (N, L), of the fit and of what was held out, by what stands before a figure's name;
    `residual_sets` has those that every fit has. ``scale`` turns SI into ``unit``. Responses are legs counted from 1
    where ``responses`` is None, are told by name where it names them, and are told only together, under the subject
    ``whole``, where it is empty.
    """
    chosen = range(*part.indices(fit.residuals.shape[1])) if responses != () else ()
    for prefix, residual in sets.items():
        _size_rows(rows, name, prefix, residual[:, part] * scale, unit, {"subject": whole})
        for k in chosen:
            where = {"leg": k + 1} if responses is None else {"subject": responses[k]}
            _size_rows(rows, name, prefix, residual[:, k] * scale, unit, where)
    ratio = float(np.sqrt(fit.chi_square / max(fit.dof, 1)))
    rows.add(model=name, figure="noise_ratio", value=ratio, unit="1", subject=whole)
    rows.add(model=name, figure="degrees_of_freedom", value=float(fit.dof), unit="1", subject=whole)


def residual_sets(fit: ResponseFit) -> dict[str, Array]:
    """Residuals of the fit, and of each row by a fit to all others."""
    return {"": fit.residuals, "cv_": fit.loo_residuals}


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


def fit_models(u: Array, y: Array, cov: Array, forms: tuple[str, ...], **prior: Any) -> dict[str, ResponseFit]:
    """Every model form fitted to the same data."""
    return {form: fit_response(u, y, cov, form=form, **prior) for form in forms}  # type: ignore[arg-type]
