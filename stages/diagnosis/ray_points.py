"""Data of the diagnosis of rays: information of each pose on cameras, scale bars and air."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.estimation.bundle.ray_statistics import RayChannels, ray_channels
from truing.inference.observations import Epochs, Frames, Observations
from truing.schemas.verdict import Relation
from truing.simulation.photographs.model import RayModel
from truing.simulation.photographs.ray_poses import RayPoses
from truing.stages.common.blocks import groupings_of, labels_of, readings_of, selected_groupings
from truing.stages.common.missing_data import HELD_OUT
from truing.stages.common.point_arrays import default_motions, number_column, pose_ids, positions
from truing.stages.common.ray_statistics import information_and_score, shared_numbers
from truing.stages.diagnosis.body_points import known_of_poses
from truing.stages.diagnosis.diagnosis_data import RAYS, DiagnosisData, InstrumentResults

if TYPE_CHECKING:
    from truing.inference.selection import CauseDiagnosis
    from truing.schemas.campaign import Campaign
    from truing.simulation.effects_model import EffectsModel

# Least number of poses with information from rays that are compared.
_FEWEST_POSES = 3
_SI = 1e-3
_EXACT_MM = 1e-6  # bars without any uncertainty count alike


def has_rays(tables: Mapping[str, pa.Table]) -> bool:
    """True if the campaign's points were adjusted from rays, in enough poses for a comparison."""
    names = ("ray_statistics", "ray_information", "ray_effects")
    return all(name in tables for name in names) and len(pose_ids(tables["ray_statistics"])) >= _FEWEST_POSES


def assemble_rays(tables: Mapping[str, pa.Table], settings: Campaign) -> tuple[DiagnosisData[RayModel], RayPoses]:
    """Data of the diagnosis of rays, and all poses with rays."""
    poses = pose_ids(tables["ray_statistics"])
    numbers = shared_numbers(tables["ray_statistics"])
    covariates, role = known_of_poses(tables.get("configurations"), poses, ())
    channels = ray_channels(*information_and_score(tables, poses, numbers))
    time = covariates.get("time_s")
    all_poses = RayPoses(
        poses,
        numbers,
        tuple(number.called for number in numbers),
        channels.root,
        channels.determined,
        covariates,
        (float(np.nanmin(time)), float(np.nanmax(time))) if time is not None and np.isfinite(time).any() else None,
        getattr(settings.mechanism, "reference_temperature_c", 20.0),
        _vertical(tables["poses"], poses, settings.reference_body) if "poses" in tables else None,
    )
    held_out = role == HELD_OUT
    if (~held_out).sum() < _FEWEST_POSES:
        held_out[:] = False
    model, table = RayModel.of(some_poses(all_poses, ~held_out)), tables.get("configurations")
    commanded = readings_of(table, poses, settings.campaign.drives)[~held_out]
    groupings = groupings_of(
        commanded,
        None if time is None else time[~held_out],
        None,
        selected_groupings(labels_of(table, poses), ~held_out),
    )
    data = DiagnosisData(
        model,
        replace(_poses(all_poses, channels, ~held_out), groupings=groupings),
        _poses(all_poses, channels, held_out) if held_out.any() else None,
        "",
        _nothing_more,
        shown=RAYS,
        relation=Relation.RAYS_POINTS,
    )
    return data, all_poses


def some_poses(rays: RayPoses, rows: NDArray[np.bool_]) -> RayPoses:
    """Conditions of some poses (rows: mask)."""
    return replace(
        rays,
        poses=tuple(pose for pose, row in zip(rays.poses, rows, strict=True) if row),
        root=rays.root[rows],
        is_observed=rays.is_observed[rows],
        covariates={name: values[rows] for name, values in rays.covariates.items()},
        up=None if rays.up is None else rays.up[rows],
    )


def _poses(rays: RayPoses, channels: RayChannels, rows: NDArray[np.bool_]) -> Epochs:
    values = channels.value[rows]
    measured = Observations(values[..., None], np.ones((*values.shape, 1, 1)), channels.determined[rows])
    return Epochs(measured, some_poses(rays, rows), Frames.of_numbers(int(rows.sum())))


def _vertical(table: pa.Table, poses: tuple[int | str, ...], body: str | None) -> NDArray | None:
    """The z axis (B, 3) of the body that the others are seen from, in the measurement of each pose; None where that is
    not known of all."""
    axes = default_motions(table, body or "", poses)[0][:, :, 2]
    return axes if np.isfinite(axes).all() else None


def _nothing_more(
    diagnosis: CauseDiagnosis, data: DiagnosisData[EffectsModel], settings: Campaign
) -> InstrumentResults:
    """No table of rays alone: their results are in the tables of points."""
    return InstrumentResults({})


def scale_height(tables: Mapping[str, pa.Table], poses: Epochs) -> float:
    """The mean height, m, in the model's frame, of the bars' middles, each as its calibration counts in the scale.

    Without bars the mean height of all measured points, whose survey gives the scale then.
    """
    if "object_points" in tables and "scale_bars" in tables:
        height, weight = _of_bars(tables["object_points"], tables["scale_bars"], poses)
        if weight.sum() > 0:
            return float(np.sum(height * weight) / weight.sum())
    measured = poses.measured
    inside = np.einsum("bkd,bde->bke", np.nan_to_num(measured.values) - poses.frames.t[:, None], poses.frames.R)
    return float(inside[..., 2][measured.is_observed].mean())


def _of_bars(points: pa.Table, bars: pa.Table, poses: Epochs) -> tuple[NDArray, NDArray]:
    """Heights (N,) of the middles of bars in the poses, m, and the weights of their lengths."""
    names = tuple(dict.fromkeys(points.column("point").to_pylist()))
    pose_names = tuple(poses.conditions.poses)
    pose, point = positions(points.column("pose"), pose_names), positions(points.column("point"), names)
    is_present = pose >= 0
    place = np.full((len(pose_names), len(names), 3), np.nan)
    place[pose[is_present], point[is_present]] = (
        np.column_stack([number_column(points, f"{a}_mm") for a in "xyz"])[is_present] * _SI
    )
    inside = np.einsum("bkd,bde->bke", place - poses.frames.t[:, None], poses.frames.R)
    ends = [positions(bars.column(name), names) for name in ("first", "second")]
    uncertain = np.hypot(number_column(bars, "sigma_mm"), number_column(bars, "repeat_sigma_mm"))
    weight = (number_column(bars, "length_mm") / np.maximum(uncertain, _EXACT_MM)) ** 2
    scaling = np.array([serves == "scale" for serves in bars.column("serves").to_pylist()])
    known = (ends[0] >= 0) & (ends[1] >= 0) & scaling & np.isfinite(weight)
    height = 0.5 * (inside[:, ends[0][known], 2] + inside[:, ends[1][known], 2])
    is_observed = np.isfinite(height)
    return height[is_observed], np.broadcast_to(weight[known], height.shape)[is_observed]
