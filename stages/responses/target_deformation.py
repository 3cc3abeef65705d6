"""Deformation of bodies without a mechanism: each target's shift in its body, against the campaign's drives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.common.point_arrays import (
    default_rotations,
    number_column,
    pose_ids,
    pose_points,
    residual_points,
    used_targets,
)
from stages.common.rows import Rows
from stages.declaration import Outcome
from stages.responses.correlated_shifts import correlated_residuals
from stages.responses.tables import error_rows
from truing.estimation.response import ResponseFit, fit_models, keep_consistent, residual_sets
from truing.estimation.response_structure import entry_tests, gain_p_value
from truing.estimation.rigid_poses.frame import residual_covariance

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BodyShifts:
    """One body: poses, targets, residuals (B, T, 3) in m in its own frame, NaN where not seen, and their covariance."""

    body: str
    poses: tuple[int | str, ...]
    targets: tuple[str, ...]
    shift: Array
    noise: Array

    @property
    def flat(self) -> Array:
        """(B, 3T) target by target, x y z."""
        return self.shift.reshape(len(self.shift), -1)


def target_deformation(tables: Mapping[str, pa.Table], drives: tuple[str, ...]) -> Outcome:
    """Fit every body's residuals to the drives; one free offset per coordinate, for the shape at rest."""
    shifts, models, errors = Rows("target_deformation"), Rows("deformation_models"), Rows("deformation_errors")
    words = []
    bodies = tuple(dict.fromkeys(tables["residuals"].column("body").to_pylist()))
    every = pose_ids(tables["residuals"])
    together = correlated_residuals(tables, every)
    for body in bodies:
        found = _body_shifts(tables, body)
        if together is not None:
            found = _with_common_errors(found, every, *together(body, found.targets))
        u, heldout = _drive_values(tables["configurations"], found.poses, drives)
        _shift_rows(shifts, found)
        fitted = ~heldout & np.isfinite(u).all(axis=1)
        if fitted.sum() <= len(drives) + 1 or len(found.targets) < 3:
            words.append(f"{body} not evaluated (too few poses or targets)")
            continue
        fits = _fit(found, u, fitted)
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
    read = f"{shifts.count // 3} residuals of {len(bodies)} bodies against {', '.join(drives)}"
    return Outcome(artifacts, read=read, left_out="nothing", figure="; ".join(words))


def _body_shifts(tables: Mapping[str, pa.Table], body: str) -> BodyShifts:
    import pyarrow.compute as pc

    rows = tables["residuals"].filter(pc.equal(tables["residuals"].column("body"), body))
    poses, targets = pose_ids(rows), tuple(dict.fromkeys(rows.column("target").to_pylist()))
    observed = pose_points(tables["observations"], body, poses, targets)
    shift = residual_points(tables["residuals"], body, poses, targets)
    rotation = default_rotations(tables["poses"], body, poses)
    noise = np.einsum("bji,btjk,bkl->btil", rotation, observed.cov, rotation)
    seen = np.isfinite(shift[:, :, 2])
    used = used_targets(tables["residuals"], body, poses, targets) & seen
    place = _mean_shape(observed.points, observed.seen & seen, rotation, shift)
    return BodyShifts(body, poses, targets, shift, residual_covariance(place, noise, used, seen))


def _with_common_errors(
    found: BodyShifts, every: tuple[int | str, ...], noise: Array, there: NDArray[np.bool_]
) -> BodyShifts:
    """The shifts with the covariance of points that have errors in common, in poses where bodies had a joint fit."""
    rows = np.array([every.index(pose) for pose in found.poses])
    return replace(found, noise=np.where(there[rows, None, None], noise[rows], found.noise))


def _mean_shape(points: Array, seen: NDArray[np.bool_], rotation: Array, shift: Array) -> Array:
    """(T, 3) targets in the body's axes, up to a common shift: enough for how a frame's error reaches them."""
    weight = seen.astype(float)
    local = np.einsum("bji,btj->bti", rotation, points) - np.nan_to_num(shift)
    centre = (local * weight[..., None]).sum(axis=1) / np.maximum(weight.sum(axis=1), 1.0)[:, None]
    centred = (local - centre[:, None]) * weight[..., None]
    whole = weight.min(axis=1) > 0.0
    chosen = whole if whole.any() else np.ones(len(whole), bool)
    return centred[chosen].sum(axis=0) / np.maximum(weight[chosen].sum(axis=0), 1.0)[:, None]


def _drive_values(
    configurations: pa.Table, poses: tuple[int | str, ...], drives: tuple[str, ...]
) -> tuple[Array, NDArray[np.bool_]]:
    """Drives (B, D), counted from their mean so that the offset is the mean shape; and which poses are held out."""
    known = {pose: i for i, pose in enumerate(configurations.column("pose").to_pylist())}
    rows = np.array([known[pose] for pose in poses])
    u = np.column_stack([number_column(configurations, drive) for drive in drives])[rows]
    role = np.array(configurations.column("role").to_pylist(), dtype=object)[rows]
    return u - np.nanmean(u, axis=0), role == "verification"


def _fit(found: BodyShifts, u: Array, fitted: NDArray[np.bool_]) -> dict[str, ResponseFit]:
    y, cov = found.flat[fitted], found.noise[fitted]
    kept = keep_consistent(u[fitted], y, cov)
    return fit_models(u[fitted], np.where(kept, y, np.nan), cov, ("none", "matrix"))


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
