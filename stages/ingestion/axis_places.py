"""Angle or displacement of an axis from points or poses of the moved body, by an outside instrument."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Mask
from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import COORDINATES, POINTS, POSES
from truing.formats.row_collection import CollectedRows, collect_rows
from truing.formats.source import CampaignFiles
from truing.schemas.faults import Fault
from truing.stages.common.table_arrays import numbers, texts
from truing.stages.ingestion.pose_table import rotation_columns, rotations

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

Complex = NDArray[np.complex128]

_ARM_MM = 100.0  # from the origin of a measured pose to points that stand for its rotation
_ITERATIONS = 50  # of shape and angles in turn
_LEAST_ARC = 270.0  # degrees of readings around which a single target determines its circle


def read_places(source: CampaignFiles, poses: list[str], settings: Campaign, log: FaultLog) -> Array | None:
    """Return positions (B, T, 3), mm, of T points on the moved body, NaN where unseen; None without such a table.

    Measured poses are three points. The instrument stands still: all positions are in one frame.
    """
    named = [table for table in ("points", "poses") if source.entries(table)]
    if not named:
        return None
    rows = collect_rows(source, POINTS if named[0] == "points" else POSES, log, "pose")
    if rows is None:
        return None
    if len(named) > 1:
        log.add(Fault(rows.first_file, "either points or poses of what the axis moves"))
        return None
    body = np.array(texts(rows, "body"), object)
    rows.fault(log, body != body[0], "body", "one body: what the axis moves")
    index = {pose: row for row, pose in enumerate(poses)}
    at = [index.get(str(pose), -1) for pose in rows.table.column("pose").to_pylist()]
    rows.fault(log, np.array(at) < 0, "pose", "a pose of configurations")
    found = _targets(rows, at, len(poses)) if named[0] == "points" else _corners(rows, at, len(poses), settings, log)
    return found if np.isfinite(found).all(2).any() else None


def _positions(rows: CollectedRows) -> Array:
    return np.stack([numbers(rows, name) for name in COORDINATES], -1)


def _targets(rows: CollectedRows, at: list[int], count: int) -> Array:
    names = texts(rows, "target")
    column = {name: k for k, name in enumerate(dict.fromkeys(names))}
    found = np.full((count, len(column), 3), np.nan)
    known = np.array(at) >= 0
    found[np.array(at)[known], np.array([column[name] for name in names])[known]] = _positions(rows)[known]
    return found


def _corners(rows: CollectedRows, at: list[int], count: int, settings: Campaign, log: FaultLog) -> Array:
    found = np.full((count, 3, 3), np.nan)
    if (columns := rotation_columns(rows, log)) is None:
        return found
    known = np.array(at) >= 0
    R = rotations(rows, columns, settings.poses.euler, log)
    corners = _positions(rows)[:, None] + _ARM_MM * (np.swapaxes(R, 1, 2) - np.mean(R, axis=2)[:, None])
    found[np.array(at)[known]] = corners[known]
    return found


def displacements(points: Array, command: Array) -> Array:
    """Return displacements (B,) along the line of the movement, from points (B, T, 3), in the sense of the command."""
    seen: Mask = np.asarray(np.isfinite(points).all(2))
    away, along = points - _mean(points, seen[..., None], 0), np.zeros(len(points))
    for _ in range(_ITERATIONS):  # of the mean places of targets that were not always seen
        direction = np.linalg.svd(away[seen], full_matrices=False)[2][0]
        along = _mean(away @ direction, seen, 1)[:, 0]
        away = away - _mean(away - along[:, None, None] * direction, seen[..., None], 0)
    known = seen.any(1) & np.isfinite(command)
    sense = np.sign(np.sum((command[known] - command[known].mean()) * along[known]))
    return np.where(seen.any(1), sense * along, np.nan)


def angles(points: Array, command: Array) -> Array | None:
    """Return angles (B,), deg, about the axis of the movement, from points (B, T, 3), in the sense of the command (B,).

    Several targets give the rotation of their figure, whose place may wander. A single one gives its angle on the
    circle that fits its places. None where readings span too little of the circle, or no two targets are seen at once.
    """
    seen: Mask = np.asarray(np.isfinite(points).all(2))
    away = points - _mean(points, seen[..., None], 0)
    plane = np.linalg.svd(away[seen], full_matrices=False)[2][:2]
    z = np.where(seen, points @ (plane[0] + 1j * plane[1]), 0.0)
    turn = _of_figure(z, seen) if z.shape[1] > 1 else _of_circle(z[:, 0], seen[:, 0])
    if turn is None:
        return None
    known = np.isfinite(turn) & np.isfinite(command)
    wanted = np.exp(1j * np.radians(command[known]))
    same, opposite = (abs(np.sum(turn[known] ** sign / wanted)) for sign in (1, -1))
    return np.asarray(np.degrees(np.angle(turn if same >= opposite else turn.conj())))


def _mean(values: NDArray, mask: Mask, axis: int) -> NDArray:
    """Return means where the mask is true, along an axis that is kept; zero where it is true nowhere."""
    total = np.sum(np.where(mask, values, 0.0), axis, keepdims=True)
    return np.asarray(total / np.maximum(mask.sum(axis, keepdims=True), 1))


def _of_figure(z: Complex, seen: Mask) -> Complex | None:
    """Return rotations (B,), complex of length one, of the figure of targets z (B, T) in the plane; NaN where fewer
    than two of its targets are seen."""
    first = int(np.argmax(seen.sum(1)))
    seen = seen & seen[first]
    usable, shape = seen.sum(1) > 1, z[first]
    if not usable.any():
        return None
    turn = np.ones(len(z), complex)
    for _ in range(_ITERATIONS):
        figure = np.where(seen, shape - _mean(np.broadcast_to(shape, z.shape), seen, 1), 0.0)
        product = np.sum((z - _mean(z, seen, 1)) * figure.conj(), 1)
        turn = product / np.where(np.abs(product) > 0.0, np.abs(product), 1.0)
        middle = _mean(z - turn[:, None] * shape, seen, 1)
        back = (z - middle) * turn.conj()[:, None]
        shape = _mean(back, seen & usable[:, None], 0)[0]
    return np.where(usable & (np.abs(turn) > 0.5), turn, np.nan)


def _of_circle(z: Complex, seen: Mask) -> Complex | None:
    """Return the places (B,) of one target on its circle, complex of length one; None for a short arc."""
    known = z[seen]
    plane = np.stack([2.0 * known.real, 2.0 * known.imag, np.ones(len(known))], -1)
    x, y, _ = np.linalg.lstsq(plane, np.abs(known) ** 2, rcond=None)[0]
    centre = x + 1j * y
    for _ in range(_ITERATIONS):
        off = known - centre
        slope = np.stack([-off.real / np.abs(off), -off.imag / np.abs(off), -np.ones(len(off))], -1)
        step = np.linalg.lstsq(slope, -(np.abs(off) - np.abs(off).mean()), rcond=None)[0]
        centre += step[0] + 1j * step[1]
    around = np.sort(np.degrees(np.angle(known - centre)))
    gap = max(float(np.diff(around).max(initial=0.0)), 360.0 - float(around[-1] - around[0]))
    if 360.0 - gap < _LEAST_ARC:
        return None
    return np.where(seen, (z - centre) / np.where(seen, np.abs(z - centre), 1.0), np.nan)
