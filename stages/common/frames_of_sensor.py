"""Frames of a sensor in its fixed frame: base, platform, legs with their joint axes, and measured directions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import Array
from truing.estimation.interferometry.recorded_steps import CHANNELS
from truing.simulation.bench.six_upur.assembly import joined_links, sensor_chains
from truing.simulation.bench.six_upur.geometry import leg_axes
from truing.stages.common.beam_rows import LINEAR, beam_direction
from truing.stages.common.rows import Rows
from truing.stages.common.sensor_elements import sensor_joints

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

_MM = 1e3  # per m
_XYZ = ("x", "y", "z")
_JOINT_AXES = 6  # S1 .. S6; S7 belongs to an imaginary joint


def sensor_frames(settings: Campaign) -> pa.Table | None:
    """Table `frames` of a 6-upur, unloaded; None of other mechanisms."""
    if getattr(settings.mechanism, "height_mm", None) is None:
        return None
    joints, rows = sensor_joints(settings.mechanism), Rows("frames")  # type: ignore[arg-type]
    _add(rows, "base", _XYZ, np.zeros(3), np.eye(3))
    _add(rows, "platform", _XYZ, joints.origin, np.eye(3))
    links = joined_links(sensor_chains(joints))
    for k, axes in enumerate(leg_axes(joints.direction)):
        _add(rows, f"leg {k + 1}", _XYZ, joints.lower[k], axes.T)
        # Lower universal joint, cell in the middle, upper universal and revolute joints.
        upper = joints.origin + joints.arm[k]
        at = [joints.lower[k]] * 2 + [0.5 * (joints.lower[k] + upper)] + [upper] * 3
        names = [f"S{j + 1}" for j in range(_JOINT_AXES)]
        _add(rows, f"joints of leg {k + 1}", names, np.stack(at), links.axis[k, :_JOINT_AXES])
    beams = [getattr(settings.interferometer.beams, name) for name in CHANNELS]
    at = [joints.origin + (np.array(beam.arm_mm) / _MM if k < LINEAR else 0.0) for k, beam in enumerate(beams)]
    _add(rows, "measurement", CHANNELS, np.stack(at), np.stack([beam_direction(k, b) for k, b in enumerate(beams)]))
    return rows.table()


def _add(rows: Rows, frame: str, names: tuple[str, ...] | list[str], origin: Array, directions: Array) -> None:
    """Add the axes (n, 3) of a frame at origin (3,) or at points (n, 3), m."""
    at = _MM * np.broadcast_to(origin, directions.shape)
    unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    rows.add(
        frame=frame,
        axis_name=list(names),
        **{f"{c}_mm": at[:, k] for k, c in enumerate(_XYZ)},
        **{f"along_{c}": unit[:, k] for k, c in enumerate(_XYZ)},
    )
