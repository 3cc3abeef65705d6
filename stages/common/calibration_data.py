"""Data of a calibration from a run's tables: poses and readings with their covariances, and prior knowledge."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from truing.arrays import TableRow
from truing.calibration.calibration_input import (
    CalibrationData,
    Deformation,
    MeasuredPlatform,
    PosesWithCovariance,
    SurveyedAttachments,
    SurveyShifts,
)
from truing.estimation.measured_numbers import NetworkErrors, pose_numbers, shift_number
from truing.estimation.rigid_poses.points import SurveyPoints
from truing.estimation.rotation import exp_so3
from truing.stages.common.external_load import external_loads
from truing.stages.common.nominal_mechanism import facing, nominal_machine
from truing.stages.common.point_arrays import (
    number_column,
    number_columns,
    pose_covariances,
    pose_ids,
    pose_vectors,
    positions,
    survey_points,
)
from truing.stages.common.point_errors import common_correlation

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import LeggedMechanism

_EFFECTS = (*(f"effect_{a}_mm" for a in "xyz"), *(f"effect_r{a}_rad" for a in "xyz"))
_TO_SI = np.array([1e-3] * 3 + [1.0] * 3)
_NOTHING = 1e-9  # share of a variance
_TABLES = ("pose_sensitivities", "pose_covariances", "shift_covariances", "shift_sensitivities")


def network_errors(
    tables: Mapping[str, pa.Table], poses: tuple[int | str, ...], bodies: Mapping[str, NDArray], legs: int
) -> NetworkErrors | None:
    """Return the errors of body poses from the network of rays, each with covariances (B, 6, 6), and of the attachment
    shifts; None for independent points."""
    if not any(name in tables and tables[name].num_rows for name in _TABLES):
        return None
    numbers = [str(name) for body in bodies for name in pose_numbers(body)]
    numbers += [shift_number(leg + 1) for leg in range(legs)]
    covariance = np.full((len(poses), len(numbers), len(numbers)), np.nan)
    for n, body_name in enumerate(bodies.values()):
        covariance[:, 6 * n : 6 * n + 6, 6 * n : 6 * n + 6] = body_name
    for name in ("pose_covariances", "shift_covariances"):
        _store_covariances(covariance, tables.get(name), poses, tuple(numbers))
    of_survey = _survey_covariance(tables.get("survey_covariances"), tuple(numbers))
    shifted = np.arange(len(numbers)) >= 6 * len(bodies)  # whose covariances do not include the survey
    covariance += np.where(shifted[:, None] | shifted, of_survey, 0.0)
    parameters, effects = _effects(tables, poses, list(bodies), legs)
    root = _root(common_correlation(tables.get("camera_correlations"), parameters))
    in_all = np.repeat(_root(of_survey)[None], len(poses), 0)
    return NetworkErrors(tuple(numbers), covariance, np.concatenate([effects @ root, in_all], -1))


def _survey_covariance(table: pa.Table | None, numbers: tuple[str, ...]) -> NDArray:
    """Return the covariance (Q, Q) from the survey, common to all poses."""
    covariance = np.zeros((len(numbers), len(numbers)))
    if table is not None and table.num_rows:
        first, second = (positions(table.column(f"{name}_number"), numbers) for name in ("measured", "other"))
        is_known = (first >= 0) & (second >= 0)
        value = number_column(table, "joint_covariance")[is_known]
        covariance[first[is_known], second[is_known]] = covariance[second[is_known], first[is_known]] = value
    return covariance


def _store_covariances(
    covariance: NDArray, table: pa.Table | None, poses: tuple[int | str, ...], numbers: tuple[str, ...]
) -> None:
    if table is None or not table.num_rows:
        return
    keys = (table.column("pose"), poses), *((table.column(f"{o}_number"), numbers) for o in ("measured", "other"))
    pose, first, second = (positions(*column_and_order) for column_and_order in keys)
    is_known = (pose >= 0) & (first >= 0) & (second >= 0)
    value = number_column(table, "joint_covariance")[is_known]
    covariance[pose[is_known], first[is_known], second[is_known]] = covariance[
        pose[is_known], second[is_known], first[is_known]
    ] = value


def _effects(
    tables: Mapping[str, pa.Table], poses: tuple[int | str, ...], bodies: list[str], legs: int
) -> tuple[tuple[str, ...], NDArray]:
    """Return the common parameters, and the effect of one standard deviation of each (B, Q, K), SI."""
    tables_given = [tables.get(name) for name in ("pose_sensitivities", "shift_sensitivities")]
    sensitivities = [table for table in tables_given if table is not None]
    parameters = tuple(dict.fromkeys(name for table in sensitivities for name in table.column("parameter").to_pylist()))
    effects = np.zeros((len(poses), 6 * len(bodies) + legs, len(parameters)))
    for table, columns, si in (
        (tables_given[0], _EFFECTS, _TO_SI),
        (tables_given[1], ("effect_um",), np.array([1e-6])),
    ):
        if table is None or not table.num_rows:
            continue
        pose, parameter = positions(table.column("pose"), poses), positions(table.column("parameter"), parameters)
        if len(columns) > 1:
            first = 6 * positions(table.column("body"), tuple(bodies))
        else:
            first = 6 * len(bodies) + number_column(table, "leg").astype(int) - 1
        is_known = (pose >= 0) & (first >= 0)
        values = number_columns(table, columns) * si
        for n in range(len(columns)):
            effects[pose[is_known], first[is_known] + n, parameter[is_known]] = values[is_known, n]
    return parameters, effects


def _root(covariance: NDArray) -> NDArray:
    """Return G (K, k) with G G' the covariance, without empty columns."""
    scale = np.sqrt(np.diag(covariance))
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    determined = values > _NOTHING
    return np.asarray(scale[:, None] * vectors[:, determined] * np.sqrt(values[determined]))


def assemble(tables: Mapping[str, pa.Table], settings: Campaign) -> CalibrationData:
    """Return the data of a calibration; raises ValueError with the reason if the campaign lacks them."""
    section_ = cast("LeggedMechanism", settings.mechanism)
    count = len(section_.legs)
    poses = pose_ids(tables["configurations"])
    base = body_poses(tables["poses"], "base", poses, parent="measurement")
    platform = body_poses(tables["poses"], "platform", poses)
    rho = _readings(tables["configurations"], poses, count)
    usable = platform.found & np.isfinite(rho).all(1)
    legs = {leg: body_poses(tables["poses"], f"leg{leg + 1}", poses) for leg in range(count)}
    carrying = {leg: leg_poses for leg, leg_poses in legs.items() if leg_poses.found.any()}
    machine = nominal_machine(section_)
    surveyed = _surveyed_attachments(tables, settings)
    shifts = None if surveyed is None else _shifts(tables.get("deformation"), poses, count)
    roles = _roles(tables["configurations"], poses)
    seen = {"platform": platform} | {f"leg{leg + 1}": leg_poses for leg, leg_poses in carrying.items()}
    network = network_errors(tables, poses, {name: leg_poses.covariance for name, leg_poses in seen.items()}, count)
    load = external_loads(settings, tables["configurations"], platform.R) if section_.is_elastic else None
    measured = MeasuredPlatform(poses, roles, base, platform, rho, carrying, shifts, network, load).subset(usable)
    if not usable.any():
        raise ValueError("no pose has both readings and a pose of the platform in the base")
    return CalibrationData(
        measured,
        replace(machine, legs=facing(machine.legs, tables["poses"])),
        _tolerances(section_),
        settings.noise.actuator_mm * 1e-3,
        _deformations(tables.get("deformation_models"), count),
        surveyed,
        "" if usable.all() else f"{int((~usable).sum())} poses without readings or without a pose of the platform",
        _in_plane(tables.get("deformation_models"), count) if settings.calibration.deformation == "in-plane" else None,
        "survey" in tables and _rests_on_attachments(survey_points(tables["survey"], "platform")),
    )


def _rests_on_attachments(platform: SurveyPoints) -> bool:
    """True if the attachments themselves define the platform's frame, so that their motion is not observable."""
    return bool(np.any(platform.frame & (platform.leg > 0)))


def body_poses(table: pa.Table, body: str, poses: tuple[int | str, ...], parent: str = "base") -> PosesWithCovariance:
    """Default poses of a body in its parent, in the given order; NaN for missing or failed ones."""
    is_pose = pc.and_(pc.equal(table.column("body"), body), pc.equal(table.column("parent"), parent))
    good = pc.and_(table.column("default"), pc.equal(table.column("status"), "ok"))
    rows = table.filter(pc.and_(is_pose, good))
    index = positions(rows.column("pose"), poses)
    motions, covariance = np.full((len(poses), 6), np.nan), np.full((len(poses), 6, 6), np.nan)
    is_known = index >= 0
    motions[index[is_known]], covariance[index[is_known]] = (
        pose_vectors(rows)[is_known],
        pose_covariances(rows)[is_known],
    )
    return PosesWithCovariance(motions[:, :3], exp_so3(np.nan_to_num(motions[:, 3:])), covariance)


def _readings(configurations: pa.Table, poses: tuple[int | str, ...], legs: int) -> NDArray:
    readings = np.full((len(poses), legs), np.nan)
    columns = [number_column(configurations, f"rho{leg}_mm") for leg in range(1, legs + 1)]
    readings[positions(configurations.column("pose"), poses)] = np.column_stack(columns) * 1e-3
    return readings


def _shifts(table: pa.Table | None, poses: tuple[int | str, ...], legs: int) -> SurveyShifts | None:
    if table is None or not table.num_rows or "own_sigma_um" not in table.schema.names:
        return None
    rows = table.filter(pc.invert(table.column("rejected")))
    index = positions(rows.column("pose"), poses), number_column(rows, "leg").astype(int) - 1
    is_known = index[0] >= 0
    shifts = SurveyShifts(np.full((len(poses), legs), np.nan), np.full((len(poses), legs), np.nan))
    for target, name in ((shifts.shift, "delta_bz_um"), (shifts.sigma, "own_sigma_um")):
        target[index[0][is_known], index[1][is_known]] = number_column(rows, name)[is_known] * 1e-6
    return shifts


def _roles(configurations: pa.Table, poses: tuple[int | str, ...]) -> NDArray:
    roles = np.full(len(poses), "", object)
    roles[positions(configurations.column("pose"), poses)] = configurations.column("role").to_pylist()
    return roles


def _tolerances(mechanism: LeggedMechanism) -> dict[str, float]:
    tolerance = mechanism.tolerance
    sigmas = {"a": tolerance.a_mm, "b": tolerance.b_mm, "l": tolerance.length_mm, "rho0": tolerance.rho0_mm}
    sigmas["flexure_length"] = tolerance.flexure_length_mm
    tolerances = {name: sigma * 1e-3 for name, sigma in sigmas.items() if sigma is not None}
    ratios = {"u": tolerance.u, "beta": tolerance.flexure_beta}
    return tolerances | {name: sigma for name, sigma in ratios.items() if sigma is not None}


def _deformations(models: pa.Table | None, legs: int) -> dict[str, Deformation]:
    if models is None:
        return {}
    rows = [row for row in models.to_pylist() if row["leg"] is not None and row["column"] > 0]
    deformations = {
        name: _coefficients([row for row in rows if row["model"] == name], legs) for name in ("linear", "matrix")
    }
    return {name: deformation for name, deformation in deformations.items() if np.isfinite(deformation.K).any()}


def _in_plane(models: pa.Table | None, legs: int) -> Deformation | None:
    """Coefficients (L, 2, L) of the shifts along x and y of the platform; None where they were not determined."""
    rows = [] if models is None else [row for row in models.to_pylist() if row["model"] == "in-plane"]
    if not rows:
        return None
    K, sigma = np.full((2, legs, 2, legs), np.nan)
    for row in rows:
        index = row["leg"] - 1, "xy".index(row["axis"]), row["column"] - 1
        K[index], sigma[index] = row["coefficient"], row["sigma"]
    return Deformation(K, sigma)


def _coefficients(rows: list[TableRow], legs: int) -> Deformation:
    K, sigma = np.full((legs, legs), np.nan), np.full((legs, legs), np.nan)
    for row in rows:
        K[row["leg"] - 1, row["column"] - 1] = row["coefficient"]
        sigma[row["leg"] - 1, row["column"] - 1] = row["sigma"]
    return Deformation(K, sigma)


def _surveyed_attachments(tables: Mapping[str, pa.Table], settings: Campaign) -> SurveyedAttachments | None:
    """Surveyed attachment positions; None if the survey does not give them in the frame of the platform."""
    from truing.simulation.targets import PLATFORM, Targets, shape_unknowns

    if "survey" not in tables or settings.noise.point_mm is None:
        return None
    platform = survey_points(tables["survey"], "platform")
    seats = platform.leg > 0
    if not seats.any() or _rests_on_attachments(platform):
        return None
    noise = np.eye(3) * (settings.noise.point_mm * 1e-3) ** 2
    known = np.isfinite(platform.cov).all((1, 2)) & (np.trace(platform.cov, axis1=1, axis2=2) > 0)
    covariance = np.where(known[:, None, None], platform.cov, noise)
    targets = Targets(np.full(len(seats), PLATFORM), platform.leg - 1)
    factor = shape_unknowns(targets, platform.points, covariance).attachment_factor
    return SurveyedAttachments(platform.leg[seats] - 1, platform.points[seats], factor @ factor.T)
