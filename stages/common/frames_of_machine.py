"""Frames of a sensor or of a machine on six legs: base, platform, legs with their joints, and measured directions."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa

from truing.arrays import Array
from truing.estimation.interferometry.recorded_steps import CHANNELS
from truing.schemas.calibration_columns import LEG_JOINTS
from truing.simulation.bench.six_upur.assembly import joined_links, sensor_chains
from truing.simulation.bench.six_upur.geometry import leg_axes, outward
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.legs.kinematics import forward, unit, upper_joints
from truing.stages.common.beam_rows import LINEAR, beam_direction
from truing.stages.common.nominal_mechanism import facing, nominal_legs
from truing.stages.common.rows import Rows
from truing.stages.common.sensor_elements import sensor_joints

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import LeggedMechanism

_MM = 1e3  # per m
_XYZ = ("x", "y", "z")
_JOINT_AXES = 6  # S1 .. S6; S7 belongs to an imaginary joint
_STRAIGHT = ("6-pus", "ups")
_VERTICAL = 1e-9  # sine, below which a leg is along z of the base


def machine_frames(settings: Campaign, poses: pa.Table | None = None) -> pa.Table | None:
    """Table `frames` of a 6-upur, unloaded, or of a machine on six straight legs or more at its reference readings.

    ``poses``: measured poses, which tell the side of the base on which a platform of type ups stands. None of other
    mechanisms, and of legs that do not close.
    """
    if getattr(settings.mechanism, "height_mm", None) is not None:
        return _frames_of_sensor(settings)
    section = settings.mechanism
    if getattr(section, "type", None) not in _STRAIGHT or len(cast("LeggedMechanism", section).legs) < 6:
        return None
    legs = nominal_legs(cast("LeggedMechanism", section))
    lengths = [leg.flexure_length_mm or 0.0 for leg in cast("LeggedMechanism", section).legs]
    return _frames_of_legs(legs if poses is None else facing(legs, poses), np.array(lengths) / _MM)


def _frames_of_sensor(settings: Campaign) -> pa.Table:
    joints, rows = sensor_joints(settings.mechanism), Rows("frames")  # type: ignore[arg-type]
    _add(rows, "base", _XYZ, np.zeros(3), np.eye(3))
    _add(rows, "platform", _XYZ, joints.origin, np.eye(3))
    links = joined_links(sensor_chains(joints))
    base_radius, platform_radius = outward(joints.lower), outward(joints.arm)
    for k, axes in enumerate(leg_axes(joints.direction)):
        _add(rows, f"leg {k + 1}", _XYZ, joints.lower[k], axes.T)
        # Lower universal joint, cell in the middle, upper universal and revolute joints.
        upper = joints.origin + joints.arm[k]
        at = [joints.lower[k]] * 2 + [0.5 * (joints.lower[k] + upper)] + [upper] * 3
        names = [f"S{j + 1}" for j in range(_JOINT_AXES)]
        _add(rows, f"{LEG_JOINTS} {k + 1}", names, np.stack(at), links.axis[k, :_JOINT_AXES])
        radii = np.stack([base_radius[k], platform_radius[k]])
        _add(rows, f"radii of leg {k + 1}", ("base", "platform"), np.stack([joints.lower[k], upper]), radii)
    beams = [getattr(settings.interferometer.beams, name) for name in CHANNELS]
    at = [joints.origin + (np.array(beam.arm_mm) / _MM if k < LINEAR else 0.0) for k, beam in enumerate(beams)]
    _add(rows, "measurement", CHANNELS, np.stack(at), np.stack([beam_direction(k, b) for k, b in enumerate(beams)]))
    return rows.table()


def _frames_of_legs(legs: Legs, flexure_length: Array) -> pa.Table | None:
    rows = Rows("frames")
    rho = np.atleast_2d(legs.rho0)
    motions = forward(legs, rho)
    if not motions.converged.all():
        return None
    lower = np.broadcast_to(legs.closure.lower(legs, rho), (1, *legs.a.shape))[0]
    upper = upper_joints(legs, motions.p, motions.R)[0]
    _add(rows, "base", _XYZ, np.zeros(3), np.eye(3))
    _add(rows, "platform", _XYZ, motions.p[0], motions.R[0].T)
    for k, z in enumerate(unit(upper - lower)):
        _add(rows, f"leg {k + 1}", _XYZ, lower[k], _axes_of_leg(z))
        moved = ("u", legs.u[k]) if "u" in legs.closure.geometry else ("z", z)
        half = 0.5 * flexure_length[k]
        ends = [("a'", lower[k] - half * z), ("c'", lower[k] + half * z)] if half else []
        ends += [("d'", upper[k] - half * z), ("b'", upper[k] + half * z)] if half else []
        names = [moved[0], *(name for name, _ in ends), "b"]
        at = np.stack([lower[k], *(point for _, point in ends), upper[k]])
        _add(rows, f"{LEG_JOINTS} {k + 1}", names, at, np.stack([moved[1], *[z] * (len(names) - 1)]))
    return rows.table()


def _axes_of_leg(z: Array) -> Array:
    """Rows x, y, z of a leg along z: x in the plane of z and of the base's z (telescope report, section 2.2)."""
    up = np.array([0.0, 0.0, 1.0])
    x = up - (up @ z) * z
    x = x if np.linalg.norm(x) > _VERTICAL else np.array([1.0, 0.0, 0.0]) - z[0] * z
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _add(rows: Rows, frame: str, names: tuple[str, ...] | list[str], origin: Array, directions: Array) -> None:
    """Add the axes (n, 3) of a frame at origin (3,) or at points (n, 3), m."""
    at = _MM * np.broadcast_to(origin, directions.shape)
    unit_vectors = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    rows.add(
        frame=frame,
        axis_name=list(names),
        **{f"{c}_mm": at[:, k] for k, c in enumerate(_XYZ)},
        **{f"along_{c}": unit_vectors[:, k] for k, c in enumerate(_XYZ)},
    )
