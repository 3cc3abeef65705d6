"""Attitudes as files write them: quaternions, rotation vectors, Euler angles, matrices; checked, and as matrices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3, left_jacobian_so3
from truing.formats.faultlog import FaultLog
from truing.formats.gather import Gathered
from truing.formats.shapes import EULER, QUATERNION, ROTATION_VECTOR
from truing.schemas.faults import Fault
from truing.stages.ingestion.gathered_columns import numbers

Array = NDArray[np.float64]

ROTATION = tuple(f"m{i}{j}" for i in range(3) for j in range(3))
LAST_ROW = ("m30", "m31", "m32", "m33")
# Four digits behind the point, as controllers print them, leave 1e-4 or so; what is no rotation is off by far more.
_ROUNDED = 5e-3
_FULL_TURN = 2.0 * np.pi * (1.0 + 1e-9)
_FAMILIES = {
    "qw, qx, qy, qz": QUATERNION,
    "rx_rad, ry_rad, rz_rad": ROTATION_VECTOR,
    "euler_a_deg, euler_b_deg, euler_c_deg": EULER,
    "m00 .. m22": ROTATION,
}


def rotation_columns(found: Gathered, log: FaultLog) -> tuple[str, ...] | None:
    """The columns that say how bodies are turned; None, with a fault, where there are none, or several kinds."""
    names = set(found.table.column_names)
    begun = {words: columns for words, columns in _FAMILIES.items() if names & set(columns)}
    if len(begun) != 1:
        told = " | ".join(_FAMILIES)
        value = " and ".join(begun) or None
        log.add(Fault(found.first_file, f"one kind of rotation: {told}", column="poses", value=value))
        return None
    (columns,) = begun.values()
    missing = [name for name in columns if name not in names]
    for name in missing:
        log.add(Fault(found.first_file, f"a column {name}, as there is {sorted(names & set(columns))[0]}", column=name))
    return None if missing else columns


def rotations(found: Gathered, columns: Sequence[str], euler: str | None, log: FaultLog) -> Array:
    """Rotation (N, 3, 3) of every row, body to parent; NaN where what the row says is none, which is a fault."""
    values = np.column_stack([numbers(found, name) for name in columns])
    if tuple(columns) == QUATERNION:
        return _of_quaternions(found, values, log)
    if tuple(columns) == ROTATION_VECTOR:
        return _of_vectors(found, values, log)
    if tuple(columns) == EULER:
        return _of_euler(found, values, euler, log)
    return _of_matrices(found, values.reshape(-1, 3, 3), log)


def euler_axes(angles: Array, order: str) -> Array:
    """(N, 3, 3) axes, in the parent frame, about which three Euler angles (N, 3), rad, turn: one column per angle."""
    inner = order if order.isupper() else order[::-1]  # about turned axes, the first angle turns the others
    own = angles if order.isupper() else angles[:, ::-1]
    R = np.broadcast_to(np.eye(3), (len(angles), 3, 3))
    axes = []
    for number, axis in enumerate(inner.upper()):
        unit = np.eye(3)["XYZ".index(axis)]
        axes.append(R @ unit)
        R = R @ exp_so3(own[:, number, None] * unit)
    stacked = np.stack(axes, axis=-1)
    return stacked if order.isupper() else stacked[:, :, ::-1]


def vector_slopes(R_vectors: Array) -> Array:
    """(N, 3, 3) what a change of rotation vectors (N, 3) turns by, in the parent frame."""
    return left_jacobian_so3(R_vectors)


def _of_quaternions(found: Gathered, q: Array, log: FaultLog) -> Array:
    from scipy.spatial.transform import Rotation

    norm = np.linalg.norm(q, axis=1)
    wrong = np.abs(norm - 1.0) > _ROUNDED
    found.fault(log, wrong, "qw", "a unit quaternion: qw² + qx² + qy² + qz² = 1")
    good = np.isfinite(norm) & ~wrong
    R = np.full((len(q), 3, 3), np.nan)
    R[good] = Rotation.from_quat(q[good], scalar_first=True).as_matrix()
    return R


def _of_vectors(found: Gathered, vectors: Array, log: FaultLog) -> Array:
    length = np.linalg.norm(vectors, axis=1)
    wrong = length > _FULL_TURN
    degrees = ", ".join(f'{name} = "deg"' for name in ROTATION_VECTOR)
    expected = f"a rotation vector of at most 2 pi rad; did you mean degrees, units = {{ {degrees} }}?"
    at = np.argmax(np.abs(np.nan_to_num(vectors)), axis=1)
    for number, name in enumerate(ROTATION_VECTOR):
        found.fault(log, np.asarray(wrong & (at == number)), name, expected)
    R = np.full((len(vectors), 3, 3), np.nan)
    good = np.isfinite(length) & ~wrong
    R[good] = exp_so3(vectors[good])
    return R


def _of_euler(found: Gathered, angles: Array, order: str | None, log: FaultLog) -> Array:
    from scipy.spatial.transform import Rotation

    R = np.full((len(angles), 3, 3), np.nan)
    if order is None:
        expected = 'the order of the angles: "XYZ" about turned axes, "xyz" about fixed ones, any three axes'
        log.add(Fault("campaign.toml", expected, column="poses.euler"))
        return R
    wrong: NDArray[np.bool_] = np.abs(angles) > 360.0 * (1.0 + 1e-9)
    for angle, name in zip(wrong.T, EULER, strict=True):
        found.fault(log, angle, name, "an angle of at most 360 deg either way")
    good = np.isfinite(angles).all(axis=1) & ~wrong.any(axis=1)
    R[good] = Rotation.from_euler(order, angles[good], degrees=True).as_matrix()
    return R


def _of_matrices(found: Gathered, M: Array, log: FaultLog) -> Array:
    known = np.asarray(np.isfinite(M).all(axis=(1, 2)))
    M = np.where(known[:, None, None], M, np.eye(3))
    off = np.abs(np.swapaxes(M, 1, 2) @ M - np.eye(3)).max(axis=(1, 2))
    crooked = known & (off > _ROUNDED)
    mirrored = known & ~crooked & (np.linalg.det(M) < 0.0)
    skewed = "a rotation matrix: rows of length 1 at right angles"
    found.fault(log, crooked, "m00", skewed)
    found.fault(log, mirrored, "m00", "a rotation: this matrix mirrors (determinant -1); an axis has the wrong sign")
    U, _, Vt = np.linalg.svd(M)
    good = known & ~crooked & ~mirrored
    return np.where(good[:, None, None], U @ Vt, np.nan)


def check_last_row(found: Gathered, log: FaultLog) -> None:
    """The last row of a 4x4 matrix is 0 0 0 1; where translations stand in it, the matrix is transposed."""
    names = found.table.column_names
    for name in (name for name in LAST_ROW if name in names):
        values = numbers(found, name)
        wanted = 1.0 if name == "m33" else 0.0
        expected = f"{wanted:g} in the last row of a 4x4 matrix; one with its translation there is written by columns"
        found.fault(log, np.abs(values - wanted) > _ROUNDED, name, expected)
