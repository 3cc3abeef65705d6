"""Deformation of a legged platform: the shift of each attachment along z, against the actuators."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stages.common.point_arrays import (
    default_rotations,
    number_column,
    pose_ids,
    pose_points,
    residual_points,
    survey_points,
    used_targets,
)
from stages.common.rows import Rows
from stages.declaration import Outcome
from stages.responses.correlated_shifts import CorrelatedShifts, correlated_shifts, handed_on
from stages.responses.tables import error_rows
from truing.estimation.response import ResponseFit, fit_models, fit_response, keep_consistent, residual_sets
from truing.estimation.response_structure import (
    FALSE_ALARM,
    entry_tests,
    gain_p_value,
    holm_significant,
    pair_couplings,
    ring_shape,
    significant_rank,
    symmetry,
)
from truing.estimation.rigid_poses.frame import residual_covariance
from truing.estimation.rigid_poses.points import SurveyPoints

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Shifts:
    """Shift of each leg's attachment along z of the platform.

    shift (B, L) in m, NaN where not seen; across (B, L, 2) the same along x and y, which gross errors show;
    noise (B, L, L) of the measurement, own (B, L) variance of what the attachment's own targets bring to it, survey
    (L, L) of the survey, and of cameras and bars, which all poses share; attachments (L, 3);
    modulo_plane: the frame was fitted to the attachments themselves; together: where points have errors in common.
    """

    shift: Array
    across: Array
    noise: Array
    own: Array
    survey: Array
    attachments: Array
    modulo_plane: bool
    together: CorrelatedShifts | None


def attachment_deformation(tables: Mapping[str, pa.Table], rest_mm: Sequence[float]) -> Outcome:
    """Shifts of the attachments, their linear and matrix models, and what these say (telescope report, eq. 1-4)."""
    poses, drive, heldout = _drives(tables["configurations"], tables["residuals"], rest_mm)
    shifts = _shifts(tables, poses, len(rest_mm))
    fitted = ~heldout
    prior = {"offset_cov": shifts.survey}
    good = np.isfinite(shifts.shift) & _consistent_attachments(drive, shifts, fitted)
    kept = np.where(good, shifts.shift, np.nan)
    fits = fit_models(drive[fitted], kept[fitted], shifts.noise[fitted], ("none", "linear", "matrix"), **prior)
    gains = _gains(fits)
    fits["linear"] = _leg_by_leg(drive[fitted], kept[fitted], shifts.noise[fitted])
    told = _determined(drive[fitted], kept[fitted])
    fits = {name: fit for name, fit in fits.items() if told[name].any()}
    held = {name: kept[heldout] - fit.offset.mean(0) - fit.predict(drive[heldout]) for name, fit in fits.items()}
    rejected = np.isfinite(shifts.shift) & ~good
    identifier = "int64" if isinstance(poses[0], int) else "string"
    artifacts = {
        "deformation": _deformation_rows(poses, drive, shifts, rejected).table(identifier),
        "deformation_models": _model_rows(fits, told).table(),
        "deformation_errors": _error_rows(fits, gains, held, shifts, kept[fitted], bool(told["matrix"].all())).table(),
    }
    if shifts.together is not None:
        artifacts |= handed_on(shifts.together, poses, np.isfinite(shifts.shift), identifier)
    return Outcome(artifacts, *_words(shifts, rejected, fits))


def _determined(drive: Array, shift: Array) -> dict[str, NDArray[np.bool_]]:
    """(L,) legs whose coefficients the shifts (B, L) at drives (B, L) determine, by model.

    The others would be the shortest of many solutions with a standard deviation that says nothing.
    """
    seen = [drive[rows] for rows in np.isfinite(shift).T]
    moved = [len(u) > 1 and bool(np.ptp(u[:, leg]) > 0.0) for leg, u in enumerate(seen)]
    spanned = [len(u) >= u.shape[1] and np.linalg.matrix_rank(u) == u.shape[1] for u in seen]
    return {"none": np.ones(len(seen), bool), "linear": np.array(moved), "matrix": np.array(spanned)}


def _gains(fits: Mapping[str, ResponseFit]) -> Rows:
    """Whether each larger model earns its parameters; all three fitted with the same weights, as an F test asks."""
    rows = Rows("deformation_errors")
    linear, matrix = fits["linear"], fits["matrix"]
    rows.add(model="linear", figure="p_value_over_none", value=gain_p_value(fits["none"], linear), unit="1")
    rows.add(model="matrix", figure="p_value_over_linear", value=gain_p_value(linear, matrix), unit="1")
    return rows


def _leg_by_leg(drive: Array, shift: Array, noise: Array) -> ResponseFit:
    """The linear model as eq. 1 has it, each leg regressed by itself with an offset of its own.

    Where the other actuators move an attachment too, the model is wrong; weights that carry one leg's misfit into
    another's coefficient, or an offset held to the survey, would then answer another question.
    """
    alone = noise * np.eye(noise.shape[1])
    return fit_response(drive, shift, alone, form="linear")


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
    residual = residual_points(tables["residuals"], "platform", poses, survey.targets)
    observed = pose_points(tables["observations"], "platform", poses, survey.targets)
    used = used_targets(tables["residuals"], "platform", poses, survey.targets)
    rotation = default_rotations(tables["poses"], "platform", poses)
    seen = np.isfinite(residual[:, :, 2])
    noise = np.einsum("bji,btjk,bkl->btil", rotation, observed.cov, rotation)
    per_leg = _leg_average(survey, seen, noise, n_legs)
    measured = _along_z(residual_covariance(survey.points, noise, used, seen))
    surveyed = _along_z(_survey_covariance(survey, used))
    shift = np.einsum("blt,bta->bla", per_leg, np.nan_to_num(residual))
    shift[~per_leg.any(axis=2)] = np.nan
    typical = _typical_average(survey, n_legs)
    of_points, shared = np.einsum("blt,bts,bms->blm", per_leg, measured, per_leg), typical @ surveyed @ typical.T
    together = correlated_shifts(tables, poses, per_leg)
    if together is not None:  # a pose without a joint fit keeps what its points say one by one
        of_points, shared = np.where(together.there[:, None, None], together.noise, of_points), together.shared
    return Shifts(
        shift[:, :, 2],
        shift[:, :, :2],
        of_points,
        np.einsum("blt,bt->bl", per_leg**2, noise[:, :, 2, 2]),
        shared,
        typical @ survey.points,
        bool((used & (survey.leg > 0)).any()),
        together,
    )


def _consistent_attachments(drive: Array, shifts: Shifts, fitted: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(B, L) attachments whose shift, along z and across it, agrees with a matrix model of its own direction.

    The noise along z stands for that across: a gross error is many times either.
    """
    directions = (shifts.shift, shifts.across[:, :, 0], shifts.across[:, :, 1])
    kept = [keep_consistent(drive, y, shifts.noise, offset_cov=shifts.survey, fitted=fitted) for y in directions]
    return np.logical_and.reduce(kept)


def _along_z(covariance: Array) -> Array:
    return covariance[..., 2::3, 2::3]


def _survey_covariance(survey: SurveyPoints, used: NDArray[np.bool_]) -> Array:
    """(3T, 3T) covariance that the survey's own noise leaves in every pose's residuals alike."""
    usual = used.mean(axis=0) > 0.5
    everywhere = np.ones((1, len(survey.targets)), bool)
    return residual_covariance(survey.points, survey.cov[None], usual[None], everywhere)[0]


def _leg_average(survey: SurveyPoints, seen: NDArray[np.bool_], noise: Array, n_legs: int) -> Array:
    """(B, L, T) weights that average the targets of each attachment, by their noise along z; zero rows where
    none was seen."""
    member = survey.leg[None, :] == np.arange(1, n_legs + 1)[:, None]
    variance = np.where(noise[:, :, 2, 2] > 0.0, noise[:, :, 2, 2], np.inf)
    weight = member[None] * np.where(seen, 1.0 / variance, 0.0)[:, None, :]
    total = weight.sum(axis=2, keepdims=True)
    return np.divide(weight, total, out=np.zeros_like(weight), where=total > 0.0)


def _typical_average(survey: SurveyPoints, n_legs: int) -> Array:
    member = (survey.leg[None, :] == np.arange(1, n_legs + 1)[:, None]).astype(float)
    return member / np.maximum(member.sum(axis=1, keepdims=True), 1.0)


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


def _error_rows(
    fits: Mapping[str, ResponseFit], gains: Rows, held: Mapping[str, Array], shifts: Shifts, kept: Array, whole: bool
) -> Rows:
    rows = Rows("deformation_errors")
    for name, fit in fits.items():
        error_rows(rows, name, fit, {**residual_sets(fit), "verification_": held[name]}, "um", 1e6, None)
    if whole:
        rows.extend(gains)
        rows.add(model="matrix", figure="modulo_plane", value=float(shifts.modulo_plane), unit="1")
        if not shifts.modulo_plane:  # else what is left of K has no structure of its own
            _structure_rows(rows, fits["matrix"])
    _shape_rows(rows, kept, shifts.attachments)
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
    read = f"{seen} shifts at {shifts.shift.shape[1]} attachments in {len(shifts.shift)} poses"
    left_out = f"{int(rejected.sum())} shifts as gross errors" if rejected.any() else "nothing"
    rms = {name: 1e6 * float(np.sqrt(np.nanmean(fit.residuals**2))) for name, fit in fits.items()}
    told = [f"{rms[name]:.1f} {name}" for name in ("linear", "matrix") if name in rms]
    figure = ", ".join([f"rms left {rms['none']:.1f} um without a model", *told])
    untold = [name for name in ("linear", "matrix") if name not in rms]
    figure += f"; not evaluated: {', '.join(untold)}, which so few movements leave open" if untold else ""
    if shifts.modulo_plane:
        figure += "; modulo a plane: fewer than three platform targets away from the attachments"
    return read, left_out, figure
