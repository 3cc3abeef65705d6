"""Repeated poses: scatter, repeatability by ISO 9283, and lack of fit of the models."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.estimation.repeatability import (
    FEWEST,
    Figure,
    Squares,
    at_one_reading,
    known_mean,
    lack_of_fit,
    orientation_repeatability,
    position_repeatability,
    position_sigma,
    turned_from_first,
    within_groups,
)
from truing.estimation.rotation import exp_so3
from truing.stages.common.point_arrays import (
    number_column,
    number_columns,
    pose_points,
    pose_vectors,
    positions,
    residual_points,
    text_column,
    used_targets,
)
from truing.stages.common.repeats import DECLARED, drive_readings, repeated_poses
from truing.stages.common.rows import Rows
from truing.stages.repeats.tables import Repeated, Repeats

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

Ids = tuple[int | str, ...]
_UM, _PER_ARCSEC = 1e6, 180 / np.pi * 3600
_FRAME = 3  # targets that make a pose
_SEED = 9283
_ANGLES = ("RP_a", "RP_b", "RP_c")
_COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
_UNITS = ("um",) * 3 + ("arcsec",) * 3
_ARCSEC = np.pi / 180 / 3600
_SI = np.array([1e-6] * 3 + [_ARCSEC] * 3)
_ALONG_Z = ("linear", "matrix")  # models of the attachments' shifts along z
_READING = re.compile(r"rho(\d+)_mm")
_PARTS = ("dx_um", "dy_um", "dz_um", "rx_arcsec", "ry_arcsec", "rz_arcsec")


def repeatability_rows(
    bodies: Mapping[str, Array], tables: Mapping[str, pa.Table], poses: Ids, groups: Sequence[Index], how: str
) -> Rows:
    """Return rows of ``pose_repeatability``: figures of every body and reflector at every pose that was repeated.

    ``bodies``: poses (B, 6) of each body seen from its reference, m and rad, angles small within a group, NaN where
    unknown. Reflectors come from the observations in ``tables``. RP needs five repeats, sigma two.
    """
    rows, rng = Rows("pose_repeatability"), np.random.default_rng(_SEED)
    seen: list[tuple[str, Array, Array | None]] = [
        (body, body_motions[:, :3], body_motions[:, 3:]) for body, body_motions in bodies.items()
    ]
    seen += list(_reflectors(tables, poses))
    for name, position, angle in seen:
        for group in groups:
            group_rows = group[np.isfinite(position[group]).all(axis=1)]
            if len(group_rows) > 1:
                figures = _group_figures(position[group_rows], None if angle is None else angle[group_rows], rng)
                where = {"subject": name, "pose": poses[int(group_rows[0])]}
                for figure, size, unit in figures:
                    rows.add(
                        **where, figure=figure, value=size.value, low=size.low, high=size.high, unit=unit,
                        attained=len(group_rows), told_by=how,
                    )  # fmt: skip
    return rows


def _group_figures(position: Array, angle: Array | None, rng: np.random.Generator) -> list[tuple[str, Figure, str]]:
    """Return name, value and unit of the figures of one group of repeated poses (n, 3), m and rad."""
    place_um = _UM * position
    figures: list[tuple[str, Figure, str]] = [("sigma", position_sigma(place_um), "um")]
    if len(position) >= FEWEST:
        figures.append(("RP", position_repeatability(place_um, rng), "um"))
        if angle is not None:
            angles = orientation_repeatability(_PER_ARCSEC * angle)
            figures += [(figure, one, "arcsec") for figure, one in zip(_ANGLES, angles, strict=True)]
    return figures


def _reflectors(tables: Mapping[str, pa.Table], poses: Ids) -> Iterator[tuple[str, Array, None]]:
    """Yield each target of a body with too few targets for a pose: its name and position (B, 3) in m, NaN if
    unknown.

    Positions are relative to the reference body; without any pose of a body, to the instrument.
    """
    points = tables.get("observations")
    if points is None or not points.num_rows:
        return
    reference = _reference(tables.get("poses"), poses)
    for body in dict.fromkeys(text_column(points, "body")):
        points_of_body = pose_points(points, body, poses)
        if len(points_of_body.targets) >= _FRAME or str(body).startswith("leg"):
            continue
        for k, target in enumerate(points_of_body.targets):
            position = np.where(points_of_body.is_observed[:, k, None], points_of_body.points[:, k], np.nan)
            if reference is not None:
                position = np.einsum("bji,bj->bi", reference[0], position - reference[1])
            yield f"{body} {target}", position, None


def _reference(table: pa.Table | None, poses: Ids) -> tuple[Array, Array] | None:
    """Return rotation (B, 3, 3) and position (B, 3) in m of the reference body, NaN if unknown; None without any pose
    of a body.

    It is the parent of other bodies, otherwise the only body with a pose.
    """
    if table is None or not table.num_rows:
        return None
    bodies, parents = text_column(table, "body"), text_column(table, "parent")
    values = pose_vectors(table)
    default = np.asarray(table.column("default").to_pylist(), bool) & np.isfinite(values).all(axis=1)
    root = [parent for parent in dict.fromkeys(parents[default]) if parent != "measurement"]
    name = next(iter(root or dict.fromkeys(bodies[default])), None)
    index = positions(table.column("pose"), poses)
    rows = default & (bodies == name) & (parents == "measurement") & (index >= 0)
    if not rows.any():
        return None
    motions = np.full((len(poses), 6), np.nan)
    motions[index[rows]] = values[rows]
    turn = exp_so3(np.nan_to_num(motions[:, 3:]))
    turn[~np.isfinite(motions).all(axis=1)] = np.nan
    return turn, motions[:, :3]


def repeats_of_poses(tables: Mapping[str, pa.Table], settings: Campaign) -> tuple[Rows, ...]:
    """Rows of ``repeats``, ``lack_of_fit`` and ``pose_repeatability``; none where nothing was repeated."""
    configurations = tables.get("configurations")
    if configurations is None or not configurations.num_rows:
        return Rows("repeats"), Rows("lack_of_fit")
    groups, how = repeated_poses(configurations, settings.campaign.drives, settings.noise.actuator_mm)
    if not groups:
        return Rows("repeats"), Rows("lack_of_fit")
    repeats = Repeats(groups, how, within_groups)
    poses = tuple(configurations.column("pose").to_pylist())
    readings = drive_readings(configurations, settings.campaign.drives)
    bodies = {}
    for body, values, sigma in _relative_poses(tables.get("poses"), poses, groups, settings.is_frame_fixed):
        bodies[body] = at_one_reading(values, readings, groups) if how == DECLARED else values
        repeated = Repeated("pose", tuple(f"{body} {name}" for name in _COMPONENTS), _UNITS)
        repeats.add(repeated, bodies[body] / _SI, sigma / _SI)
    _add_points(repeats, tables.get("residuals"), poses, settings.noise.point_mm)
    fitted = np.array(configurations.column("role").to_pylist(), dtype=object) != "verification"
    inside = [group[fitted[group]] for group in groups]
    _add_attachments(repeats, tables, poses, fitted, inside)
    _add_calibrations(repeats, tables, poses, inside)
    return repeats.repeats, repeats.fits, repeatability_rows(bodies, tables, poses, groups, how)


def _relative_poses(
    table: pa.Table | None, poses: tuple[int | str, ...], groups: Sequence[Index], is_instrument_fixed: bool
) -> Iterator[tuple[str, Array, Array]]:
    """Body, its poses (B, 6) seen from its reference, or from an instrument that stood still, and a stated sigma (6,);
    SI.

    Turned from the first of them; where bodies turn far, from the first of each group: rotation vectors of large
    rotations have no difference that is an angle. Bodies that are seen from an
    instrument alone may stand anywhere where it was moved.
    """
    if table is None or not table.num_rows:
        return
    default = np.asarray(table.column("default").to_pylist(), bool)
    bodies, parents = text_column(table, "body"), text_column(table, "parent")
    vectors = pose_vectors(table)
    variances = number_columns(table, [f"cov_{k}_{k}" for k in range(6)])
    index = positions(table.column("pose"), poses)
    relative = default & (parents != "measurement")
    if is_instrument_fixed:
        relative |= default & ~np.isin(bodies, [*bodies[relative], *parents[relative]])
    for body in dict.fromkeys(bodies[relative]):
        rows = default & (bodies == body) & (index >= 0)
        position, variance = np.full((2, len(poses), 6), np.nan)
        position[index[rows]], variance[index[rows]] = vectors[rows], variances[rows]
        known = np.isfinite(position).all(axis=1)
        if not str(body).startswith("leg") and known.any():
            position[known, 3:] = turned_from_first(exp_so3(position[known, 3:]), np.flatnonzero(known), groups)
            position[~known] = np.nan
            yield str(body), position, np.sqrt(known_mean(variance))


def _add_points(repeats: Repeats, table: pa.Table | None, poses: Ids, declared_mm: float | None) -> None:
    """Add positions of targets in their body's frame; the rigid motion of each repeat is removed."""
    if table is None or not table.num_rows:
        return
    bodies, targets = text_column(table, "body"), text_column(table, "target")
    names = tuple(str(body) for body in dict.fromkeys(bodies))
    square, freedom = np.zeros((2, len(names)))
    for at, body in enumerate(names):
        targets_of_body = tuple(dict.fromkeys(targets[bodies == body]))
        used = used_targets(table, body, poses, targets_of_body)
        left = np.where(used[..., None], residual_points(table, body, poses, targets_of_body), np.nan)
        spread = within_groups(1e6 * left.reshape(len(poses), -1), repeats.groups)
        motions = sum(max(int(used[group].any(axis=1).sum()) - 1, 0) for group in repeats.groups)
        square[at], freedom[at] = spread.square.sum(), spread.freedom.sum() - 6.0 * motions
    repeated = Repeated("point", tuple(f"{body} targets" for body in names), ("um",) * len(names))
    stated = np.nan if declared_mm is None else 1e3 * declared_mm
    repeats.add_squares(repeated, Squares(square, np.maximum(freedom, 0.0)), np.full(len(names), stated))


def _add_attachments(
    repeats: Repeats, tables: Mapping[str, pa.Table], poses: Ids, fitted: Mask, inside: Sequence[Index]
) -> None:
    """Add shifts of attachments between repeats, and the residuals of the deformation models in fitted poses (B,)."""
    table = tables.get("deformation")
    if table is None or not table.num_rows:
        return
    leg = np.asarray(table.column("leg").to_pylist(), int)
    is_kept = ~np.asarray(table.column("rejected").to_pylist(), bool)
    index = positions(table.column("pose"), poses)
    legs = int(leg.max())
    shift, variance = np.full((2, len(poses), legs), np.nan)
    at = index[is_kept], leg[is_kept] - 1
    shift[at] = number_column(table, "delta_bz_um")[is_kept]
    stated = "scatter_sigma_um" if "scatter_sigma_um" in table.column_names else "own_sigma_um"
    variance[at] = number_column(table, stated)[is_kept] ** 2
    subjects = tuple(f"leg {number + 1}" for number in range(legs))
    repeated = Repeated("attachment", subjects, ("um",) * legs)
    repeats.add(repeated, shift, np.sqrt(known_mean(variance)))
    # Of every leg, for a matrix takes also those whose attachments carry no targets; their zero is of no account.
    drive = _readings(tables["configurations"])
    for model, left in _deformation_left(tables.get("deformation_models"), shift, drive):
        left[~fitted] = np.nan
        count = np.isfinite(left).sum(axis=0)
        spent = 1.0 + (1.0 if model == "linear" else drive.shape[1])
        centred = left - known_mean(left)
        all_left = Squares(np.nansum(centred**2, axis=0), count - spent)
        repeats.add_fit(repeated, model, lack_of_fit(all_left, within_groups(left, inside)))


def _readings(configurations: pa.Table) -> Array:
    """(B, D) readings of actuators in mm."""
    numbers = sorted(int(match[1]) for name in configurations.column_names if (match := _READING.fullmatch(name)))
    return number_columns(configurations, [f"rho{number}_mm" for number in numbers])


def _deformation_left(models: pa.Table | None, shift: Array, drive: Array) -> Iterator[tuple[str, Array]]:
    """Yield the residuals of each deformation model from the shifts (B, L) in um, with readings (B, D) of all legs in
    mm."""
    if models is None or not models.num_rows:
        return
    names = text_column(models, "model")
    leg, column = (np.nan_to_num(number_column(models, name)).astype(int) - 1 for name in ("leg", "column"))
    coefficient = number_column(models, "coefficient")
    for model in [name for name in dict.fromkeys(names) if name in _ALONG_Z]:
        of_model = (names == model) & (leg >= 0) & (column >= 0)
        gain = np.zeros((shift.shape[1], drive.shape[1]))
        gain[leg[of_model], column[of_model]] = coefficient[of_model]
        followed = drive @ gain.T if model == "matrix" else drive[:, : shift.shape[1]] * np.diag(gain)
        yield str(model), shift - 1e3 * followed


def _add_calibrations(repeats: Repeats, tables: Mapping[str, pa.Table], poses: Ids, groups: Sequence[Index]) -> None:
    """Add the residuals of each calibrated model from the platform poses that it was fitted to."""
    accuracy = tables.get("accuracy")
    if accuracy is None or not accuracy.num_rows or _PARTS[0] not in accuracy.column_names:
        return
    model, fitted = _model_names(accuracy), text_column(accuracy, "role") != "verification"
    parts = number_columns(accuracy, _PARTS)
    index = positions(accuracy.column("pose"), poses)
    spent = _parameters(tables.get("calibration"))
    repeated = Repeated("pose", tuple(f"platform {name}" for name in _COMPONENTS), _UNITS)
    for name in dict.fromkeys(model.tolist()):
        rows = (model == name) & fitted & (index >= 0)
        left = np.full((len(poses), 6), np.nan)
        left[index[rows]] = parts[rows]
        count = np.isfinite(left).sum(axis=0)
        all_left = Squares(np.nansum(left**2, axis=0), count - spent.get(name, 0.0) / 6.0)
        repeats.add_fit(repeated, name, lack_of_fit(all_left, within_groups(left, groups)))


def _model_names(table: pa.Table) -> NDArray[np.object_]:
    """The model and its deformation of each row (N,)."""
    pairs = zip(text_column(table, "model"), text_column(table, "deformation"), strict=True)
    return np.array([f"{model}, {deformation}" for model, deformation in pairs], dtype=object)


def _parameters(table: pa.Table | None) -> dict[str, float]:
    """Return by model the number of parameters that the data determine, each counted by the share of its variance that
    the data removed."""
    if table is None:
        return {}
    names, sigma, tolerance = _model_names(table), number_column(table, "sigma"), number_column(table, "tolerance")
    by_data = 1.0 - np.where(tolerance > 0.0, sigma / np.where(tolerance > 0.0, tolerance, 1.0), 0.0) ** 2
    by_data = np.nan_to_num(np.clip(by_data, 0.0, 1.0))
    return {name: float(by_data[names == name].sum()) for name in dict.fromkeys(names.tolist())}
