"""Plans of simulated campaigns: points, bench or rays, with tables filled by simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import Array, Index
from truing.estimation.interferometry.recorded_steps import CHANNELS, READING_SI, RecordedSteps
from truing.estimation.rigid_poses.points import with_declared_noise
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.cause import Effect, Scene
from truing.simulation.drawn_campaigns import CampaignLayout, draw_campaign, draw_readings
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.model import MechanismModel, PriorKnowledge
from truing.simulation.mechanisms.recording import Conditions
from truing.simulation.photographs.causes.ray_causes import RayCause
from truing.simulation.photographs.ray_poses import RayPoses
from truing.simulation.targets import BASE, LEG, PLATFORM, Targets, shape_unknowns
from truing.stages.common.nominal_mechanism import facing, nominal_legs
from truing.stages.common.point_arrays import default_rotations, pose_ids, pose_points, positions, survey_points
from truing.stages.common.pose_conditions import pose_conditions
from truing.stages.common.reading_arrays import load_steps
from truing.stages.simulated_campaigns.plan_base import ModelPlan

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import LeggedMechanism
    from truing.simulation.bench.model import BenchModel

_FEWEST_POSES = 3
_VOLT_MV = 1e3
NEEDS = ("ray_statistics", "ray_information", "ray_effects", "configurations", "poses")


@dataclass(frozen=True)
class _Bodies:
    """Targets of all bodies in sequence: survey and its covariance, covariance of points, mask of observed targets."""

    targets: Targets
    shape: NDArray  # (K, 3) m
    shape_cov: NDArray  # (K, 3, 3) m^2
    cov: NDArray  # (B, K, 3, 3) m^2
    is_observed: NDArray  # (B, K)

    def subset(self, used: NDArray) -> _Bodies:
        """Some of the targets."""
        names, bodies = (
            tuple(name for name, keep in zip(listed, used, strict=True) if keep)
            for listed in (self.targets.names, self.targets.bodies)
        )
        targets = Targets(self.targets.body[used], self.targets.leg[used], names, bodies)
        return _Bodies(targets, self.shape[used], self.shape_cov[used], self.cov[:, used], self.is_observed[:, used])


@dataclass(frozen=True)
class CampaignPlan:
    """Layout of a campaign, and the tables that a simulated campaign of this layout fills.

    ``poses`` (B): poses in use; ``was_measured``: whether the campaign has points; ``scene``: input for candidate
    causes, as in the diagnosis.
    """

    layout: CampaignLayout
    observations: pa.Table
    survey: pa.Table
    configurations: pa.Table
    poses: tuple[int | str, ...]
    was_measured: bool
    scene: Scene

    through: tuple[str, ...] = ("pose",)  # stages between what is drawn and the diagnosis

    @property
    def part_count(self) -> int:
        """Number of parts that parameters are numbered by: legs or bodies."""
        return self.layout.model.part_count

    def with_gross(self, share: float) -> CampaignPlan:
        """The plan with a share of the points grossly wrong."""
        return replace(self, layout=replace(self.layout, gross=share))

    def drawn(self, effects: Sequence[Effect], rng: np.random.Generator) -> dict[str, pa.Table]:
        """The tables of a campaign drawn anew with effects hidden in it; raises ValueError where it cannot be."""
        points = draw_campaign(self.layout, effects, rng)
        targets = self.layout.model.targets
        pose = positions(self.observations.column("pose"), self.poses)
        index = _target_indices(self.observations, targets)
        is_known = (pose >= 0) & (index >= 0)
        target_index = _target_indices(self.survey, targets)
        surveyed = self.survey.filter(target_index >= 0)
        return {
            "observations": _with_points(
                self.observations.filter(is_known), points.points[pose[is_known], index[is_known]]
            ),
            "survey": _with_points(surveyed, points.survey[target_index[target_index >= 0]]),
            "configurations": self.configurations,
        }


def bare_plan(tables: Mapping[str, pa.Table], settings: Campaign) -> CampaignPlan:
    """Return the plan of an exact nominal mechanism; without observations all targets are visible in all poses.

    Raises ValueError with the reason if the tables are insufficient.
    """
    legs = nominal_legs(cast("LeggedMechanism", settings.mechanism))
    legs = facing(legs, tables["poses"]) if "poses" in tables else legs
    conditions = _with_readings(tables["configurations"], legs.count, settings)
    noise = (settings.noise.point_mm or 0.0) * 1e-3
    measured = "observations" in tables and tables["observations"].num_rows > 0
    seen = tables["observations"] if measured else _all_visible(tables["survey"], tables["configurations"], noise)
    bodies = _bodies(tables["survey"], seen, conditions.poses, legs.count, noise)
    if not np.any(bodies.targets.body == BASE) or not np.any(bodies.targets.body == PLATFORM):
        raise ValueError("needs surveyed targets on base and platform")
    model, bodies = _nominal_model(legs, bodies, conditions, settings.noise.actuator_mm * 1e-3)
    layout = CampaignLayout(model, bodies.cov, bodies.is_observed)
    thin = seen.take(np.arange(seen.num_rows))  # without the larger buffers that it was read from
    return CampaignPlan(
        layout, thin, tables["survey"], tables["configurations"], conditions.poses, measured, model.scene
    )


def _with_readings(configurations: pa.Table, legs: int, settings: Campaign) -> Conditions:
    """Return the conditions of all poses with known readings."""
    conditions = pose_conditions(configurations, pose_ids(configurations), legs, settings.noise.actuator_mm * 1e-3)
    rows = np.flatnonzero(np.isfinite(conditions.readings).all(1))
    if len(rows) < _FEWEST_POSES:
        raise ValueError(f"needs at least {_FEWEST_POSES} poses with readings, found {len(rows)}")
    covariates = {name: values[rows] for name, values in conditions.covariates.items()}
    poses = tuple(conditions.poses[row] for row in rows)
    return replace(conditions, readings=conditions.readings[rows], covariates=covariates, poses=poses)


def _nominal_model(
    legs: Legs, bodies: _Bodies, conditions: Conditions, reading_sigma: float
) -> tuple[MechanismModel, _Bodies]:
    """Return the model of an exact mechanism, and the bodies whose targets it can position: a leg needs three."""
    on_leg = bodies.targets.body == LEG
    ridden = [
        leg for leg in range(legs.count) if legs.closure.one_body and sum(on_leg & (bodies.targets.leg == leg)) >= 3
    ]
    bodies = bodies.subset(~on_leg | np.isin(bodies.targets.leg, ridden))
    unmoved, at_origin = np.tile(np.eye(3), (legs.count, 1, 1)), np.zeros((legs.count, 3))
    survey = shape_unknowns(bodies.targets, bodies.shape, bodies.shape_cov)
    known = PriorKnowledge({}, bodies.shape, survey, reading_sigma, np.array(ridden, int), unmoved, at_origin)
    return MechanismModel(bodies.targets, conditions, legs, known), bodies


def full_plan(bare: CampaignPlan, model: MechanismModel, is_observed: NDArray, poses_table: pa.Table) -> CampaignPlan:
    """Return the plan with the prior knowledge of the diagnosis: tolerances, and positions of targets on legs.

    ``model``: plain simulation; ``is_observed`` (B, K): observed targets in fitted poses.
    """
    known = {name: k for k, name in enumerate(_body_target_pairs(bare.layout.model.targets))}
    order = [known[name] for name in _body_target_pairs(model.targets)]
    layout = CampaignLayout(
        model.at(bare.layout.model.conditions),
        bare.layout.covariance[:, order],
        bare.layout.is_observed[:, order],
        default_rotations(poses_table, "base", bare.poses) if bare.was_measured else None,
    )
    scene = replace(model.scene, is_observed=is_observed)
    return replace(bare, layout=layout, scene=scene)


def _body_target_pairs(targets: Targets) -> list[tuple[str, str]]:
    return list(zip(targets.bodies, targets.names, strict=True))


def _all_visible(survey: pa.Table, configurations: pa.Table, noise: float) -> pa.Table:
    """Return a table with one row per pose and target, without coordinates."""
    poses, count = configurations.column("pose"), survey.num_rows
    pose = np.repeat(np.arange(len(poses)), count)
    target = np.tile(np.arange(count), len(poses))
    columns = {"pose": poses.take(pose)}
    columns |= {name: survey.column(name).take(target) for name in ("body", "target")}
    columns |= {f"{axis}_mm": pa.array(np.zeros(len(pose))) for axis in "xyz"}
    columns |= {f"sigma_{axis}_mm": pa.array(np.full(len(pose), noise * 1e3)) for axis in "xyz"}
    identifier = "int64" if pa.types.is_integer(poses.type) else "string"
    return pa.table(columns).cast(ARTIFACTS["observations"].arrow_schema(identifier))


def _bodies(survey: pa.Table, observations: pa.Table, poses: tuple[int | str, ...], legs: int, noise: float) -> _Bodies:
    kinds = [("base", BASE, -1), ("platform", PLATFORM, -1), *((f"leg{i + 1}", LEG, i) for i in range(legs))]
    surveys = [(body, kind, ridden, survey_points(survey, body)) for body, kind, ridden in kinds]
    points_of_body = [
        pose_points(observations, body, poses, body_survey.targets) for body, _, _, body_survey in surveys
    ]
    legs_of = [
        body_survey.leg - 1 if kind == PLATFORM else np.full(len(body_survey.leg), ridden)
        for _, kind, ridden, body_survey in surveys
    ]
    targets = Targets(
        np.concatenate([np.full(len(body_survey.targets), kind) for _, kind, _, body_survey in surveys]),
        np.concatenate(legs_of),
        tuple(target for *_, body_survey in surveys for target in body_survey.targets),
        tuple(body for body, _, _, body_survey in surveys for _ in body_survey.targets),
    )
    return _Bodies(
        targets,
        np.concatenate([body_survey.points for *_, body_survey in surveys]),
        with_declared_noise(np.concatenate([body_survey.cov for *_, body_survey in surveys]), noise),
        with_declared_noise(np.concatenate([points.cov for points in points_of_body], 1), noise),
        np.concatenate([points.is_observed for points in points_of_body], 1),
    )


def _target_indices(table: pa.Table, targets: Targets) -> NDArray:
    """Return the index of each row's target in the layout; -1 if absent."""
    known = {name: k for k, name in enumerate(_body_target_pairs(targets))}
    rows = zip(table.column("body").to_pylist(), table.column("target").to_pylist(), strict=True)
    return np.array([known.get(name, -1) for name in rows], dtype=int)


def _with_points(table: pa.Table, points: NDArray) -> pa.Table:
    """The table with other coordinates, points (N, 3) in m."""
    for axis, values in zip("xyz", points.T, strict=True):
        index = table.schema.get_field_index(f"{axis}_mm")
        table = table.set_column(index, table.schema.field(index), pa.array(values * 1e3))
    return table


@dataclass(frozen=True)
class ReadingPlan(ModelPlan):
    """Layout of load steps, and the tables that a simulated campaign of this layout fills.

    ``scene``: input for candidate causes, as in the diagnosis.
    """

    model: BenchModel
    steps: RecordedSteps
    tables: Mapping[str, pa.Table]
    scene: Scene

    def drawn(self, effects: Sequence[Effect], rng: np.random.Generator) -> dict[str, pa.Table]:
        """The tables of a campaign drawn anew with effects hidden in it."""
        readings = draw_readings(self.model, effects, rng, self.gross)
        index_of = {key: row for row, key in enumerate(_keys(self.steps))}
        tables = dict(self.tables)
        if "readings" in tables:
            table = tables["readings"]
            rows = _rows(table, index_of)
            channel = np.array([CHANNELS.index(name) for name in table.column("channel").to_pylist()])
            tables["readings"] = _with_column(table, "reading", readings[rows, channel] / READING_SI[channel])
        if "signals" in tables:
            rows = _rows(tables["signals"], index_of)
            for number, name in enumerate(self.steps.signals):
                values = readings[rows, len(CHANNELS) + number] * _VOLT_MV
                tables["signals"] = _with_column(tables["signals"], f"{name}_mv", values)
        return tables


def reading_plan(tables: Mapping[str, pa.Table], model: BenchModel) -> ReadingPlan:
    """The plan of a loading campaign; model: its plain simulation at all load steps."""
    steps = load_steps(tables)
    tables_of_readings = {name: tables[name] for name in ("readings", "signals", "given_compliance") if name in tables}
    return ReadingPlan(model, steps, tables_of_readings, model.scene)


def _keys(steps: RecordedSteps) -> list[tuple[int | str, int]]:
    return [(steps.runs[run], int(step)) for run, step in zip(steps.run, steps.step, strict=True)]


def _rows(table: pa.Table, row_of: Mapping[tuple[int | str, int], int]) -> Index:
    keys = zip(table.column("run").to_pylist(), table.column("step").to_pylist(), strict=True)
    return np.array([row_of[key] for key in keys])


def _with_column(table: pa.Table, name: str, values: Array) -> pa.Table:
    index = table.schema.get_field_index(name)
    return table.set_column(index, table.schema.field(index), pa.array(values))


@dataclass(frozen=True)
class RayPlan:
    """Network of a run: ray parameters of cameras, scale bars and air, and the tables that a simulated campaign with
    the same network fills with other scores.

    Rays depend linearly on these parameters, with the derivatives at the run's adjustment. ``scene``: input for
    candidate causes, as in the diagnosis.
    """

    rays: RayPoses
    tables: Mapping[str, pa.Table]
    scene: Scene

    part_count = 0  # nothing is numbered by legs
    through: tuple[str, ...] = ()  # stages between what is drawn and the diagnosis

    def with_gross(self, share: float) -> RayPlan:
        """The plan as it is; raises ValueError for a share of wrong rays, which an adjustment leaves none of."""
        if share > 0:
            raise ValueError(
                "--gross: expected 0, because gross errors of rays are removed before the search for causes"
            )
        return self

    def drawn(self, effects: Sequence[Effect], rng: np.random.Generator) -> dict[str, pa.Table]:
        """The tables of a campaign drawn anew with effects hidden in it."""
        rays, scale = self.rays, np.array([number.scale for number in self.rays.parameters])
        known = np.array([number.sigma or 0.0 for number in rays.parameters])
        mean = np.array([number.mean for number in rays.parameters])
        off = np.tile(np.where(known > 0.0, mean + known * rng.standard_normal(len(known)), 0.0), (len(rays.poses), 1))
        for effect in effects:
            assert isinstance(effect.cause, RayCause)
            off = off + effect.cause.moved(rays, effect.values)
        value = np.einsum("bkt,bt->bk", rays.root, off / scale) + rng.standard_normal(rays.root.shape[:2])
        return {**self.tables, "ray_statistics": self._scored(np.einsum("bkt,bk->bt", rays.root, value))}

    def _scored(self, score: NDArray) -> pa.Table:
        table = self.tables["ray_statistics"]
        pose = positions(table.column("pose"), self.rays.poses)
        number = positions(table.column("shared_number"), tuple(parameter.called for parameter in self.rays.parameters))
        index = table.schema.get_field_index("score")
        return table.set_column(index, table.schema.field(index), pa.array(score[pose, number]))


def ray_plan(tables: Mapping[str, pa.Table], rays: RayPoses, scene: Scene) -> RayPlan:
    """The plan of a run's rays, as the diagnosis gathered them."""
    return RayPlan(rays, {name: tables[name] for name in NEEDS if name in tables}, scene)
