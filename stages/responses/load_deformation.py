"""Compliance of a loaded platform: six-component displacement against six-component load."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from schemas.artifacts import ARTIFACTS
from stages.declaration import Outcome
from stages.point_arrays import number_column
from stages.responses.tables import HeldOut, Rows, entry_tests, error_rows, fit_models
from truing.estimation.response import ResponseFit, keep_consistent
from truing.estimation.response_structure import gain_p_value, symmetry

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]

LOADS = ("fx", "fy", "fz", "mx", "my", "mz")
RESPONSES = ("dx", "dy", "dz", "rx", "ry", "rz")
_LOAD_COLUMNS = ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")
_RESPONSE_COLUMNS = (
    ("dx_mm", 1e-3),
    ("dy_mm", 1e-3),
    ("dz_mm", 1e-3),
    ("rx_rad", 1.0),
    ("ry_rad", 1.0),
    ("rz_rad", 1.0),
)
_FORMS = ("none", "linear", "matrix")


def load_deformation(displacement: pa.Table, sigma_mm: float | None, sigma_rad: float | None) -> Outcome:
    """Fit the linear and the matrix compliance, one free zero per run; noise from the residuals where none is
    declared."""
    u = np.nan_to_num(np.column_stack([number_column(displacement, name) for name in _LOAD_COLUMNS]))
    y = np.column_stack([number_column(displacement, name) * factor for name, factor in _RESPONSE_COLUMNS])
    run, heldout = _runs(displacement)
    fitted = ~heldout
    group = np.unique(run[fitted], return_inverse=True)[1]
    cov = np.tile(np.diag(_variances(u[fitted], y[fitted], group, sigma_mm, sigma_rad)), (int(fitted.sum()), 1, 1))
    kept = keep_consistent(u[fitted], y[fitted], cov, group=group)
    fits = fit_models(u[fitted], np.where(kept, y[fitted], np.nan), cov, _FORMS, group=group)
    empty = {name: ARTIFACTS[name].empty() for name in ("deformation", "deformation_models")}
    tables = {
        "compliance": _compliance_rows(fits).table(),
        "deformation_errors": _error_rows(fits, u, y, heldout).table(),
    }
    rejected = int((~kept).sum())
    left_out = f"{rejected} readings as gross errors" if rejected else "nothing"
    return Outcome({**empty, **tables}, f"{len(u)} steps in {len(np.unique(run))} runs", left_out, _figure(fits))


def _runs(displacement: pa.Table) -> tuple[NDArray[np.object_], NDArray[np.bool_]]:
    run = np.asarray(displacement.column("run").to_pylist(), dtype=object).astype(str)
    if "role" not in displacement.schema.names:
        return run, np.zeros(len(run), bool)
    return run, np.asarray(displacement.column("role").to_pylist(), dtype=object) == "verification"


def _variances(u: Array, y: Array, group: NDArray[np.int64], sigma_mm: float | None, sigma_rad: float | None) -> Array:
    """(6,) declared variances; where undeclared, the robust scatter of a first matrix fit with equal weights."""
    declared = np.array([sigma_mm or np.nan] * 3 + [sigma_rad or np.nan] * 3) * np.repeat([1e-3, 1.0], 3)
    spread = np.nanstd(y, axis=0)
    cov = np.tile(np.diag(np.where(spread > 0.0, spread, 1.0) ** 2), (len(y), 1, 1))
    first = fit_models(u, y, cov, ("matrix",), group=group)["matrix"]
    scatter = 1.4826 * np.nanmedian(np.abs(first.residuals), axis=0)
    return np.where(np.isfinite(declared), declared, np.where(scatter > 0.0, scatter, 1.0)) ** 2


def _compliance_rows(fits: Mapping[str, ResponseFit]) -> Rows:
    rows = Rows("compliance")
    for name in ("linear", "matrix"):
        sigma, p, significant = entry_tests(fits[name])
        i, j = np.nonzero(fits[name].free & (sigma > 0.0))  # axes that were never loaded say nothing
        rows.add(
            model=name,
            response=[RESPONSES[k] for k in i],
            load=[LOADS[k] for k in j],
            coefficient=fits[name].coefficients[i, j],
            sigma=sigma[i, j],
            unit=[f"{'m' if a < 3 else 'rad'}/{'N' if b < 3 else '(N m)'}" for a, b in zip(i, j, strict=True)],
            p_value=p[i, j],
            significant=significant[i, j],
        )
    return rows


def _error_rows(fits: Mapping[str, ResponseFit], u: Array, y: Array, heldout: NDArray[np.bool_]) -> Rows:
    rows = Rows("deformation_errors")
    for name, fit in fits.items():
        for part, unit, scale in ((slice(0, 3), "um", 1e6), (slice(3, 6), "urad", 1e6)):
            error_rows(rows, name, fit, HeldOut(u[heldout], y[heldout]), unit, scale, RESPONSES, part=part)
        for k, response in enumerate(RESPONSES):
            rows.add(model=name, figure="r_squared", value=_r_squared(fits["none"], fit, k), unit="1", subject=response)
    rows.add(model="matrix", figure="p_value_over_linear", value=gain_p_value(fits["linear"], fits["matrix"]), unit="1")
    if not fits["matrix"].deficient:  # otherwise some of its entries are open, and so is its symmetry
        even = symmetry(fits["matrix"])
        rows.add(model="matrix", figure="symmetry_p_value", value=even.p_value, unit="1")
    return rows


def _r_squared(nothing: ResponseFit, fit: ResponseFit, k: int) -> float:
    """Share of the variation of one component, about its zero per run, that the loads explain."""
    before, after = nothing.residuals[:, k], fit.residuals[:, k]
    return float(1.0 - np.nansum(after**2) / np.nansum(before**2))


def _figure(fits: Mapping[str, ResponseFit]) -> str:
    shares = [_r_squared(fits["none"], fits["matrix"], k) for k in range(6)]
    return "compliance matrix explains " + ", ".join(
        f"{r} {100 * s:.0f} %" for r, s in zip(RESPONSES, shares, strict=True)
    )
