"""Poses that a chain may take: limits of its joints, regions to avoid, random candidates, and their conditions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.schemas.faults import CampaignFaults, Fault
from truing.simulation.inputs import TIME
from truing.simulation.mechanisms.chains.conditions import ChainConditions
from truing.simulation.mechanisms.chains.joint_table import JointColumn, joint_column
from truing.simulation.mechanisms.chains.model import ChainModel
from truing.simulation.mechanisms.chains.tree import JointKind, Tree
from truing.stages.common.chain_measurements import chain_conditions
from truing.stages.common.point_arrays import number_column

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

FILE = "campaign.toml"
_AXES = ("x_mm", "y_mm", "z_mm")
_MM = 1e-3
# Points on the straight line from one joint's frame to the next that must stay out of forbidden boxes.
_BETWEEN = 8
_CORNERS = 200  # of the ranges of the joints, drawn at random
_ROUNDS = 20  # of drawing, until enough candidates are allowed
_FINEST = 1e-3  # deg or mm: proposed readings are rounded to it

# From readings by column, deg or mm, and origins of links (C, 3) by name, mm, to a mask (C,) of forbidden poses.
Forbids = Callable[[Mapping[str, NDArray], Mapping[str, NDArray]], NDArray]


@dataclass(frozen=True)
class JointRanges:
    """Columns of the n joints in tables, and the lowest and highest reading of each, rad or m; ``given_by`` names
    their source."""

    columns: tuple[JointColumn, ...]
    low: Array
    high: Array
    given_by: tuple[str, ...]

    @property
    def width(self) -> Array:
        """Range (n,) of each joint, rad or m."""
        return self.high - self.low

    def table(self, readings: NDArray, **more: pa.Array) -> pa.Table:
        """Table of poses with readings (B, n) in the units of the columns, after the columns ``more``."""
        values = (readings / [c.si for c in self.columns]).T
        return pa.table(more | {c.name: np.round(value, 9) for c, value in zip(self.columns, values, strict=True)})


def joint_ranges(
    tree: Tree,
    settings: Campaign,
    joints: pa.Table,
    measured: pa.Table | None,
    otherwise: Mapping[str, tuple[float, float]] = MappingProxyType({}),
) -> JointRanges:
    """Ranges of the joints: of [workspace] joints, else the description's limits, else of the readings ``measured``.

    ``otherwise``: by joint, rad or m, where none of these gives a range. Raises CampaignFaults for a joint without one.
    """
    given = settings.workspace.joints
    limits = {row["joint"]: (row["lower_si"], row["upper_si"]) for row in joints.to_pylist()}
    columns, ends, sources, faults = [], [], [], []
    for joint in tree.readings:
        joint_values = joint_column(tree, joint, given)
        column = None if measured is None else joint_column(tree, joint, measured.schema.names)
        column = column or joint_values or joint_column(tree, joint, (f"{joint}_deg", f"{joint}_mm"))
        assert column is not None
        low, high = limits.get(joint, (None, None))
        source = "limits of the description"
        if joint_values is not None:
            (low, high), source = np.array(given[joint_values.name]) * joint_values.si, "[workspace] joints"
        elif (low is None or high is None) and measured is not None and column.name in measured.schema.names:
            values = number_column(measured, column.name) * column.si
            (low, high), source = (np.nanmin(values), np.nanmax(values)), "range of the measured readings"
        if (low is None or high is None or not low < high) and joint in otherwise:
            (low, high), source = otherwise[joint], "assumed"
        if low is None or high is None or not low < high:
            expected = f"lowest and highest reading of joint {joint}, which the description does not limit"
            faults.append(Fault(FILE, expected, column=f"workspace.joints.{column.name}"))
            continue
        columns.append(column)
        ends.append((low, high))
        sources.append(source)
    if faults:
        raise CampaignFaults(faults)
    low, high = np.array(ends, float).T
    return JointRanges(tuple(columns), low, high, tuple(sources))


@dataclass(frozen=True)
class ForbiddenPoses:
    """Regions that poses must avoid: F boxes of readings (F, n) and places (F, 3) in the base's frame, and functions.

    A box forbids a pose if all readings are within, and a moving link touches its range of places: its origin, or the
    straight line to it from the link below; ``links`` (F,) restricts it to some links. SI.
    """

    reading_ends: NDArray  # (2, F, n)
    place_ends: NDArray  # (2, F, 3)
    links: tuple[tuple[str, ...], ...]
    functions: tuple[Forbids, ...] = ()

    def allowed(self, tree: Tree, ranges: JointRanges, readings: NDArray) -> Mask:
        """Mask (C,) of the readings (C, n) that no region forbids."""
        frames = tree.frames(readings)
        is_allowed = np.asarray(~self.within(tree, readings).any(0))
        if self.functions:
            named_readings = {c.name: readings[:, k] / c.si for k, c in enumerate(ranges.columns)}
            positions = {node.link: frames.t[:, k] / _MM for k, node in enumerate(tree.nodes)}
            for function in self.functions:
                is_allowed &= ~_forbidden_by(function, named_readings, positions, len(readings))
        return is_allowed

    def within(self, tree: Tree, readings: NDArray) -> Mask:
        """Mask (F, C) of the poses that each box forbids."""
        points, owners = _points_of_links(tree, tree.frames(readings).t)
        is_within = np.ones((len(self.links), len(readings)), bool)
        for box, links in enumerate(self.links):
            is_within[box] = _inside(readings, self.reading_ends[:, box]).all(-1)
            if np.isfinite(self.place_ends[:, box]).any():
                concerns = np.array([not links or owner in links for owner in owners], bool)
                is_within[box] &= _inside(points[:, concerns], self.place_ends[:, box]).all(-1).any(-1)
        return is_within


def _forbidden_by(
    function: Forbids, readings: Mapping[str, NDArray], positions: Mapping[str, NDArray], count: int
) -> Mask:
    name = getattr(function, "__qualname__", str(function))
    forbidden = np.asarray(function(readings, positions))
    if forbidden.shape != (count,) or forbidden.dtype != bool:
        expected = f"a mask of {count} values, true where a pose is forbidden"
        raise CampaignFaults([Fault("--avoid", expected, value=f"{name}: {forbidden.dtype} {forbidden.shape}")])
    return np.asarray(forbidden, bool)


def _inside(values: NDArray, ends: NDArray) -> Mask:
    return np.asarray((values > ends[0]) & (values < ends[1]))


def _points_of_links(tree: Tree, origins: NDArray) -> tuple[Array, list[str]]:
    """Points (C, P, 3) on the lines between the origins of links that move, and the link of each."""
    share = np.linspace(1.0, 0.0, _BETWEEN, endpoint=False)[:, None]
    parts, owners = [], []
    for k, node in enumerate(tree.nodes):
        below = tree.moving_parent(k)
        if node.parent < 0 or (below < 0 and node.kind is not JointKind.PRISMATIC):
            continue  # it does not move
        start = origins[:, None, k if below < 0 else node.parent]
        parts.append(start + share * (origins[:, None, k] - start))
        owners += [node.link] * _BETWEEN
    return np.concatenate(parts, 1), owners


def forbidden_poses(
    tree: Tree, ranges: JointRanges, table: pa.Table | None, file: str, functions: tuple[Forbids, ...] = ()
) -> ForbiddenPoses:
    """Regions of a table, one per row: columns such as elbow_min_deg, x_min_mm, z_max_mm and ``link`` (one or several
    links, with spaces between them).

    An empty cell leaves that side open. Raises CampaignFaults for other columns, unknown links and empty boxes.
    """
    count = 0 if table is None else len(table)
    size = len(tree.readings)
    ends = np.stack([np.full((count, size + 3), sign * np.inf) for sign in (-1.0, 1.0)])
    if table is None:
        return ForbiddenPoses(ends[..., :size], ends[..., size:], (), functions)
    units = {c.name: c.si for c in ranges.columns} | dict.fromkeys(_AXES, _MM)
    known = {_side(stem, side): (s, k) for k, stem in enumerate(units) for s, side in enumerate(("min", "max"))}
    unknown = [name for name in table.schema.names if name not in known and name != "link"]
    if unknown or not count:
        expected = f"rows of forbidden regions, columns of link, {', '.join(known)}"
        raise CampaignFaults(Fault(file, expected, column=name) for name in unknown or [None])
    for name in table.schema.names:
        if name in known:
            side, k = known[name]
            values = given_numbers(table, name, file) * list(units.values())[k]
            ends[side, :, k] = np.where(np.isnan(values), ends[side, :, k], values)
    named = table.column("link").to_pylist() if "link" in table.schema.names else [None] * count
    links = [tuple(str(link_names or "").split()) for link_names in named]
    faults = [
        Fault(file, f"links of the chain: {', '.join(tree.links)}", row=row + 2, column="link", value=link)
        for row, link_names in enumerate(links)
        for link in link_names
        if link not in tree.links
    ]
    wrong = np.any(ends[0] >= ends[1], -1) | np.isinf(ends).all((0, 2))
    expected = "a forbidden region with each minimum below its maximum, and at least one of them"
    faults += [Fault(file, expected, row=int(row) + 2) for row in np.flatnonzero(wrong)]
    if faults:
        raise CampaignFaults(faults)
    return ForbiddenPoses(ends[..., :size], ends[..., size:], tuple(links), functions)


def _side(stem: str, side: str) -> str:
    name, _, unit = stem.rpartition("_")
    return f"{name}_{side}_{unit}"


def given_numbers(table: pa.Table, name: str, file: str) -> Array:
    """Numbers of a column; raises CampaignFaults if a value is none."""
    try:
        return number_column(table, name)
    except ValueError:
        raise CampaignFaults([Fault(file, "numbers", column=name)]) from None


def drawn_readings(
    tree: Tree, ranges: JointRanges, forbidden: ForbiddenPoses, count: int, rng: np.random.Generator
) -> Array:
    """Readings (C, n) of ``count`` allowed poses or fewer: corners of the ranges, and points within; rad or m.

    Raises CampaignFaults if the regions to avoid leave no pose.
    """
    accepted: list[Array] = []
    corners = rng.integers(2, size=(_CORNERS, len(ranges.low)))
    trial = ranges.low + np.unique(corners, axis=0) * ranges.width
    for _ in range(_ROUNDS):
        trial = _rounded(ranges, trial)
        accepted.append(trial[forbidden.allowed(tree, ranges, trial)])
        if sum(map(len, accepted)) >= count:
            break
        trial = rng.uniform(ranges.low, ranges.high, (count, len(ranges.low)))
    readings = np.concatenate(accepted)[:count]
    if not len(readings):
        rows = [int(row) + 2 for row in np.flatnonzero(forbidden.within(tree, trial).all(1))]
        expected = "regions that leave a pose within the ranges of the joints; this one forbids every pose"
        raise CampaignFaults([Fault("--avoid", expected, row=row) for row in rows] or [Fault("--avoid", expected)])
    return np.asarray(readings)


def _rounded(ranges: JointRanges, readings: NDArray) -> Array:
    """Readings rounded inwards to the finest step of their columns."""
    step = np.array([_FINEST * (c.si if c.si in (_MM, np.pi / 180.0) else _MM) for c in ranges.columns])
    inner = np.ceil(ranges.low / step - 1e-6), np.floor(ranges.high / step + 1e-6)
    return np.asarray(step * np.clip(np.round(readings / step), *inner))


def conditions_of_table(model: ChainModel, settings: Campaign, table: pa.Table, readings: NDArray) -> ChainConditions:
    """Conditions of planned poses, a table like configurations; a column that the campaign has and the plan has not is
    held at its median, and times go on at the campaign's pace. Orientations count from those that the model
    predicts."""
    count, channels = len(readings), len(model.channels.names)
    if (time := model.conditions.covariates.get(TIME)) is not None and len(time) > 1:
        pace = float(np.median(np.diff(np.sort(time))))
        table = table.drop_columns([TIME]) if TIME in table.schema.names else table
        table = table.append_column(TIME, pa.array(pace * np.arange(count)))
    identity = np.tile(np.eye(3), (count, channels, 1, 1))
    coupled = model.conditions.coupling
    if coupled is not None:
        coupled = np.broadcast_to(np.median(coupled, axis=0), (count, *coupled.shape[1:]))
    conditions = chain_conditions(model.tree, table, settings, identity, readings, np.ones(count, bool), coupled)
    covariates = model.conditions.covariates
    constants = {
        name: np.full(count, np.nanmedian(values))
        for name, values in covariates.items()
        if name not in conditions.covariates and values.ndim == 1 and np.isfinite(values).any() and name != "payload_kg"
    }
    conditions = replace(conditions, covariates={**conditions.covariates, **constants})
    series = np.minimum(conditions.series, len(model.known.base_t) - 1)
    if "payload_kg" not in table.schema.names:
        conditions = replace(conditions, payload_kg=np.full(count, float(np.median(model.conditions.payload_kg))))
    return with_predicted_orientations(model, replace(conditions, series=series))


def with_predicted_orientations(model: ChainModel, conditions: ChainConditions) -> ChainConditions:
    """Conditions whose orientations count from those that the nominal chain predicts."""
    turned: Index = np.flatnonzero(model.channels.is_rotation)
    if not len(turned):
        return conditions
    there = model.at(conditions)
    frames = there.tree_frames(np.zeros(model.shared_size), np.zeros((len(conditions.readings), model.local_size)))
    reference = conditions.reference.copy()
    reference[:, turned] = frames.R[:, model.channels.node[turned]] @ model.known.tool[turned]
    return replace(conditions, reference=reference)
