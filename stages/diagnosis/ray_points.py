"""From a run's tables to what the diagnosis compares of rays: what each pose tells of cameras, scale bars and air."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.bundle.ray_statistics import RayChannels, ray_channels
from truing.estimation.rotation import exp_so3
from truing.inference.observations import Epochs, Frames, Observations
from truing.inference.prediction import PredictionError
from truing.simulation.photographs.model import RayModel
from truing.simulation.photographs.ray_poses import RayPoses
from truing.stages.common.point_arrays import number_column, pose_ids, positions
from truing.stages.common.ray_statistics import information_and_score, shared_numbers
from truing.stages.diagnosis.body_points import known_of_poses
from truing.stages.diagnosis.mechanism_points import Gathered
from truing.stages.diagnosis.shown import Shown

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign

# Poses that must tell of their rays before they can be held against each other.
_FEWEST_POSES = 3


@dataclass(frozen=True)
class _Sigmas(Shown):
    """Root mean squares over all that rays tell, in units of their own noise; how far points move is told elsewhere."""

    unit: str = "sigma"
    si: float = 1.0
    drive: str = "what all poses should share"
    scatter: str = "Photograph one pose ten times over without moving anything, and adjust each by itself."

    def largest_motion(self, before: PredictionError, after: PredictionError) -> None:
        """Nothing: no length moves rays."""


@dataclass(frozen=True)
class RayShown:
    """How to tell of rays: all of them together, whatever is concerned."""

    def concerned(self, before: PredictionError, after: PredictionError) -> Shown:
        """How to tell of an effect."""
        return _Sigmas()

    def only(self, target: int) -> Shown:
        """How to tell of one number."""
        return _Sigmas()

    def whole(self, error: PredictionError) -> Shown:
        """How to tell of all rays."""
        return _Sigmas()


def has_rays(tables: Mapping[str, pa.Table]) -> bool:
    """Whether the campaign's points were adjusted from rays, in poses enough to hold these against each other."""
    names = ("ray_statistics", "ray_information", "ray_effects")
    return all(name in tables for name in names) and len(pose_ids(tables["ray_statistics"])) >= _FEWEST_POSES


def gather_rays(tables: Mapping[str, pa.Table], settings: Campaign) -> tuple[Gathered, RayPoses]:
    """What the diagnosis compares of rays, and all poses with rays."""
    poses = pose_ids(tables["ray_statistics"])
    numbers = shared_numbers(tables["ray_statistics"])
    covariates, role = known_of_poses(tables.get("configurations"), poses, ())
    channels = ray_channels(*information_and_score(tables, poses, numbers))
    time = covariates.get("time_s")
    whole = RayPoses(
        poses,
        numbers,
        tuple(number.called for number in numbers),
        channels.root,
        channels.told,
        covariates,
        (float(np.nanmin(time)), float(np.nanmax(time))) if time is not None and np.isfinite(time).any() else None,
        getattr(settings.mechanism, "reference_temperature_c", 20.0),
        _vertical(tables["poses"], poses, settings.reference_body) if "poses" in tables else None,
    )
    held = role == "verification"
    if (~held).sum() < _FEWEST_POSES:
        held[:] = False
    model = RayModel.of(some_poses(whole, ~held))
    gathered = Gathered(
        model,
        _poses(whole, channels, ~held),
        _poses(whole, channels, held) if held.any() else None,
        "",
        None,
    )
    return gathered, whole


def some_poses(rays: RayPoses, rows: NDArray[np.bool_]) -> RayPoses:
    """What is known of some poses (rows: mask)."""
    return replace(
        rays,
        poses=tuple(pose for pose, kept in zip(rays.poses, rows, strict=True) if kept),
        root=rays.root[rows],
        seen=rays.seen[rows],
        covariates={name: values[rows] for name, values in rays.covariates.items()},
        up=None if rays.up is None else rays.up[rows],
    )


def _poses(rays: RayPoses, channels: RayChannels, rows: NDArray[np.bool_]) -> Epochs:
    values = channels.value[rows]
    measured = Observations(values[..., None], np.ones((*values.shape, 1, 1)), channels.told[rows])
    return Epochs(measured, some_poses(rays, rows), Frames.of_numbers(int(rows.sum())))


def _vertical(table: pa.Table, poses: tuple[int | str, ...], body: str | None) -> NDArray | None:
    """The z axis (B, 3) of the body that the others are seen from, in the measurement of each pose; None where that is
    not known of all."""
    import pyarrow.compute as pc

    rows = table.filter(pc.and_(table.column("default"), pc.equal(table.column("body"), body or "")))
    place = positions(rows.column("pose"), poses)
    turns = exp_so3(np.nan_to_num(np.column_stack([number_column(rows, f"r{axis}_rad") for axis in "xyz"])))
    found = np.full((len(poses), 3), np.nan)
    found[place[place >= 0]] = turns[place >= 0][:, :, 2]
    return found if np.isfinite(found).all() else None
