"""Deformation of a legged platform: the shift of each attachment along z, against the actuators."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from truing.estimation.deformation.attachments import AttachmentModels, Shifts, attachment_models, attachment_shifts
from truing.estimation.response import ResponseFit, residual_sets
from truing.estimation.response_structure import (
    FALSE_ALARM,
    entry_tests,
    holm_significant,
    pair_couplings,
    ring_shape,
    significant_rank,
    symmetry,
)
from truing.report.numbers import count as counted
from truing.stages.common.point_arrays import (
    default_rotations,
    number_column,
    pose_ids,
    pose_points,
    residual_points,
    survey_points,
    used_targets,
)
from truing.stages.common.rows import Rows
from truing.stages.common.words import gross_errors
from truing.stages.declaration import Outcome
from truing.stages.responses.correlated_shifts import handed_on
from truing.stages.responses.framed_points import framed_points
from truing.stages.responses.tables import error_rows

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]


def attachment_deformation(tables: Mapping[str, pa.Table], rest_mm: Sequence[float]) -> Outcome:
    """Shifts of the attachments, their linear and matrix models, and what these say (telescope report, eq. 1-4)."""
    poses, drive, heldout = _drives(tables["configurations"], tables["residuals"], rest_mm)
    shifts = _shifts(tables, poses, len(rest_mm))
    found = attachment_models(drive, shifts, heldout)
    identifier = "int64" if isinstance(poses[0], int) else "string"
    artifacts = {
        "deformation": _deformation_rows(poses, drive, shifts, found.rejected).table(identifier),
        "deformation_models": _model_rows(found.fits, found.determined).table(),
        "deformation_errors": _error_rows(found, shifts).table(),
    }
    if shifts.together is not None:
        artifacts |= handed_on(shifts.together, poses, np.isfinite(shifts.shift), identifier)
    return Outcome(artifacts, *_words(shifts, found.rejected, found.fits))


def _drives(
    configurations: pa.Table, residuals: pa.Table, rest_mm: Sequence[float]
) -> tuple[tuple[int | str, ...], Array, NDArray[np.bool_]]:
    """Poses with residuals, actuator displacements (B, L) in m, and which poses are held out."""
    measured = set(pose_ids(residuals))
    poses = configurations.column("pose").to_pylist()
    rows = np.array([i for i, pose in enumerate(poses) if pose in measured], dtype=np.int64)
    reading = np.column_stack([number_column(configurations, f"rho{i + 1}_mm") for i in range(len(rest_mm))])
    drive = (reading[rows] - np.asarray(rest_mm)) * 1e-3
    role = np.array(configurations.column("role").to_pylist(), dtype=object)[rows]
    return tuple(poses[i] for i in rows), drive, role == "verification"


def _shifts(tables: Mapping[str, pa.Table], poses: tuple[int | str, ...], n_legs: int) -> Shifts:
    survey = survey_points(tables["survey"], "platform")
    return attachment_shifts(
        survey,
        pose_points(tables["observations"], "platform", poses, survey.targets),
        residual_points(tables["residuals"], "platform", poses, survey.targets),
        used_targets(tables["residuals"], "platform", poses, survey.targets),
        default_rotations(tables["poses"], "platform", poses),
        framed_points(tables, poses),
        n_legs,
    )


def _deformation_rows(poses: tuple[int | str, ...], drive: Array, shifts: Shifts, rejected: NDArray[np.bool_]) -> Rows:
    from scipy.special import ndtr

    scatter = np.einsum("bll->bl", shifts.noise)
    sigma = np.sqrt(scatter + np.diag(shifts.survey))
    p = 2.0 * ndtr(-np.abs(shifts.shift) / sigma)
    significant = holm_significant(np.where(rejected, np.nan, p), FALSE_ALARM)
    b, leg = np.nonzero(np.isfinite(shifts.shift))
    rows = Rows("deformation")
    rows.add(
        pose=[poses[i] for i in b],
        leg=leg + 1,
        delta_rho_mm=drive[b, leg] * 1e3,
        delta_bz_um=shifts.shift[b, leg] * 1e6,
        sigma_um=sigma[b, leg] * 1e6,
        own_sigma_um=np.sqrt(shifts.own[b, leg]) * 1e6,
        **({"scatter_sigma_um": np.sqrt(scatter[b, leg]) * 1e6} if shifts.together else {}),
        p_value=p[b, leg],
        significant=significant[b, leg],
        rejected=rejected[b, leg],
        reason=["gross error: far from every model that fits the rest" if r else None for r in rejected[b, leg]],
    )
    return rows


def _model_rows(fits: Mapping[str, ResponseFit], told: Mapping[str, NDArray[np.bool_]]) -> Rows:
    rows = Rows("deformation_models")
    for name in [name for name in ("linear", "matrix") if name in fits]:
        sigma, p, significant = entry_tests(fits[name])
        leg, column = np.nonzero(fits[name].free & told[name][:, None])
        rows.add(
            model=name,
            leg=leg + 1,
            column=column + 1,
            coefficient=fits[name].coefficients[leg, column],
            sigma=sigma[leg, column],
            unit="1",
            p_value=p[leg, column],
            significant=significant[leg, column],
        )
    return rows


def _error_rows(found: AttachmentModels, shifts: Shifts) -> Rows:
    rows = Rows("deformation_errors")
    for name, fit in found.fits.items():
        error_rows(rows, name, fit, {**residual_sets(fit), "verification_": found.held[name]}, "um", 1e6, None)
    if found.determined["matrix"].all():
        for name, below in (("linear", "none"), ("matrix", "linear")):
            rows.add(model=name, figure=f"p_value_over_{below}", value=found.gains[name], unit="1")
        rows.add(model="matrix", figure="modulo_plane", value=float(shifts.modulo_plane), unit="1")
        if not shifts.modulo_plane:  # else what is left of K has no structure of its own
            _structure_rows(rows, found.fits["matrix"])
    _shape_rows(rows, found.kept[found.fitted], shifts.attachments)
    return rows


def _structure_rows(rows: Rows, matrix: ResponseFit) -> None:
    """What the whole K says: rank, symmetry, coupling of pairs."""
    rows.add(model="matrix", figure="rank", value=float(significant_rank(matrix, FALSE_ALARM)), unit="1")
    even = symmetry(matrix)
    rows.add(model="matrix", figure="asymmetry", value=even.relative, unit="1")
    rows.add(model="matrix", figure="symmetry_p_value", value=even.p_value, unit="1")
    for i, j, strength, p in pair_couplings(matrix):
        pair = f"leg{i + 1} leg{j + 1}"
        rows.add(model="matrix", figure="coupling", value=strength, unit="1", subject=pair)
        rows.add(model="matrix", figure="coupling_p_value", value=p, unit="1", subject=pair)


def _shape_rows(rows: Rows, kept: Array, attachments: Array) -> None:
    """The buckled wheel: what of the shifts is lift, tilt and buckling, and the shape they follow most."""
    whole = kept[np.isfinite(kept).all(axis=1)]
    if not len(whole):
        return
    shape = ring_shape(whole, attachments)
    figures: dict[str, Any] = {
        "share_lift": shape.lift,
        "share_tilt": shape.tilt,
        "share_buckle": shape.buckle,
        "share_principal": shape.principal_share,
    }
    for figure, value in figures.items():
        rows.add(model="none", figure=figure, value=value, unit="1")
    rows.add(model="none", figure="principal_amplitude", value=shape.amplitude * 1e6, unit="um")
    rows.add(
        model="none", leg=np.arange(1, len(attachments) + 1), figure="principal_shape", value=shape.principal, unit="1"
    )


def _words(shifts: Shifts, rejected: NDArray[np.bool_], fits: Mapping[str, ResponseFit]) -> tuple[str, str, str]:
    seen = int(np.isfinite(shifts.shift).sum())
    read = (
        f"{counted(seen, 'shift')} at {counted(shifts.shift.shape[1], 'attachment')} in "
        f"{counted(len(shifts.shift), 'pose')}"
    )
    left_out = gross_errors(int(rejected.sum()), "shift") if rejected.any() else "nothing"
    rms = {name: 1e6 * float(np.sqrt(np.nanmean(fit.residuals**2))) for name, fit in fits.items()}
    told = [f"{rms[name]:.1f} {name}" for name in ("linear", "matrix") if name in rms]
    figure = ", ".join([f"rms left {rms['none']:.1f} um without a model", *told])
    untold = [name for name in ("linear", "matrix") if name not in rms]
    figure += f"; not evaluated: {', '.join(untold)}, which so few movements leave open" if untold else ""
    if shifts.modulo_plane:
        figure += "; modulo a plane: fewer than three platform targets away from the attachments"
    return read, left_out, figure
