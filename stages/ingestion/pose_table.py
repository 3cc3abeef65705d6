"""Input of measured poses: rotations in all notations, checked, with declared covariance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Mask
from truing.estimation.rotation import euler_axes, exp_so3, left_jacobian_so3, log_so3
from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import (
    COORDINATE_SIGMAS,
    COORDINATES,
    EULER,
    POSE_COVARIANCE,
    POSES,
    QUATERNION,
    ROTATION_VECTOR,
)
from truing.formats.row_collection import CollectedRows, collect_rows
from truing.report.numbers import count_text
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import Fault
from truing.schemas.near_names import meant_by
from truing.stages.common.point_arrays import RECORDED_ANGLES
from truing.stages.common.table_arrays import (
    check_unique_keys,
    check_variance,
    declared_missing,
    numbers,
    sigmas,
    texts,
    without_rows,
)

if TYPE_CHECKING:
    from truing.formats.source import CampaignFiles
    from truing.schemas.campaign import Campaign
    from truing.stages.ingestion.points import ExpectedPoints

ROTATION = tuple(f"m{i}{j}" for i in range(3) for j in range(3))
LAST_ROW = ("m30", "m31", "m32", "m33")
# Tolerance for rotations printed with four decimals; other matrices deviate much more.
_ROUNDED = 5e-3
_FULL_TURN = 2.0 * np.pi * (1.0 + 1e-9)
_FAMILIES = {
    "qw, qx, qy, qz": QUATERNION,
    "rx_rad, ry_rad, rz_rad": ROTATION_VECTOR,
    "euler_a_deg, euler_b_deg, euler_c_deg": EULER,
    "m00 .. m22": ROTATION,
}
_TRANSLATIONS = ("m03", "m13", "m23")
_WHAT = "the poses"
_LEAST_EIGENVALUE = -1e-6  # of a covariance scaled to ones: rounding in a file, not a contradiction
_VECTOR_SIGMAS = tuple(f"sigma_{name}" for name in ROTATION_VECTOR)
_EULER_SIGMAS = tuple(f"sigma_{name}" for name in EULER)


def rotation_columns(collected: CollectedRows, log: FaultLog) -> tuple[str, ...] | None:
    """Return the columns of the rotation; None, with a fault, if no or several notations are present."""
    names = set(collected.table.column_names)
    begun = {words: columns for words, columns in _FAMILIES.items() if names & set(columns)}
    if len(begun) != 1:
        text = " | ".join(_FAMILIES)
        value = " and ".join(begun) or None
        log.add(Fault(collected.first_file, f"one kind of rotation: {text}", column="poses", value=value))
        return None
    (columns,) = begun.values()
    missing = [name for name in columns if name not in names]
    for name in missing:
        log.add(
            Fault(collected.first_file, f"a column {name}, as there is {sorted(names & set(columns))[0]}", column=name)
        )
    return None if missing else columns


def rotations(collected: CollectedRows, columns: Sequence[str], euler: str | None, log: FaultLog) -> Array:
    """Return the rotation (N, 3, 3) of each row, body to parent; NaN, with a fault, if the row gives no rotation."""
    values = np.column_stack([numbers(collected, name) for name in columns])
    if tuple(columns) == QUATERNION:
        return _rotations_of_quaternions(collected, values, log)
    if tuple(columns) == ROTATION_VECTOR:
        return _rotations_of_vectors(collected, values, log)
    if tuple(columns) == EULER:
        return _rotations_of_euler(collected, values, euler, log)
    return _rotations_of_matrices(collected, values.reshape(-1, 3, 3), log)


def _rotations_of_quaternions(collected: CollectedRows, q: Array, log: FaultLog) -> Array:
    from scipy.spatial.transform import Rotation

    norm = np.linalg.norm(q, axis=1)
    wrong = np.abs(norm - 1.0) > _ROUNDED
    collected.fault(log, wrong, "qw", "a unit quaternion: qw² + qx² + qy² + qz² = 1")
    is_valid = np.isfinite(norm) & ~wrong
    R = np.full((len(q), 3, 3), np.nan)
    R[is_valid] = Rotation.from_quat(q[is_valid], scalar_first=True).as_matrix()
    return R


def _rotations_of_vectors(collected: CollectedRows, vectors: Array, log: FaultLog) -> Array:
    length = np.linalg.norm(vectors, axis=1)
    wrong = length > _FULL_TURN
    degrees = ", ".join(f'{name} = "deg"' for name in ROTATION_VECTOR)
    expected = f"a rotation vector of at most 2 pi rad; did you mean degrees, units = {{ {degrees} }}?"
    at = np.argmax(np.abs(np.nan_to_num(vectors)), axis=1)
    for number, name in enumerate(ROTATION_VECTOR):
        collected.fault(log, np.asarray(wrong & (at == number)), name, expected)
    R = np.full((len(vectors), 3, 3), np.nan)
    is_valid = np.isfinite(length) & ~wrong
    R[is_valid] = exp_so3(vectors[is_valid])
    return R


def _rotations_of_euler(collected: CollectedRows, angles: Array, order: str | None, log: FaultLog) -> Array:
    from scipy.spatial.transform import Rotation

    R = np.full((len(angles), 3, 3), np.nan)
    if order is None:
        expected = 'the order of the angles: "XYZ" about turned axes, "xyz" about fixed ones, any three axes'
        log.add(Fault("campaign.toml", expected, column="poses.euler"))
        return R
    wrong: Mask = np.abs(angles) > 360.0 * (1.0 + 1e-9)
    for angle, name in zip(wrong.T, EULER, strict=True):
        collected.fault(log, angle, name, f"an angle of at most 360 deg either way{_other_unit(angles)}")
    is_valid = np.isfinite(angles).all(axis=1) & ~wrong.any(axis=1)
    R[is_valid] = Rotation.from_euler(order, angles[is_valid], degrees=True).as_matrix()
    return R


def _other_unit(angles: Array) -> str:
    """Return the question for another unit of angles (N, 3), deg, that exceed a turn; empty if few do."""
    size = np.abs(angles[np.isfinite(angles)])
    if size.max() <= 400.0 * (1.0 + 1e-9):
        unit = "gon"
    elif np.median(size) > 360.0 and np.radians(size.max()) <= 360.0 * (1.0 + 1e-9):
        unit = "deg"  # degrees, of which a mapping says radians
    else:
        return ""
    mapping = ", ".join(f'{name} = "{unit}"' for name in EULER)
    return f"; did you mean {unit}, units = {{ {mapping} }}?"


def _rotations_of_matrices(collected: CollectedRows, M: Array, log: FaultLog) -> Array:
    known = np.asarray(np.isfinite(M).all(axis=(1, 2)))
    M = np.where(known[:, None, None], M, np.eye(3))
    off = np.abs(np.swapaxes(M, 1, 2) @ M - np.eye(3)).max(axis=(1, 2))
    crooked = known & (off > _ROUNDED)
    mirrored = known & ~crooked & (np.linalg.det(M) < 0.0)
    skewed = "a rotation matrix: rows of length 1 at right angles"
    collected.fault(log, crooked, "m00", skewed)
    collected.fault(
        log, mirrored, "m00", "a rotation: this matrix mirrors (determinant -1); an axis has the wrong sign"
    )
    U, _, Vt = np.linalg.svd(M)
    is_valid = known & ~crooked & ~mirrored
    return np.where(is_valid[:, None, None], U @ Vt, np.nan)


def check_last_row(collected: CollectedRows, log: FaultLog) -> None:
    """Check that the last row of a 4x4 matrix is 0 0 0 1; a translation there means a transposed matrix."""
    names = collected.table.column_names
    for name in (name for name in LAST_ROW if name in names):
        values = numbers(collected, name)
        wanted = 1.0 if name == "m33" else 0.0
        expected = f"{wanted:g} in the last row of a 4x4 matrix; one with its translation there is written by columns"
        collected.fault(log, np.abs(values - wanted) > _ROUNDED, name, expected)


@dataclass(frozen=True)
class PoseTable:
    """Artifact table, its bodies, its files, and rows left out by (file, reason)."""

    table: pa.Table
    bodies: tuple[str, ...]
    files: tuple[str, ...]
    left_out: Counter[tuple[str, str]]

    @property
    def read(self) -> str:
        """Description of the poses that were read."""
        file = self.files[0] if len(self.files) == 1 else f"{len(self.files)} files"
        return f"{count_text(self.table.num_rows, 'measured pose')} from {file}"

    @property
    def figure(self) -> str:
        """The bodies whose poses were measured."""
        return f"poses of {', '.join(self.bodies[:12])}, no points"


def read_poses(source: CampaignFiles, settings: Campaign, expected: ExpectedPoints, log: FaultLog) -> PoseTable | None:
    """Return the measured poses of the campaign; None without a pose table. Faults go into ``log``."""
    if not source.entries("poses"):
        return None
    rows = collect_rows(source, POSES, log, "pose")
    if rows is None or not {"pose", "body"} <= set(rows.table.column_names):
        return None
    check_unique_keys(rows, log, "pose", "body")
    _check_names(rows, expected, log)
    columns = rotation_columns(rows, log)
    names = _position_columns(rows, log)
    if columns is None or names is None:
        return None
    rows = _without_missing(rows, (*names, *columns), log)
    R = rotations(rows, columns, settings.poses.euler, log)
    check_last_row(rows, log)
    p = 1e-3 * np.column_stack([numbers(rows, name) for name in names])
    covariance = _covariance(rows, columns, R, settings, log)
    files = tuple(dict.fromkeys(file.raw.name for file, _ in rows.parts))
    bodies = tuple(dict.fromkeys(rows.table.column("body").to_pylist()))
    table = _with_angles(_table(rows, p, R, covariance, expected), rows, columns)
    return PoseTable(table, bodies, files, rows.left_out)


def _check_names(collected: CollectedRows, expected: ExpectedPoints, log: FaultLog) -> None:
    known = set(map(str, expected.poses.to_pylist()))
    unknown = np.array([str(pose) not in known for pose in collected.table.column("pose").to_pylist()], dtype=bool)
    if unknown.any():
        name = str(collected.table.column("pose")[int(unknown.argmax())].as_py())
        collected.fault(log, unknown, "pose", "a pose of configurations" + meant_by([name], sorted(known)))
    if expected.bodies:
        is_unknown = np.array([body not in expected.bodies for body in texts(collected, "body")], dtype=bool)
        near = meant_by(map(str, texts(collected, "body")[is_unknown]), expected.bodies)
        collected.fault(
            log, is_unknown, "body", f"a body of the mechanism; there are {', '.join(expected.bodies)}{near}"
        )


def check_bodies(poses: PoseTable, expected: ExpectedPoints, log: FaultLog) -> None:
    """Report poses without a measured pose of a required body, if the campaign has measured poses only."""
    for body in dict.fromkeys((*expected.always, *filter(None, (expected.reference,)))):
        poses_of_body = {str(p) for p, b in zip(*map(_listed(poses), ("pose", "body")), strict=True) if b == body}
        if not poses_of_body:
            cure = '; of an instrument that stood still: [measurement] frame = "campaign"' if body == "base" else ""
            text = f"poses of body {body}; there are poses of {', '.join(poses.bodies)}{cure}"
            log.add(Fault(poses.files[0], text, column="body"))
            continue
        lost = [str(p) for p in dict.fromkeys(_listed(poses)("pose")) if str(p) not in poses_of_body]
        if body in expected.always and lost:
            text = f"a pose of body {body} wherever another body has one"
            log.add(Fault(poses.files[0], text, column="body", value=f"none in pose {lost[0]}", more=len(lost) - 1))


def _listed(poses: PoseTable) -> Callable[[str], list[Any]]:
    return lambda name: poses.table.column(name).to_pylist()


def _position_columns(collected: CollectedRows, log: FaultLog) -> tuple[str, ...] | None:
    names = set(collected.table.column_names)
    columns = next((kind for kind in (COORDINATES, _TRANSLATIONS) if names & set(kind)), COORDINATES)
    missing = [name for name in columns if name not in names]
    for name in missing:
        log.add(Fault(collected.first_file, f"a column {name}: where the origin of the body is", column=name))
    return None if missing else columns


def _without_missing(collected: CollectedRows, columns: tuple[str, ...], log: FaultLog) -> CollectedRows:
    """Return the table without incomplete rows, if the mapping declares missing values; otherwise each is a fault."""
    empty = {name: np.isnan(numbers(collected, name)) & collected.without_faults(name) for name in columns}
    declared = declared_missing(collected)
    for name, where in empty.items():
        collected.fault(log, where & ~declared, name, "a number; an empty cell has to be declared by missing")
    is_missing = np.logical_or.reduce(list(empty.values()))
    return without_rows(collected, is_missing, "a number of the pose means missing")


# -- covariance -------------------------------------------------------------------------------------------


def _covariance(
    collected: CollectedRows, columns: tuple[str, ...], R: Array, settings: Campaign, log: FaultLog
) -> Array:
    """Return the covariance (N, 6, 6), SI, order (p, theta): from the file, otherwise from its sigmas, otherwise as
    declared."""
    names = set(collected.table.column_names)
    if names & set(POSE_COVARIANCE):
        return _given_covariance(collected, log)
    declared = settings.noise.displacement_mm
    position = 1e-3 * sigmas(collected, COORDINATE_SIGMAS, declared, "noise.displacement_mm", _WHAT, log)
    turned, axes = _turn_sigmas(collected, columns, R, settings, log)
    covariance = np.zeros((len(R), 6, 6))
    covariance[:, range(3), range(3)] = position**2
    covariance[:, 3:, 3:] = np.einsum("nik,nk,njk->nij", axes, turned**2, axes)
    return covariance


def _turn_sigmas(
    collected: CollectedRows, columns: tuple[str, ...], R: Array, settings: Campaign, log: FaultLog
) -> tuple[Array, Array]:
    """Return sigmas (N, 3) in rad, and their rotation axes (N, 3, 3) in the parent frame, as columns."""
    names = set(collected.table.column_names)
    identity = np.broadcast_to(np.eye(3), R.shape)
    if names & set(_EULER_SIGMAS):
        order = settings.poses.euler
        if columns != EULER:
            expected = (
                "sigmas of Euler angles together with Euler angles; else sigma_rx_rad, sigma_ry_rad, sigma_rz_rad"
            )
            log.add(Fault(collected.first_file, expected, column=_EULER_SIGMAS[0]))
            return np.ones((len(R), 3)), identity
        if order is None:
            return np.ones((len(R), 3)), identity  # the order was asked for where the angles were read
        angles = np.radians(np.column_stack([numbers(collected, name) for name in EULER]))
        declared = settings.noise.rotation_rad
        in_degrees = None if declared is None else np.degrees(declared)
        sigma = sigmas(collected, _EULER_SIGMAS, in_degrees, "noise.rotation_rad", _WHAT, log)
        return np.radians(sigma), euler_axes(angles, order)
    sigma = sigmas(collected, _VECTOR_SIGMAS, settings.noise.rotation_rad, "noise.rotation_rad", _WHAT, log)
    if columns == ROTATION_VECTOR and names & set(_VECTOR_SIGMAS):
        vectors = np.column_stack([numbers(collected, name) for name in ROTATION_VECTOR])
        return sigma, left_jacobian_so3(np.nan_to_num(vectors))
    return sigma, identity


def _given_covariance(collected: CollectedRows, log: FaultLog) -> Array:
    names = set(collected.table.column_names)
    for name in sorted(names & {*COORDINATE_SIGMAS, *_VECTOR_SIGMAS, *_EULER_SIGMAS}):
        log.add(Fault(collected.first_file, "either covariances cov_i_j or standard deviations, not both", column=name))
    covariance = np.zeros((len(collected.table), 6, 6))
    lacking = [name for name in (f"cov_{i}_{i}" for i in range(6)) if name not in names]
    if lacking:
        text = f"a column {lacking[0]}: a covariance has all six variances, in m², rad²"
        log.add(Fault(collected.first_file, text, column=lacking[0]))
        return np.broadcast_to(np.eye(6), covariance.shape)
    for name in (name for name in POSE_COVARIANCE if name in names):
        i, j = int(name[4]), int(name[6])
        values = numbers(collected, name)
        collected.fault(log, np.isnan(values), name, "a number in every row")
        covariance[:, i, j] = covariance[:, j, i] = np.nan_to_num(values)
    diagonal = covariance[:, range(6), range(6)]
    for i in range(6):
        check_variance(collected, diagonal[:, i], f"cov_{i}_{i}", "m" if i < 3 else "rad", log)
    scale = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    least = np.linalg.eigvalsh(covariance / scale[:, :, None] / scale[:, None, :])[:, 0]
    wrong = (least < _LEAST_EIGENVALUE) & (diagonal > 0.0).all(axis=1)
    collected.fault(log, wrong, "cov_0_0", "a covariance: no correlation beyond 1, alone or together")
    return covariance


def _table(collected: CollectedRows, p: Array, R: Array, covariance: Array, expected: ExpectedPoints) -> pa.Table:
    known = np.isfinite(R).all(axis=(1, 2)) & np.isfinite(p).all(axis=1)
    vectors = np.full((len(R), 3), np.nan)
    vectors[known] = log_so3(R[known])
    is_number = pa.types.is_int64(expected.poses.type)
    pose = collected.table.column("pose")
    columns = {
        "pose": pose if is_number and pa.types.is_int64(pose.type) else pose.cast(pa.string()),
        "body": collected.table.column("body"),
        **dict(_numbered(1e3 * p, [f"p{a}_mm" for a in "xyz"])),
        **dict(_numbered(vectors, [f"r{a}_rad" for a in "xyz"])),
        **{f"cov_{i}_{j}": _numbers(covariance[:, i, j]) for i in range(6) for j in range(i, 6)},
    }
    identifier = "int64" if is_number and pa.types.is_int64(pose.type) else "string"
    schema = ARTIFACTS["measured_poses"].arrow_schema(identifier)
    return pa.table([columns[name] for name in schema.names], schema=schema)


def _with_angles(table: pa.Table, collected: CollectedRows, columns: Sequence[str]) -> pa.Table:
    """Return poses with the Euler angles or rotation vectors, rad, from which their rotations were read, if any."""
    if tuple(columns) not in (EULER, ROTATION_VECTOR):
        return table
    unit = np.pi / 180.0 if tuple(columns) == EULER else 1.0
    for name, column in zip(RECORDED_ANGLES, columns, strict=True):
        table = table.append_column(name, _numbers(unit * numbers(collected, column)))
    return table


def _numbered(values: Array, names: list[str]) -> Iterator[tuple[str, pa.Array]]:
    yield from ((name, _numbers(values[:, number])) for number, name in enumerate(names))


def _numbers(values: Array) -> pa.Array:
    return pa.array(np.ascontiguousarray(values), from_pandas=True)
