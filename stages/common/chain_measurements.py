"""Measured links of a chain as channels, the conditions of their poses, and the frames that join the poses."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index, Mask
from truing.estimation.rigid_poses.points import PosePoints
from truing.estimation.rigid_poses.umeyama import umeyama
from truing.estimation.rotation import exp_so3
from truing.schemas.covariates import column_alias
from truing.simulation.inputs import ORDER, TIME, between_neighbours, is_row_number, numbers_rows, order_in_time
from truing.simulation.mechanisms.chains.conditions import ChainConditions, MeasuredChannels, movements
from truing.simulation.mechanisms.chains.joint_table import joint_columns, motor_column
from truing.simulation.mechanisms.chains.tree import Tree
from truing.stages.common.chain_tables import payload_of
from truing.stages.common.missing_data import LEAST_TARGETS
from truing.stages.common.point_arrays import (
    number_column,
    pose_covariances,
    pose_ids,
    pose_points,
    pose_vectors,
    positions,
    survey_points,
)

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.sections import Overrule

# Smallest movement of a joint that counts as one, as a share of its range.
_MOVED = 1e-4


# Mask (B, T) of the points of a body that are left out, from the tables of the campaign.
Screen = Callable[[Mapping[str, pa.Table], str, PosePoints], Mask]


@dataclass(frozen=True)
class MeasuredLinks:
    """Channels of some poses: values (B, K, 3), covariances (B, K, 3, 3), and which were seen; m and rad.

    ``surveyed`` (K, 3) and ``survey_cov`` (K, 3, 3) are NaN where a place is unknown; ``reference`` (B, K, 3, 3) are
    the measured orientations. ``coupling`` (B, K, 3, 3) as of `ChainConditions`. With distances, ``values`` are
    (B, M + D, 1): coordinates of channels, ``coordinates`` (M, 2) their channel and axis, then distances, ``ends``
    (D, 2) their channels.
    """

    channels: MeasuredChannels
    values: Array
    cov: Array
    is_observed: Mask
    surveyed: Array
    survey_cov: Array
    reference: Array
    ends: Index | None = None
    coordinates: Index | None = None
    coupling: Array | None = None

    @property
    def is_position(self) -> Mask:
        """Mask (K,) or (M + D,) of observations in m."""
        turned = self.channels.is_rotation
        if self.ends is None:
            return ~turned
        of_channels = np.ones(0, bool) if self.coordinates is None else ~turned[self.coordinates[:, 0]]
        return np.concatenate([of_channels, np.ones(len(self.ends), bool)])

    def decoupled(self) -> MeasuredLinks:
        """The channels with the covariance that remains where the noise of the next channel is known."""
        if self.coupling is None:
            return self
        cov, coupling = self.cov.copy(), self.coupling[:, :-1]
        cov[:, :-1] -= coupling @ self.cov[:, 1:] @ np.swapaxes(coupling, -1, -2)
        return replace(self, cov=cov)


def measured_links(
    tables: Mapping[str, pa.Table], tree: Tree, poses: tuple[int | str, ...], wrong: Screen | None = None
) -> MeasuredLinks:
    """Every target of a link, without the points ``wrong``, and every measured pose as channels.

    Raises ValueError without any.
    """
    parts = [*_targets(tables, tree, poses, wrong), *_poses(tables, tree, poses)]
    if not parts:
        raise ValueError("needs points or poses of links of the chain")
    names, links, turned, values, cov, is_observed, surveyed, survey_cov, reference, coupling = zip(*parts, strict=True)
    channels = MeasuredChannels(
        tuple(names), tuple(links), np.array([tree.links[link] for link in links]), np.array(turned, bool)
    )
    return MeasuredLinks(
        channels,
        np.stack(values, 1),
        np.stack(cov, 1),
        np.stack(is_observed, 1),
        np.stack(surveyed),
        np.stack(survey_cov),
        np.stack(reference, 1),
        coupling=np.stack(coupling, 1) if np.any(coupling) else None,
    )


def excluded_poses(rules: Iterable[Overrule], poses: Sequence[int | str]) -> Mask:
    """Mask (B,) of the poses that a person excluded as a whole."""
    named = {str(rule.pose) for rule in rules if rule.pose is not None and not (rule.body or rule.target)}
    return np.array([str(pose) in named for pose in poses], bool)


_Part = tuple[str, str, bool, Array, Array, Mask, Array, Array, Array, Array]


def _targets(
    tables: Mapping[str, pa.Table], tree: Tree, poses: tuple[int | str, ...], wrong: Screen | None
) -> list[_Part]:
    observations, survey = tables.get("observations"), tables.get("survey")
    parts: list[_Part] = []
    if observations is None or not observations.num_rows:
        return parts
    identity = np.tile(np.eye(3), (len(poses), 1, 1))
    for body in dict.fromkeys(observations.column("body").to_pylist()):
        if body not in tree.links:
            raise ValueError(f"body {body} is no link of the chain; there are {', '.join(tree.links)}")
        points = pose_points(observations, body, poses)
        usable = points.is_observed if wrong is None else points.is_observed & ~wrong(tables, body, points)
        known = {} if survey is None else survey_of(survey, body)
        for k, name in enumerate(points.targets):
            point, cov = known.get(name, (np.full(3, np.nan), np.full((3, 3), np.nan)))
            is_observed = usable[:, k] & np.isfinite(points.points[:, k]).all(1)
            parts.append(
                (
                    name,
                    body,
                    False,
                    np.where(is_observed[:, None], points.points[:, k], 0.0),
                    points.cov[:, k],
                    is_observed,
                    point,
                    cov,
                    identity,
                    np.zeros_like(identity),
                )
            )
    return parts


def survey_of(survey: pa.Table, body: str) -> dict[str, tuple[Array, Array]]:
    """Place (3,) and covariance (3, 3) of each surveyed target of a link, m."""
    points = survey_points(survey, body)
    return {name: (points.points[k], points.cov[k]) for k, name in enumerate(points.targets)}


def _poses(tables: Mapping[str, pa.Table], tree: Tree, poses: tuple[int | str, ...]) -> list[_Part]:
    """Position and orientation of each measured link."""
    table = tables.get("measured_poses")
    parts: list[_Part] = []
    if table is None or not table.num_rows:
        return parts
    bodies = np.array(table.column("body").to_pylist(), object)
    for body in dict.fromkeys(bodies):
        if body not in tree.links:
            raise ValueError(f"body {body} is no link of the chain; there are {', '.join(tree.links)}")
        rows = table.filter(pa.array(bodies == body))
        at = positions(rows.column("pose"), poses)
        vectors, covs = pose_vectors(rows)[at >= 0], pose_covariances(rows)[at >= 0]
        at = at[at >= 0]
        values, cov = np.zeros((2, len(poses), 3)), np.zeros((2, len(poses), 3, 3))
        coupling = np.zeros((len(poses), 3, 3))
        reference, is_observed = np.tile(np.eye(3), (len(poses), 1, 1)), np.zeros(len(poses), bool)
        good = np.isfinite(vectors).all(1)
        at, vectors, covs = at[good], vectors[good], covs[good]
        values[0, at], cov[0, at], cov[1, at] = vectors[:, :3], covs[:, :3, :3], covs[:, 3:, 3:]
        coupling[at] = covs[:, :3, 3:] @ np.linalg.inv(covs[:, 3:, 3:])
        reference[at], is_observed[at] = exp_so3(vectors[:, 3:]), True
        nowhere = np.full(3, np.nan), np.full((3, 3), np.nan)
        identity = np.tile(np.eye(3), (len(poses), 1, 1))
        parts.append(("position", body, False, values[0], cov[0], is_observed, *nowhere, identity, coupling))
        none = np.zeros_like(coupling)
        parts.append(("orientation", body, True, values[1], cov[1], is_observed, *nowhere, reference, none))
    return parts


def chain_conditions(
    tree: Tree,
    table: pa.Table,
    settings: Campaign,
    reference: Array,
    readings: Array,
    usable: Mask,
    coupling: Array | None = None,
) -> ChainConditions:
    """Conditions of all rows of configurations; ``reference`` (B, K, 3, 3): measured orientations of the channels."""
    poses, columns = pose_ids(table), joint_columns(tree, table.schema.names)
    motors = [motor_column(tree, joint, table.schema.names) for joint in tree.readings]
    left_out = {"pose", "role", *(column.name for column in motors if column is not None)}
    covariates: dict[str, Array] = {
        column_alias(field.name): number_column(table, field.name)
        for field in table.schema
        if field.name not in left_out and str(field.type) in ("double", "int64")
    }
    kept = {TIME, *(column_alias(column.name) for column in columns)}
    covariates = {name: values for name, values in covariates.items() if name in kept or not numbers_rows(name, values)}
    time = covariates.get("time_s")
    covariates[ORDER] = order_in_time(time, len(poses))
    if time is not None and is_row_number(time):
        del covariates["time_s"]  # numbers of rows, and no seconds
        time = None
    if time is not None:
        covariates |= {
            name: between_neighbours(covariate, time) for name, covariate in covariates.items() if name != ORDER
        }
    covariates |= movements(readings, covariates, _MOVED * np.ptp(readings[usable], axis=0))
    return ChainConditions(
        np.nan_to_num(readings),
        covariates,
        poses,
        _series(settings, table),
        reference,
        payload_of(settings, table),
        tuple(column_alias(column.name) for column in columns),
        coupling=coupling,
    )


def _series(settings: Campaign, table: pa.Table) -> Index:
    """Number (B,) of the frame in which each pose was measured; 0 for all, unless each series has its own."""
    if settings.measurement.frame != "series" or "series" not in table.schema.names:
        return np.zeros(len(table), np.int64)
    labels = [str(value or "") for value in table.column("series").to_pylist()]
    return np.unique(labels, return_inverse=True)[1].astype(np.int64)


def reference_link(settings: Campaign, measured: MeasuredLinks) -> Index | None:
    """Channels of the link that defines the frame of each pose; None if the measurement's frame stands still.

    A single measured link cannot define a frame and be seen in it: the frame then stands still.
    """
    channels = measured.channels
    nodes = np.unique(channels.node)
    if settings.is_frame_fixed or len(nodes) < 2:
        return None
    if channels.is_rotation.any():
        raise ValueError(
            "measured poses of links need an instrument that stood still: "
            'set [measurement] frame = "campaign", or "series" if it stood still within each series'
        )
    link_channels = np.flatnonzero((channels.node == nodes[0]) & ~channels.is_rotation)
    if len(link_channels) < LEAST_TARGETS:
        raise ValueError(
            f"link {channels.links[link_channels[0]]} shows fewer than {LEAST_TARGETS} targets, so no frame joins the "
            "poses; "
            'if the instrument stood still: [measurement] frame = "campaign"'
        )
    return link_channels


def is_framed(measured: MeasuredLinks, link_channels: Index | None) -> Mask:
    """Mask (B,) of the poses whose frame the targets of the reference link determine; all if there is none."""
    count = len(measured.is_observed)
    return (
        np.ones(count, bool)
        if link_channels is None
        else np.asarray(measured.is_observed[:, link_channels].sum(1) >= LEAST_TARGETS)
    )


def pose_frames(measured: MeasuredLinks, link_channels: Index, fitted: Mask) -> tuple[Array, Array]:
    """Return R (B, 3, 3), t (B, 3) m of the poses' frames, from the reference link's targets; NaN where those leave it
    open."""
    points, is_observed = measured.values[:, link_channels], measured.is_observed[:, link_channels]
    shape = measured.surveyed[link_channels]
    if not np.isfinite(shape).all():
        indices = np.flatnonzero(is_observed.all(1) & fitted)
        if not len(indices):
            raise ValueError("needs one pose that shows all targets of the reference link")
        fit = umeyama(points[indices], points[indices[0]][None])
        shape = np.median(np.einsum("bij,bkj->bki", fit.R, points[indices]) + fit.t[:, None], axis=0)
    fit = umeyama(np.broadcast_to(shape, points.shape), points, is_observed.astype(float))
    ok = np.isfinite(fit.t).all(1) & is_framed(measured, link_channels)
    return np.where(ok[:, None, None], fit.R, np.nan), np.where(ok[:, None], fit.t, np.nan)
