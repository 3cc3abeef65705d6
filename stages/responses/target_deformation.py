"""Deformation of bodies without a mechanism: each target's shift in its body, against the campaign's drives."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.deformation.correlated_shifts import correlated_residuals
from truing.estimation.deformation.targets import BodyShifts, body_shifts, target_models, with_common_errors
from truing.estimation.response import ResponseFit, residual_sets
from truing.estimation.response_structure import entry_tests, gain_p_value
from truing.report.numbers import count as counted
from truing.stages.common.point_arrays import (
    default_rotations,
    number_column,
    pose_ids,
    pose_points,
    residual_points,
    used_targets,
)
from truing.stages.common.rows import Rows
from truing.stages.declaration import Outcome
from truing.stages.responses.framed_points import framed_points
from truing.stages.responses.tables import error_rows

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]


def target_deformation(tables: Mapping[str, pa.Table], drives: tuple[str, ...]) -> Outcome:
    """Fit every body's residuals to the drives; one free offset per coordinate, for the shape at rest."""
    shifts, models, errors = Rows("target_deformation"), Rows("deformation_models"), Rows("deformation_errors")
    words = []
    bodies = tuple(dict.fromkeys(tables["residuals"].column("body").to_pylist()))
    every = pose_ids(tables["residuals"])
    framed = framed_points(tables, every)
    together = None if framed is None else correlated_residuals(framed)
    for body in bodies:
        found = _body_shifts(tables, body)
        if together is not None:
            found = with_common_errors(found, every, *together(body, found.targets))
        u, heldout = _drive_values(tables["configurations"], found.poses, drives)
        _shift_rows(shifts, found)
        fitted = ~heldout & np.isfinite(u).all(axis=1)
        if fitted.sum() <= len(drives) + 1 or len(found.targets) < 3:
            words.append(f"{body} not evaluated (too few poses or targets)")
            continue
        fits = target_models(found, u, fitted)
        _model_rows(models, found, fits["matrix"], drives)
        _error_rows(errors, found, fits)
        words.append(_words(found, fits))
    identifier = "int64" if isinstance(found.poses[0], int) else "string"
    artifacts = {
        "deformation": Rows("deformation").table(identifier),
        "deformation_models": models.table(),
        "deformation_errors": errors.table(),
        "target_deformation": shifts.table(identifier),
    }
    read = f"{counted(shifts.count // 3, 'residual')} of {counted(len(bodies), 'body')} against {', '.join(drives)}"
    return Outcome(artifacts, read=read, left_out="nothing", figure="; ".join(words))


def _body_shifts(tables: Mapping[str, pa.Table], body: str) -> BodyShifts:
    import pyarrow.compute as pc

    rows = tables["residuals"].filter(pc.equal(tables["residuals"].column("body"), body))
    poses, targets = pose_ids(rows), tuple(dict.fromkeys(rows.column("target").to_pylist()))
    return body_shifts(
        body,
        pose_points(tables["observations"], body, poses, targets),
        residual_points(tables["residuals"], body, poses, targets),
        used_targets(tables["residuals"], body, poses, targets),
        default_rotations(tables["poses"], body, poses),
    )


def _drive_values(
    configurations: pa.Table, poses: tuple[int | str, ...], drives: tuple[str, ...]
) -> tuple[Array, NDArray[np.bool_]]:
    """Drives (B, D), counted from their mean so that the offset is the mean shape; and which poses are held out."""
    known = {pose: i for i, pose in enumerate(configurations.column("pose").to_pylist())}
    rows = np.array([known[pose] for pose in poses])
    u = np.column_stack([number_column(configurations, drive) for drive in drives])[rows]
    role = np.array(configurations.column("role").to_pylist(), dtype=object)[rows]
    return u - np.nanmean(u, axis=0), role == "verification"


def _shift_rows(rows: Rows, found: BodyShifts) -> None:
    b, t, axis = np.nonzero(np.isfinite(found.shift))
    sigma = np.sqrt(np.einsum("bll->bl", found.noise)).reshape(found.shift.shape)
    rows.add(
        pose=[found.poses[i] for i in b],
        body=found.body,
        target=[found.targets[i] for i in t],
        axis=["xyz"[i] for i in axis],
        displacement_um=found.shift[b, t, axis] * 1e6,
        sigma_um=sigma[b, t, axis] * 1e6,
    )


def _model_rows(rows: Rows, found: BodyShifts, fit: ResponseFit, drives: tuple[str, ...]) -> None:
    sigma, p, significant = entry_tests(fit)
    entry, drive = np.nonzero(fit.free & (sigma > 0.0))  # a drive that never moved says nothing
    rows.add(
        model="linear",
        body=found.body,
        target=[found.targets[i // 3] for i in entry],
        axis=["xyz"[i % 3] for i in entry],
        drive=[drives[i] for i in drive],
        column=drive + 1,
        coefficient=fit.coefficients[entry, drive] * 1e6,
        sigma=sigma[entry, drive] * 1e6,
        unit=[f"um per unit of {drives[i]}" for i in drive],
        p_value=p[entry, drive],
        significant=significant[entry, drive],
    )


def _error_rows(rows: Rows, found: BodyShifts, fits: Mapping[str, ResponseFit]) -> None:
    for name, form in (("none", "none"), ("linear", "matrix")):
        error_rows(rows, name, fits[form], residual_sets(fits[form]), "um", 1e6, (), whole=found.body)
    gain = gain_p_value(fits["none"], fits["matrix"])
    rows.add(model="linear", figure="p_value_over_none", value=gain, unit="1", subject=found.body)


def _words(found: BodyShifts, fits: Mapping[str, ResponseFit]) -> str:
    rms = {name: 1e6 * float(np.sqrt(np.nanmean(fit.residuals**2))) for name, fit in fits.items()}
    return f"{found.body} {rms['none']:.1f} um left at rest, {rms['matrix']:.1f} with the drives"
