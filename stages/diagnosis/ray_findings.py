"""Diagnosis of cameras, scale bars and air from rays, and its effect on the points computed from them.

Found effects are removed from the points before the points are diagnosed. Uncertain parameters common to all poses
(cameras, lengths of bars) remain nuisance parameters of the points, with their covariance from the rays.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import TableRow
from truing.estimation.bundle.shared_errors import MOST_PATTERNS, independent_errors
from truing.estimation.bundle.shared_errors import with_shared_errors as points_with_shared_errors
from truing.inference.detectable import assessed
from truing.report.numbers import count_text, two_decimals
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.bodies.model import BodyModel
from truing.simulation.mechanisms.model import MechanismModel
from truing.simulation.mechanisms.point_causes import Photographed
from truing.simulation.photographs.model import RayModel
from truing.simulation.photographs.ray_poses import BAR
from truing.stages.common.point_arrays import number_column
from truing.stages.common.point_errors import point_errors
from truing.stages.common.ray_statistics import effects_on_points
from truing.stages.diagnosis.cause_tables import adequacy_table, detectable_table, detectable_words, uncertainty_table
from truing.stages.diagnosis.diagnosis_data import DiagnosisData
from truing.stages.diagnosis.ray_points import assemble_rays, scale_height
from truing.stages.diagnosis.rows import DetectionAdvice, diagnosis_table, ranked_table
from truing.stages.diagnosis.search import decided_of_rays, rule_of_rays

if TYPE_CHECKING:
    from truing.inference.observations import Epochs
    from truing.inference.selection import CauseDiagnosis, Settings
    from truing.schemas.campaign import Campaign
    from truing.stages.declaration import Progress

Array = NDArray[np.floating]
Recorded = MechanismModel | BodyModel

_SI = 1e-3
_UM = 1e6
_ORDER = ("found", "suspected", "indistinguishable", "rejected", "not testable")
_LOST = ("rejected", "not testable")


@dataclass(frozen=True)
class RayFindings:
    """The diagnosis of rays, the compared quantities, and by point (pose, name): how far it was found from where it is
    (N, 3), m; and how it follows the errors that all poses share (N, 3, Q), m per standard deviation."""

    diagnosis: CauseDiagnosis
    data: DiagnosisData[RayModel]
    points: Mapping[tuple[object, str], int]
    off: Array
    common: Array
    bars: tuple[str, ...]
    moves: Mapping[str, Array]  # by the key of what was found: how far it moved each point (N, 3), m

    @property
    def found(self) -> bool:
        """True if rays show a cause."""
        return bool(self.moves)

    @property
    def read(self) -> str:
        """Description of the rays that were read."""
        return f"rays of {count_text(len(self.data.calibration.conditions.poses), 'pose')}"

    @property
    def left_out(self) -> str:
        """Number of gross errors left out of the ray statements, in words."""
        gross = len(self.diagnosis.screened)
        return f"{gross} statements of rays as gross errors" if gross else ""


def ray_findings(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> RayFindings:
    """Search the rays for causes, and compute their effects on the points."""
    dataset, all_poses = assemble_rays(tables, settings)
    diagnosis = decided_of_rays(dataset, settings, progress)
    keys, effects = effects_on_points(tables["ray_effects"], all_poses.parameters)
    points = {key: row for row, key in enumerate(keys)}
    pose = np.array([all_poses.poses.index(key[0]) for key in keys], int)
    final, scale = diagnosis.final, np.array([number.scale for number in all_poses.parameters])
    assert isinstance(final.model, RayModel)
    model = final.model.at(all_poses)
    off = np.zeros((len(keys), 3))
    moves: dict[str, Array] = {}
    for effect in model.effects(final.fit.shared):
        motion = effect.cause.moved(all_poses, effect.values) / scale
        moves[effect.cause.key] = -np.einsum("nat,nt->na", effects, motion[pose])
    if moves:
        off = -np.einsum("nat,nt->na", effects, (model.offsets(final.fit.shared) / scale)[pose])
    by_shared = effects @ (model.by_shared(final.fit.shared) @ _root(final.covariance()))[pose]
    return RayFindings(diagnosis, dataset, points, off, independent_errors(by_shared), all_poses.owners(BAR), moves)


def _root(covariance: Array) -> Array:
    """A matrix whose product with its transpose is the covariance, some of which may be none."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def corrected(tables: Mapping[str, pa.Table], rays: RayFindings) -> dict[str, pa.Table]:
    """Tables with points corrected for the findings of rays."""
    if not rays.found or "observations" not in tables:
        return dict(tables)
    table = tables["observations"]
    row = np.array([rays.points.get(key, -1) for key in _keys(table)], int)
    off = np.where(row[:, None] >= 0, rays.off[row], 0.0)
    for axis, name in enumerate(("x_mm", "y_mm", "z_mm")):
        moved = number_column(table, name) - off[:, axis] / _SI
        place = table.schema.get_field_index(name)
        table = table.set_column(place, table.schema.field(place), [moved])
    return {**tables, "observations": table}


def with_shared_errors(
    dataset: DiagnosisData[Recorded], tables: Mapping[str, pa.Table], rays: RayFindings
) -> DiagnosisData[Recorded]:
    """Return the points data with the errors common to all poses, and to the points of one pose, as unknowns instead of
    noise."""
    table = tables["observations"]
    keys = _keys(table)
    bodies, targets = (table.column(name).to_pylist() for name in ("body", "target"))
    row = {
        (key[0], *name): n for n, (key, name) in enumerate(zip(keys, zip(bodies, targets, strict=True), strict=True))
    }
    place = np.array([rays.points.get(key, -1) for key in keys], int)
    common = np.where((place >= 0)[:, None, None], rays.common[place], 0.0)
    errors = point_errors(table, tables.get("point_correlations"), None)
    photographed = Photographed(rays.common.shape[-1], 0 if errors is None else MOST_PATTERNS, rays.bars)
    names = list(zip(dataset.model.targets.bodies, dataset.model.targets.names, strict=True))

    def with_errors(poses: Epochs | None) -> Epochs | None:
        if poses is None:
            return None
        rows = np.array([[row.get((pose, *name), -1) for name in names] for pose in poses.conditions.poses], int)
        return points_with_shared_errors(poses, np.where(poses.measured.is_observed, rows, -1), common, errors)

    calibration = with_errors(dataset.calibration)
    assert calibration is not None
    photographed = replace(photographed, scale_height_m=scale_height(tables, calibration))
    model = replace(dataset.model.at(calibration.conditions), photographed=photographed)
    return replace(dataset, model=model, calibration=calibration, held_out=with_errors(dataset.held_out))


def _keys(table: pa.Table) -> list[tuple[object, str]]:
    """The pose and the name of every point, which is body/target where it has none of its own."""
    poses, bodies, targets = (table.column(name).to_pylist() for name in ("pose", "body", "target"))
    names = [f"{body}/{target}" for body, target in zip(bodies, targets, strict=True)]
    if "point" in table.column_names:
        points = table.column("point").to_pylist()
        names = [point or name for point, name in zip(points, names, strict=True)]
    return list(zip(poses, names, strict=True))


def with_rays(artifacts: Mapping[str, object], rays: RayFindings, rule: Settings) -> dict[str, object]:
    """Artifacts of a diagnosis of points, after the results of rays; ``rule``: that of the whole campaign."""
    own_rule, result = rule_of_rays(rule), dict(artifacts)
    level, search = own_rule.level, rays.diagnosis.search
    diagnosis = replace(rays.diagnosis, verdicts=assessed(rays.diagnosis.verdicts, search, level))
    sizes = detectable_words(search, level, [verdict.cause for verdict in diagnosis.verdicts], 0)
    words = DetectionAdvice(sizes, shown=rays.data.shown, relation=rays.data.relation)
    rows = diagnosis_table(diagnosis, words, own_rule.noise_level).to_pylist()
    of_causes = [row for row in rows if "noise_ratio" not in json.loads(row["parameters"])]
    for row, verdict in zip(of_causes, diagnosis.verdicts, strict=True):
        if verdict.cause.key in rays.moves and row["verdict"] in ("found", "suspected"):
            row["explanation"] += _on_points(rays.moves[verdict.cause.key])
    result["diagnosis"] = _ranked(rows, result["diagnosis"])
    for name, table in (
        ("detectable", detectable_table(diagnosis.search, level, 0)),
        ("adequacy", adequacy_table(diagnosis, own_rule, rays.data.shown.what)),
        ("cause_uncertainty", uncertainty_table(diagnosis, 0)),
    ):
        result[name] = _concatenated_table(name, [result[name], table] if name in result else [table])
    return result


def _ranked(rays: list[TableRow], points: pa.Table) -> pa.Table:
    """All rows in the order of their verdicts, those of rays first; a finding of either is rejected by neither."""
    rows = [*rays, *points.to_pylist()]
    reported = {row["cause"] for row in rows if row["verdict"] not in _LOST}
    ranked_rows: list[TableRow] = []
    for verdict in _ORDER:
        of_verdict = [row for row in rows if row["verdict"] == verdict]
        if verdict in _LOST:
            of_verdict.sort(key=lambda row: -(row["probability"] or 0.0))
            once = {row["cause"]: row for row in reversed(of_verdict) if row["cause"] not in reported}
            of_verdict = [row for row in of_verdict if once.get(row["cause"]) is row]
            reported |= once.keys()
        ranked_rows += of_verdict
    return ranked_table(ranked_rows)


def _on_points(moved: NDArray) -> str:
    """Shift of points by an effect found in the rays."""
    size = np.linalg.norm(moved, axis=-1) * _UM
    return (
        f" It moved object points by up to {two_decimals(float(size.max(initial=0.0)))} um against each other, "
        f"{two_decimals(float(np.sqrt(np.mean(size**2))))} um rms; that is taken off before anything is looked for in "
        "them."
    )


def _concatenated_table(name: str, tables: list[pa.Table]) -> pa.Table:
    joined, artifact = pa.concat_tables(tables, promote_options="default"), ARTIFACTS[name]
    schema = artifact.arrow_schema(present=tuple(c for c in joined.column_names if c not in artifact.columns))
    return joined.select(schema.names).cast(schema)
