"""Shifts within bodies: attachments over actuators, targets over drives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from truing.arrays import Array, Index, Mask
from truing.estimation.deformation import (
    AttachmentModels,
    BodyShifts,
    CorrelatedShifts,
    LegShifts,
    attachment_models,
    attachment_shifts,
    body_shifts,
    correlated_residuals,
    target_models,
    with_common_errors,
)
from truing.estimation.driven_shift import driven_shift
from truing.estimation.measured_numbers import shift_number
from truing.estimation.response import (
    FALSE_ALARM,
    ResponseFit,
    entry_tests,
    gain_p_value,
    holm_significant,
    pair_couplings,
    residual_sets,
    ring_shape,
    significant_rank,
    symmetry,
)
from truing.estimation.rigid_poses.joint_frames import FramedBody, FramedPoints, mean_shape
from truing.report.numbers import count_text, gross_errors
from truing.schemas.artifacts import ARTIFACTS
from truing.stages.common.missing_data import (
    NO_BODIES,
    NO_POINTS_TO_DEFORM,
    why_no_deformation_of_legs,
    why_no_deformation_of_targets,
)
from truing.stages.common.point_arrays import (
    fitted_points,
    number_columns,
    observation_rows,
    pose_ids,
    survey_points,
    text_column,
)
from truing.stages.common.point_errors import common_correlation, point_errors
from truing.stages.common.rows import Rows
from truing.stages.declaration import Outcome
from truing.stages.responses import simulated_shifts
from truing.stages.responses.tables import ReportedResponses, add_figures, error_rows

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import LeggedMechanism

IN_PLANE = "in-plane"  # the model of shifts along x and y
LEAVES = ("deformation", "deformation_models", "deformation_errors")
NETWORK = ("point_correlations", "point_sensitivities", "object_points")


def framed_points(tables: Mapping[str, pa.Table], poses: tuple[int | str, ...]) -> FramedPoints | None:
    """Return all bodies with the common errors of their observations; None if points are independent."""
    errors = point_errors(tables["observations"], *(tables.get(name) for name in NETWORK))
    if errors is None:
        return None
    correlation = common_correlation(tables.get("camera_correlations"), errors.parameters)
    return FramedPoints(framed_bodies(tables, poses), errors, correlation)


def framed_bodies(tables: Mapping[str, pa.Table], poses: tuple[int | str, ...]) -> list[FramedBody]:
    """Return all bodies with poses, relative to their survey or to the shape that defines their residuals."""
    table = tables["poses"]
    parents = dict(zip(text_column(table, "body"), text_column(table, "parent"), strict=True))
    observed = dict.fromkeys(text_column(tables["observations"], "body"))
    return [_framed(tables, name, parents[name], poses) for name in observed if name in parents]


def _framed(tables: Mapping[str, pa.Table], name: str, parent: str, poses: tuple[int | str, ...]) -> FramedBody:
    surveyed = survey_points(tables["survey"], name) if "survey" in tables else None
    found = fitted_points(tables, name, poses, (surveyed and surveyed.targets) or None)
    points, used = found.points, found.used & found.points.is_observed
    frame: Mask = np.ones(len(points.targets), bool)
    if surveyed is not None and surveyed.targets:
        source, cov, cov_shape = surveyed.points, surveyed.cov, surveyed.cov
        frame = points.is_observed.any(axis=0) & surveyed.frame
    else:
        source, cov_shape = mean_shape(found.R, found.t, used, points, found.residual)
        cov = np.zeros_like(cov_shape)
    row = observation_rows(tables["observations"], name, poses, points.targets)
    return FramedBody(
        name, parent, points.targets, source, cov, cov_shape, frame, found.R, found.t, points.points, used, row
    )


def shift_uncertainty_tables(
    shifts: CorrelatedShifts, poses: tuple[int | str, ...], is_observed: Mask, identifier: str
) -> dict[str, pa.Table]:
    """Return artifacts with the correlations of the shifts ``is_observed`` (B, L) with poses, with each other and
    between poses."""
    covariances, sensitivities = Rows("shift_covariances"), Rows("shift_sensitivities")
    determined = is_observed & shifts.there[:, None]
    b, leg, number = np.nonzero(determined[:, :, None] & np.isfinite(shifts.with_poses))
    _covariance_rows(covariances, poses, b, leg, [shifts.numbers[i] for i in number], shifts.with_poses[b, leg, number])
    b, leg, second = np.nonzero(determined[:, :, None] & determined[:, None] & np.tri(determined.shape[1], dtype=bool))
    _covariance_rows(covariances, poses, b, leg, _shift_numbers(second), shifts.whole[b, leg, second])
    b, leg, parameter = np.nonzero(np.broadcast_to(determined[..., None], shifts.effects.shape))
    sensitivities.add(
        pose=[poses[i] for i in b],
        leg=leg + 1,
        parameter=[shifts.parameters[i] for i in parameter],
        effect_um=shifts.effects[b, leg, parameter] * 1e6,
    )
    names = [*shifts.numbers, *_shift_numbers(np.arange(determined.shape[1]))]
    first, second = np.nonzero(np.tri(len(names), dtype=bool))
    frames = Rows("survey_covariances")
    frames.add(
        measured_number=[names[i] for i in first],
        other_number=[names[i] for i in second],
        joint_covariance=shifts.of_frames[first, second],
    )
    return {rows.artifact: rows.table(identifier) for rows in (covariances, sensitivities, frames)}


def _covariance_rows(
    rows: Rows, poses: tuple[int | str, ...], b: Index, leg: Index, other: Sequence[object], value: Array
) -> None:
    rows.add(
        pose=[poses[i] for i in b],
        measured_number=_shift_numbers(leg),
        other_number=list(other),
        joint_covariance=value,
    )


def _shift_numbers(leg: Index) -> list[str]:
    return [shift_number(int(i) + 1) for i in leg]


def shifts_within_bodies(tables: Mapping[str, pa.Table], settings: Campaign, why: str = "") -> Outcome:
    """Return the deformation of a mechanism's platform, or of bodies without a mechanism; ``why``: reason to withhold
    results."""
    mechanism, drives = settings.mechanism, settings.campaign.drives
    no_points = not (tables["observations"].num_rows if "observations" in tables else 0)
    if why := why or NO_BODIES.get(mechanism.type, ""):
        pass
    elif mechanism.is_legged:
        pointless = no_points and "observations" in tables and "configurations" in tables
        why = NO_POINTS_TO_DEFORM if pointless else why_no_deformation_of_legs(tables)
    elif not (why := why_no_deformation_of_targets(drives, tables, mechanism.type)) and no_points:
        why = "no targets, whose movement within their body could be seen"
    if why:
        return Outcome.not_evaluated({name: ARTIFACTS[name].empty() for name in LEAVES}, why)
    if mechanism.is_legged:
        legs = cast("LeggedMechanism", mechanism).legs
        return attachment_deformation(tables, [leg.rho0_mm for leg in legs])
    return target_deformation(tables, drives)


def attachment_deformation(tables: Mapping[str, pa.Table], rest_mm: Sequence[float]) -> Outcome:
    """Return the shifts of the attachments, their linear and matrix models, and test results (telescope report, eq.
    1-4).

    ``rest_mm``: actuator readings of the reference configuration, by leg.
    """
    poses, drive, heldout = _drives(tables["configurations"], tables["residuals"], rest_mm)
    survey = survey_points(tables["survey"], "platform")
    platform = fitted_points(tables, "platform", poses, survey.targets)
    shifts = attachment_shifts(survey, platform, framed_points(tables, poses), len(rest_mm))
    models = attachment_models(drive, shifts, heldout)
    errors, (read, left_out, figure) = (
        _leg_error_rows(models, shifts, drive),
        _leg_words(shifts, models.rejected, models.fits),
    )
    identifier = "int64" if isinstance(poses[0], int) else "string"
    artifacts = {
        "deformation": _deformation_rows(poses, drive, shifts, models.rejected).table(identifier),
        "deformation_models": _leg_model_rows(models).table(),
    }
    if "given_deformation" in tables:
        declared_deformation = simulated_shifts.given_deformation(tables["given_deformation"])
        figure += f"; {_compare_with_simulation(artifacts, errors, drive, models, shifts, declared_deformation)}"
    artifacts["deformation_errors"] = errors.table()
    if shifts.together is not None:
        artifacts |= shift_uncertainty_tables(shifts.together, poses, np.isfinite(shifts.shift), identifier)
    return Outcome(artifacts, read, left_out, figure)


def _compare_with_simulation(
    artifacts: dict[str, pa.Table],
    errors: Rows,
    drive: Array,
    models: AttachmentModels,
    shifts: LegShifts,
    simulated: tuple[Array, Array],
) -> str:
    """Add the comparison with the simulated K, and its residuals of the shifts; the closing words."""
    comparison = simulated_shifts.compared(models, shifts, simulated)
    artifacts["simulated_deformation"] = simulated_shifts.entry_rows(comparison).table()
    if comparison is not None:
        simulated_shifts.add_comparison(errors, comparison)
        fit = simulated_shifts.simulated_fit(drive, models, shifts, simulated[0])
        held_out_errors = models.kept[~models.fitted] - fit.offset.mean(0) - drive[~models.fitted] @ simulated[0].T
        sets = {**residual_sets(fit), "verification_": held_out_errors}
        error_rows(errors, simulated_shifts.SIMULATED, fit, sets)
    return simulated_shifts.words(comparison)


def _drives(
    configurations: pa.Table, residuals: pa.Table, rest_mm: Sequence[float]
) -> tuple[tuple[int | str, ...], Array, Mask]:
    """Return the poses with residuals, actuator displacements (B, L) in m, and the mask of held-out poses."""
    measured = set(pose_ids(residuals))
    poses = configurations.column("pose").to_pylist()
    rows = np.array([i for i, pose in enumerate(poses) if pose in measured], dtype=np.int64)
    reading = number_columns(configurations, [f"rho{i + 1}_mm" for i in range(len(rest_mm))])
    drive = (reading[rows] - np.asarray(rest_mm)) * 1e-3
    role = np.array(configurations.column("role").to_pylist(), dtype=object)[rows]
    return tuple(poses[i] for i in rows), drive, role == "verification"


def _deformation_rows(poses: tuple[int | str, ...], drive: Array, shifts: LegShifts, rejected: Mask) -> Rows:
    from scipy.special import ndtr

    scatter = np.einsum("bll->bl", shifts.noise)
    sigma = np.sqrt(scatter + np.diag(shifts.survey))
    p = 2.0 * ndtr(-np.abs(shifts.shift) / sigma)
    significant = holm_significant(np.where(rejected, np.nan, p), FALSE_ALARM)
    b, leg = np.nonzero(np.isfinite(shifts.shift))
    total = np.einsum("bnn->bn", shifts.noise_across) + np.diag(shifts.survey_across)
    sigma_across = np.sqrt(total).reshape(shifts.across.shape)
    across = {f"delta_b{axis}_um": shifts.across[b, leg, n] * 1e6 for n, axis in enumerate("xy")}
    across |= {f"sigma_b{axis}_um": sigma_across[b, leg, n] * 1e6 for n, axis in enumerate("xy")}
    rows = Rows("deformation")
    rows.add(
        pose=[poses[i] for i in b],
        leg=leg + 1,
        delta_rho_mm=drive[b, leg] * 1e3,
        delta_bz_um=shifts.shift[b, leg] * 1e6,
        sigma_um=sigma[b, leg] * 1e6,
        own_sigma_um=np.sqrt(shifts.own[b, leg]) * 1e6,
        **across,
        **({"scatter_sigma_um": np.sqrt(scatter[b, leg]) * 1e6} if shifts.together else {}),
        p_value=p[b, leg],
        significant=significant[b, leg],
        rejected=rejected[b, leg],
        reason=["gross error: far from every model that fits the rest" if r else None for r in rejected[b, leg]],
    )
    return rows


def _leg_model_rows(models: AttachmentModels) -> Rows:
    rows = Rows("deformation_models")
    for name in [name for name in ("linear", "matrix") if name in models.fits]:
        _coefficient_rows(rows, name, models.fits[name], models.determined[name], "z")
    if models.in_plane:
        every = np.ones(2 * len(models.determined["matrix"]), bool)
        _coefficient_rows(rows, IN_PLANE, models.in_plane["matrix"], every, "xy")
    return rows


def _coefficient_rows(rows: Rows, name: str, fit: ResponseFit, determined: Mask, axes: str) -> None:
    """Add the coefficients of a model of shifts along some axes, leg by leg."""
    sigma, p, significant = entry_tests(fit)
    shift, column = np.nonzero(fit.free & determined[:, None])
    rows.add(
        model=name,
        leg=shift // len(axes) + 1,
        axis=[axes[n % len(axes)] for n in shift],
        column=column + 1,
        coefficient=fit.coefficients[shift, column],
        sigma=sigma[shift, column],
        unit="1",
        p_value=p[shift, column],
        significant=significant[shift, column],
    )


def _leg_error_rows(models: AttachmentModels, shifts: LegShifts, drive: Array) -> Rows:
    rows = Rows("deformation_errors")
    for name, fit in models.fits.items():
        error_rows(rows, name, fit, {**residual_sets(fit), "verification_": models.held[name]})
    if models.determined["matrix"].all():
        for name, below in (("linear", "none"), ("matrix", "linear")):
            add_figures(rows, name, {f"p_value_over_{below}": models.gains[name]})
        add_figures(rows, "matrix", {"modulo_plane": shifts.modulo_plane})
        if not shifts.modulo_plane:  # else what is left of K has no structure of its own
            _structure_rows(rows, models.fits["matrix"])
    _shape_rows(rows, models.kept[models.fitted], shifts.attachments)
    if models.in_plane:
        _in_plane_rows(rows, **models.in_plane)
        for name, fit in (("matrix", models.fits["matrix"]), (IN_PLANE, models.in_plane["matrix"])):
            size = driven_shift(fit, drive[models.fitted])
            figures = {"rms_following": size.rms, "rms_following_upper": size.upper, "rms_detectable": size.detectable}
            for figure, value in figures.items():
                if np.isfinite(value):
                    rows.add(model=name, figure=figure, value=1e6 * value, unit="um")
    return rows


def _in_plane_rows(rows: Rows, none: ResponseFit, matrix: ResponseFit) -> None:
    """Add the rms shift of attachments along x and y, and the test of its dependence on the actuators."""
    for name, fit in (("shift", none), ("left", matrix)):
        size = 1e6 * float(np.sqrt(np.nanmean(fit.residuals**2)))
        rows.add(model=IN_PLANE, figure=f"rms_{name}", value=size, unit="um")
    ratio = float(np.sqrt(matrix.chi_square / max(matrix.dof, 1)))
    add_figures(rows, IN_PLANE, {"noise_ratio": ratio, "p_value_over_none": gain_p_value(none, matrix)})


def _structure_rows(rows: Rows, matrix: ResponseFit) -> None:
    """Add rank, symmetry and pair couplings of K."""
    even, rank = symmetry(matrix), significant_rank(matrix, FALSE_ALARM)
    add_figures(rows, "matrix", {"rank": rank, "asymmetry": even.relative, "symmetry_p_value": even.p_value})
    for i, j, strength, p in pair_couplings(matrix):
        add_figures(rows, "matrix", {"coupling": strength, "coupling_p_value": p}, f"leg{i + 1} leg{j + 1}")


def _shape_rows(rows: Rows, shifts: Array, attachments: Array) -> None:
    """Add the shares of lift, tilt and buckling in the shifts, and the dominant shape."""
    complete = shifts[np.isfinite(shifts).all(axis=1)]
    if not len(complete):
        return
    shape = ring_shape(complete, attachments)
    shares = {"lift": shape.lift, "tilt": shape.tilt, "buckle": shape.buckle, "principal": shape.principal_share}
    add_figures(rows, "none", {f"share_{name}": share for name, share in shares.items()})
    rows.add(model="none", figure="principal_amplitude", value=shape.amplitude * 1e6, unit="um")
    rows.add(
        model="none", leg=np.arange(1, len(attachments) + 1), figure="principal_shape", value=shape.principal, unit="1"
    )


def _leg_words(shifts: LegShifts, rejected: Mask, fits: Mapping[str, ResponseFit]) -> tuple[str, str, str]:
    seen = int(np.isfinite(shifts.shift).sum())
    read = (
        f"{count_text(seen, 'shift')} at {count_text(shifts.shift.shape[1], 'attachment')} in "
        f"{count_text(len(shifts.shift), 'pose')}"
    )
    left_out = gross_errors(int(rejected.sum()), "shift") if rejected.any() else "nothing"
    rms = {name: 1e6 * float(np.sqrt(np.nanmean(fit.residuals**2))) for name, fit in fits.items()}
    names = {"none": "without a model", "linear": "linear model", "matrix": "matrix model"}
    figure = "rms residual " + ", ".join(f"{rms[name]:.1f} µm {words}" for name, words in names.items() if name in rms)
    absent = [words for name, words in names.items() if name not in rms]
    figure += f"; not evaluated: {', '.join(absent)} (too few movements)" if absent else ""
    if shifts.modulo_plane:
        figure += "; modulo a plane: fewer than three platform targets away from the attachments"
    return read, left_out, figure


def target_deformation(tables: Mapping[str, pa.Table], drives: tuple[str, ...]) -> Outcome:
    """Fit all bodies' residuals to the drives; one free offset per coordinate, for the shape at rest."""
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
        _target_shift_rows(shifts, found)
        fitted = ~heldout & np.isfinite(u).all(axis=1)
        if fitted.sum() <= len(drives) + 1 or len(found.targets) < 3:
            words.append(f"{body} not evaluated (too few poses or targets)")
            continue
        fits = target_models(found, u, fitted)
        _target_model_rows(models, found, fits["matrix"], drives)
        _target_error_rows(errors, found, fits)
        words.append(_target_words(found, fits))
    identifier = "int64" if isinstance(found.poses[0], int) else "string"
    artifacts = {
        "deformation": Rows("deformation").table(identifier),
        "deformation_models": models.table(),
        "deformation_errors": errors.table(),
        "target_deformation": shifts.table(identifier),
    }
    read = (
        f"{count_text(shifts.count // 3, 'residual')} of {count_text(len(bodies), 'body')} against {', '.join(drives)}"
    )
    return Outcome(artifacts, read=read, left_out="nothing", figure="; ".join(words))


def _body_shifts(tables: Mapping[str, pa.Table], body: str) -> BodyShifts:

    rows = tables["residuals"].filter(pc.equal(tables["residuals"].column("body"), body))
    poses, targets = pose_ids(rows), tuple(dict.fromkeys(rows.column("target").to_pylist()))
    return body_shifts(body, fitted_points(tables, body, poses, targets))


def _drive_values(
    configurations: pa.Table, poses: tuple[int | str, ...], drives: tuple[str, ...]
) -> tuple[Array, Mask]:
    """Return the drives (B, D) minus their mean, so that the offset is the mean shape, and the mask of held-out
    poses."""
    known = {pose: i for i, pose in enumerate(configurations.column("pose").to_pylist())}
    rows = np.array([known[pose] for pose in poses])
    u = number_columns(configurations, drives)[rows]
    role = np.array(configurations.column("role").to_pylist(), dtype=object)[rows]
    return u - np.nanmean(u, axis=0), role == "verification"


def _target_shift_rows(rows: Rows, shifts: BodyShifts) -> None:
    b, t, axis = np.nonzero(np.isfinite(shifts.shift))
    sigma = np.sqrt(np.einsum("bll->bl", shifts.noise)).reshape(shifts.shift.shape)
    rows.add(
        pose=[shifts.poses[i] for i in b],
        body=shifts.body,
        target=[shifts.targets[i] for i in t],
        axis=["xyz"[i] for i in axis],
        displacement_um=shifts.shift[b, t, axis] * 1e6,
        sigma_um=sigma[b, t, axis] * 1e6,
    )


def _target_model_rows(rows: Rows, shifts: BodyShifts, fit: ResponseFit, drives: tuple[str, ...]) -> None:
    sigma, p, significant = entry_tests(fit)
    entry, drive = np.nonzero(fit.free & (sigma > 0.0))  # a drive that never moved says nothing
    rows.add(
        model="linear",
        body=shifts.body,
        target=[shifts.targets[i // 3] for i in entry],
        axis=["xyz"[i % 3] for i in entry],
        drive=[drives[i] for i in drive],
        column=drive + 1,
        coefficient=fit.coefficients[entry, drive] * 1e6,
        sigma=sigma[entry, drive] * 1e6,
        unit=[f"um per unit of {drives[i]}" for i in drive],
        p_value=p[entry, drive],
        significant=significant[entry, drive],
    )


def _target_error_rows(rows: Rows, shifts: BodyShifts, fits: Mapping[str, ResponseFit]) -> None:
    of_body = ReportedResponses(names=(), subject=shifts.body)
    for name, form in (("none", "none"), ("linear", "matrix")):
        error_rows(rows, name, fits[form], residual_sets(fits[form]), of_body)
    gain = gain_p_value(fits["none"], fits["matrix"])
    add_figures(rows, "linear", {"p_value_over_none": gain}, shifts.body)


def _target_words(shifts: BodyShifts, fits: Mapping[str, ResponseFit]) -> str:
    rms = {name: 1e6 * float(np.sqrt(np.nanmean(fit.residuals**2))) for name, fit in fits.items()}
    return f"{shifts.body} {rms['none']:.1f} um left at rest, {rms['matrix']:.1f} with the drives"
