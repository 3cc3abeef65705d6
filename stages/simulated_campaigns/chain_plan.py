"""Plan of campaigns of an open chain: nominal tables before any measurement, and tables filled by simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import Array
from truing.estimation.rotation import exp_so3, log_so3
from truing.inference.observations import Epochs
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.cause import Effect, Scene
from truing.simulation.mechanisms.chains.causes import ChainCause
from truing.simulation.mechanisms.chains.conditions import ChainConditions
from truing.simulation.mechanisms.chains.distances import DistanceModel
from truing.simulation.mechanisms.chains.joint_table import STATION
from truing.simulation.mechanisms.chains.measured_lines import GROUND
from truing.simulation.mechanisms.chains.model import ChainModel
from truing.simulation.mechanisms.chains.tree import Tree
from truing.stages.common.chain_tables import joint_readings
from truing.stages.common.point_arrays import RECORDED_ANGLES, number_columns, positions
from truing.stages.simulated_campaigns.plan_base import ModelPlan

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.chain_mechanism import ChainMechanism

_MM = 1e-3
# Gross errors of points, m.
_GROSS_M = 5e-4
_TRANSLATION, _ROTATION = ("px_mm", "py_mm", "pz_mm"), ("rx_rad", "ry_rad", "rz_rad")


def nominal_tables(
    tree: Tree, joints: pa.Table, survey: pa.Table | None, configurations: pa.Table, settings: Campaign
) -> dict[str, pa.Table]:
    """Tables of the nominal chain, measured without errors: every surveyed target, else poses of the tip.

    If the survey places stations (targets named ``station:NAME``), it is the distances from each to every other target.
    Raises ValueError if nothing can be planned.
    """
    tables = {"configurations": configurations, "joints": joints}
    if survey is not None and survey.num_rows:
        return tables | _nominal_targets(tree, survey, configurations, settings)
    return tables | {"measured_poses": _nominal_tip(tree, configurations, settings)}


def _nominal_targets(tree: Tree, survey: pa.Table, configurations: pa.Table, settings: Campaign) -> dict[str, pa.Table]:
    """The survey with the points of its targets in all poses, or with the distances from its stations."""
    noise_mm = settings.noise.point_mm
    if noise_mm is None:
        raise ValueError("needs noise.point_mm, the noise of each coordinate of a point")
    frames = tree.frames(joint_readings(tree, configurations))
    poses, identifier = configurations.column("pose"), _identifier(configurations)
    bodies, names = (survey.column(name).to_pylist() for name in ("body", "target"))
    nodes = np.array([tree.links[body] for body in bodies])
    positions = number_columns(survey, ("x_mm", "y_mm", "z_mm")) * _MM
    values = frames.t[:, nodes] + np.einsum("bkij,kj->bki", frames.R[:, nodes], positions)
    is_station = np.array([name.startswith(STATION) for name in names], bool)
    if is_station.any():
        lines = _nominal_distances(list(zip(bodies, names, strict=True)), values, is_station, poses)
        lines["sigma_mm"] = np.full(len(lines["reading_mm"]), noise_mm)
        schema = ARTIFACTS["distances"].arrow_schema(identifier)
        distances = pa.table({name: lines[name] for name in schema.names}).cast(schema)
        return {"survey": survey.filter(pa.array(~is_station)), "distances": distances}
    flat, count = values.reshape(-1, 3) / _MM, len(bodies)
    columns: dict[str, object] = {
        "pose": poses.take(np.repeat(np.arange(len(poses)), count)),
        "body": bodies * len(poses),
        "target": names * len(poses),
    }
    columns |= {f"{axis}_mm": flat[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"sigma_{axis}_mm": np.full(len(flat), noise_mm) for axis in "xyz"}
    schema = ARTIFACTS["observations"].arrow_schema(identifier)
    return {"survey": survey, "observations": pa.table(columns).cast(schema)}


def _nominal_tip(tree: Tree, configurations: pa.Table, settings: Campaign) -> pa.Table:
    """Poses of the tip, as they would be measured without errors."""
    noise, poses = settings.noise, configurations.column("pose")
    if noise.displacement_mm is None or noise.rotation_rad is None:
        raise ValueError(
            "needs targets.csv with planned places of targets on links, or noise.displacement_mm and "
            "noise.rotation_rad for measured poses of the tip"
        )
    frames = tree.frames(joint_readings(tree, configurations))
    tip = cast("ChainMechanism", settings.mechanism).tip or tree.nodes[-1].link
    node = tree.links[tip]
    vectors = np.column_stack([frames.t[:, node] / _MM, log_so3(frames.R[:, node])])
    columns: dict[str, object] = {"pose": poses, "body": [tip] * len(poses)}
    columns |= {name: vectors[:, k] for k, name in enumerate((*_TRANSLATION, *_ROTATION))}
    sigma = np.array([noise.displacement_mm * _MM] * 3 + [noise.rotation_rad] * 3)
    columns |= {
        f"cov_{i}_{j}": np.full(len(poses), sigma[i] ** 2 if i == j else 0.0) for i in range(6) for j in range(i, 6)
    }
    schema = ARTIFACTS["measured_poses"].arrow_schema(_identifier(configurations))
    return pa.table({name: columns[name] for name in schema.names}).cast(schema)


def _nominal_distances(
    targets: Sequence[tuple[str, str]], points: NDArray, is_station: NDArray, poses: pa.ChunkedArray
) -> dict[str, Any]:
    """Columns of distances from every station to every target, with points (B, T, 3), m, in the frame of the base;
    raises ValueError without a target."""
    stations, on_links = np.flatnonzero(is_station), np.flatnonzero(~is_station)
    if not len(on_links):
        raise ValueError("needs targets.csv with a target on a link for its distances to the stations")
    a, b = (part.ravel() for part in np.meshgrid(stations, on_links, indexing="ij"))
    length = np.linalg.norm(points[:, a] - points[:, b], axis=-1)
    ends, starts = [targets[k] for k in b.tolist()], [targets[k] for k in a.tolist()]
    return {
        "pose": poses.take(np.repeat(np.arange(len(poses)), len(a))),
        "from_link": [None] * length.size,
        "from_end": [name for _, name in starts] * len(poses),
        "to_link": [link for link, _ in ends] * len(poses),
        "to_end": [name for _, name in ends] * len(poses),
        "reading_mm": length.ravel() / _MM,
    }


def _identifier(table: pa.Table) -> str:
    return "int64" if pa.types.is_integer(table.schema.field("pose").type) else "string"


@dataclass(frozen=True)
class ChainPlan(ModelPlan):
    """Layout of a campaign of a chain, and the tables that a simulated campaign of this layout fills.

    ``epochs``: fitted poses and those held out, each with the covariance of its channels; ``scene``: input for
    candidate causes, as in the diagnosis.
    """

    model: ChainModel
    epochs: tuple[Epochs[ChainConditions], ...]
    tables: Mapping[str, pa.Table]
    scene: Scene[ChainCause]

    def drawn(self, effects: Sequence[Effect[ChainCause]], rng: np.random.Generator) -> dict[str, pa.Table]:
        """The tables of a campaign drawn anew with effects hidden in it: true chain within tolerances, and noise.

        All but the effects is drawn independently of the effects. Unknowns without prior knowledge stay nominal.
        """
        plain = self.model.with_causes(())
        hidden = plain.with_causes([effect.cause for effect in effects])
        known = plain.predict(np.zeros(plain.shared_size), np.zeros((len(plain.conditions.readings), plain.local_size)))
        drawn = rng.standard_normal(plain.shared_size)
        shared = plain.embedded(np.where(known.shared_known, drawn, 0.0), hidden)
        hidden.set_effects(shared, effects)
        tables = dict(self.tables)
        parts = [self._measured(hidden.at(epoch.conditions), epoch, shared, rng) for epoch in self.epochs]
        poses = [pose for epoch in self.epochs for pose in epoch.conditions.poses]
        values, turned, lengths = (np.concatenate(part) for part in zip(*parts, strict=True))
        if "observations" in tables and tables["observations"].num_rows:
            tables["observations"] = self._points(tables["observations"], tuple(poses), values)
        if "measured_poses" in tables and tables["measured_poses"].num_rows:
            tables["measured_poses"] = self._poses(tables["measured_poses"], tuple(poses), values, turned)
        if "distances" in tables and tables["distances"].num_rows:
            tables["distances"] = self._distances(tables["distances"], tuple(poses), lengths)
        return tables

    def _measured(
        self, model: ChainModel, epochs: Epochs[ChainConditions], shared: NDArray, rng: np.random.Generator
    ) -> tuple[Array, Array, Array]:
        """Places (B, K, 3), m, in the frames of the measurement, orientations (B, K, 3, 3), and distances (B, D), m."""
        count = len(epochs.conditions.readings)
        exact = model.points(shared, rng.standard_normal((count, model.local_size)))
        moved = np.einsum("bij,bkj->bki", epochs.frames.R, exact) + epochs.frames.t[:, None]
        noise = (np.linalg.cholesky(epochs.measured.covariance) @ rng.standard_normal((*exact.shape, 1)))[..., 0]
        wrong = rng.random(exact.shape[:2]) < self.gross
        values = moved + noise + rng.normal(0.0, _GROSS_M, exact.shape) * wrong[..., None]
        local, lengths = exact + noise, np.zeros((count, 0))
        if isinstance(model, DistanceModel):
            size = len(model.coordinates)
            lengths = values[:, size:, 0]
            values, local = (part[:, :size].reshape(count, -1, 3) for part in (values, local))
        channels = slice(0, values.shape[1])
        if (coupling := epochs.conditions.coupling) is not None:
            values[:, :-1] += np.einsum("bkij,bkj->bki", coupling[:, channels][:, :-1], local[:, 1:])
        # An orientation counts from the recorded one; its noise is a rotation in the frame of the measurement.
        turned = exp_so3(local) @ epochs.conditions.reference[:, channels]
        return np.asarray(values), np.asarray(turned), np.asarray(lengths)

    def _distances(self, table: pa.Table, poses: tuple[int | str, ...], lengths: NDArray) -> pa.Table:
        assert isinstance(self.model, DistanceModel)
        keys = list(zip(self.model.channels.links, self.model.channels.names, strict=True))
        index_of = {(keys[a], keys[b]): d for d, (a, b) in enumerate(self.model.ends)}
        ends = [
            [(link or GROUND, name) for link, name in zip(*distances, strict=True)]
            for distances in (
                [table.column(f"{end}_{what}").to_pylist() for what in ("link", "end")] for end in ("from", "to")
            )
        ]
        pose, line = (
            positions(table.column("pose"), poses),
            np.array([index_of[pair] for pair in zip(*ends, strict=True)]),
        )
        is_known = pose >= 0
        return _with_columns(table.filter(is_known), {"reading_mm": lengths[pose[is_known], line[is_known]] / _MM})

    def _points(self, table: pa.Table, poses: tuple[int | str, ...], values: NDArray) -> pa.Table:
        names, links = self.model.channels.names, self.model.channels.links
        index_of = {key: k for k, key in enumerate(zip(links, names, strict=True)) if not self._is_rotation[k]}
        pose = positions(table.column("pose"), poses)
        pairs = zip(table.column("body").to_pylist(), table.column("target").to_pylist(), strict=True)
        channel = np.array([index_of.get(pair, -1) for pair in pairs], int)
        is_known = (pose >= 0) & (channel >= 0)
        values_mm = values[pose[is_known], channel[is_known]] / _MM
        return _with_columns(table.filter(is_known), {f"{axis}_mm": values_mm[:, k] for k, axis in enumerate("xyz")})

    def _poses(self, table: pa.Table, poses: tuple[int | str, ...], values: NDArray, turned: NDArray) -> pa.Table:
        links, names = self.model.channels.links, self.model.channels.names
        channels = [k for k, name in enumerate(names) if name in ("position", "orientation")]
        channel_of = {(links[k], names[k]): k for k in channels}
        bodies, pose = table.column("body").to_pylist(), positions(table.column("pose"), poses)
        is_known = pose >= 0
        at = [
            [channel_of[body, name] for body in np.array(bodies, object)[is_known]]
            for name in ("position", "orientation")
        ]
        shifts, turns = values[pose[is_known], at[0]] / _MM, log_so3(turned[pose[is_known], at[1]])
        columns = {name: shifts[:, k] for k, name in enumerate(_TRANSLATION)}
        columns |= {name: turns[:, k] for k, name in enumerate(_ROTATION)}
        # Recorded angles are those of the measurement, not of what is drawn here.
        drawn = table.drop_columns([name for name in RECORDED_ANGLES if name in table.schema.names])
        return _with_columns(drawn.filter(is_known), columns)

    @property
    def _is_rotation(self) -> NDArray:
        return self.model.channels.is_rotation


def _with_columns(table: pa.Table, columns: Mapping[str, NDArray]) -> pa.Table:
    for name, values in columns.items():
        index = table.schema.get_field_index(name)
        table = table.set_column(index, table.schema.field(index), pa.array(values))
    return table


def chain_plan(
    tables: Mapping[str, pa.Table], model: ChainModel, epochs: Sequence[Epochs[ChainConditions]]
) -> ChainPlan:
    """The plan of a campaign of a chain, as the diagnosis assembled it."""
    tables_kept = {
        name: tables[name]
        for name in ("observations", "measured_poses", "distances", "survey", "configurations", "joints")
        if name in tables
    }
    return ChainPlan(model, tuple(epochs), tables_kept, model.scene)
