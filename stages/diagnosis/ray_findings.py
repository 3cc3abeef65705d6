"""What rays tell of cameras, bars and air, and what follows for the points that were computed from them.

What is found is taken off the points before anything is looked for in them; what is only uncertain of all poses
together (cameras, lengths of bars) stays a nuisance of theirs, with the covariance that the rays leave of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from truing.estimation.bundle.ray_statistics import shared_errors
from truing.estimation.rigid_poses.points import PointErrors
from truing.simulation.catalogue import catalogue_of_rays
from truing.simulation.mechanisms.point_causes import Photographed
from truing.simulation.photographs.model import RayModel
from truing.simulation.photographs.ray_poses import BAR
from truing.stages.common.point_arrays import number_column
from truing.stages.common.point_errors import point_errors
from truing.stages.common.ray_statistics import effects_on_points
from truing.stages.diagnosis.mechanism_points import Gathered
from truing.stages.diagnosis.ray_points import gather_rays
from truing.stages.diagnosis.scale_height import scale_height

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.inference.observations import Epochs
    from truing.inference.selection import Diagnosis, Settings
    from truing.schemas.campaign import Campaign
    from truing.stages.declaration import Progress

Array = NDArray[np.floating]

# Of the probability of any false finding in a campaign, what rays may take of it; the rest is left to points.
SHARE_OF_RAYS = 1.0 / 3.0
# Common errors that move points by less, rms, are none; m.
_LEAST_EFFECT = 1e-8
# What is left of a point's own covariance, at least, once errors common to all poses are taken off.
_LEAST_OWN = 0.05
# Patterns in which the points of a pose err together (its scale, ..), and points that can have any.
_MOST_PATTERNS, _FEWEST_POINTS = 6, 4
_SI = 1e-3


@dataclass(frozen=True)
class RayFindings:
    """The diagnosis of rays, what was compared, and by point (pose, name): how far it was found from where it is
    (N, 3), m, and how it follows the errors that all poses share (N, 3, Q), m per standard deviation."""

    diagnosis: Diagnosis
    gathered: Gathered
    points: Mapping[tuple[Any, str], int]
    off: Array
    common: Array
    bars: tuple[str, ...]
    moves: Mapping[str, Array]  # by the key of what was found: how far it moved each point (N, 3), m

    @property
    def found(self) -> bool:
        """Whether rays show anything."""
        return bool(self.moves)

    @property
    def left_out(self) -> str:
        """What was left out of the rays' statements, in words."""
        gross = len(self.diagnosis.screened)
        return f"{gross} statements of rays as gross errors" if gross else ""


def ray_findings(tables: Mapping[str, pa.Table], settings: Campaign, rule: Settings, progress: Progress) -> RayFindings:
    """Search what rays tell for causes, and say what they do to the points."""
    gathered, whole = gather_rays(tables, settings)
    diagnosis = searched(gathered, rule, progress)
    keys, effects = effects_on_points(tables["ray_effects"], whole.parameters)
    points = {key: row for row, key in enumerate(keys)}
    pose = np.array([whole.poses.index(key[0]) for key in keys], int)
    final, scale = diagnosis.final, np.array([number.scale for number in whole.parameters])
    assert isinstance(final.model, RayModel)
    model = final.model.at(whole)
    off = np.zeros((len(keys), 3))
    moves: dict[str, Array] = {}
    for effect in model.effects(final.fit.shared):
        own = effect.cause.moved(whole, effect.values) / scale
        moves[effect.cause.key] = -np.einsum("nat,nt->na", effects, own[pose])
    if moves:
        off = -np.einsum("nat,nt->na", effects, (model.offsets(final.fit.shared) / scale)[pose])
    by_shared = effects @ (model.by_shared(final.fit.shared) @ _root(final.covariance()))[pose]
    return RayFindings(diagnosis, gathered, points, off, _told(by_shared), whole.owners(BAR), moves)


def searched(gathered: Gathered, rule: Settings, progress: Progress) -> Diagnosis:
    """All that the search for causes of rays decides; ``rule`` is the whole campaign's."""
    from truing.inference.selection import Acceptance

    search = Acceptance(
        gathered.model,
        gathered.calibration,
        gathered.held_out,
        rule_of_rays(rule),
        lambda what: progress(0, 1, f"rays: {what}"),
    )
    return search.run(list(catalogue_of_rays().values()))


def rule_of_rays(rule: Settings) -> Settings:
    """How sure a finding of rays must be, by the rule of the whole campaign."""
    return replace(rule, false_alarm=SHARE_OF_RAYS * rule.false_alarm)


def _root(covariance: Array) -> Array:
    """A matrix whose product with its transpose is the covariance, some of which may be none."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _told(by_shared: Array) -> Array:
    """The independent combinations (N, 3, Q) of common errors that move points by enough to matter."""
    rows = by_shared.reshape(-1, by_shared.shape[-1])
    values, vectors = np.linalg.eigh(rows.T @ rows)
    kept = values > _LEAST_EFFECT**2 * max(len(rows), 1)
    return np.asarray(by_shared @ vectors[:, kept])


def corrected(tables: Mapping[str, pa.Table], rays: RayFindings) -> dict[str, pa.Table]:
    """The tables with points where they are, as far as the rays tell it."""
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


def with_shared_errors(gathered: Gathered, tables: Mapping[str, pa.Table], rays: RayFindings) -> Gathered:
    """What is compared of points, with the errors that all poses share, and those that the points of a pose do, among
    its unknowns and not in its noise."""
    table = tables["observations"]
    keys = _keys(table)
    bodies, targets = (table.column(name).to_pylist() for name in ("body", "target"))
    row = {
        (key[0], *name): n for n, (key, name) in enumerate(zip(keys, zip(bodies, targets, strict=True), strict=True))
    }
    place = np.array([rays.points.get(key, -1) for key in keys], int)
    common = np.where((place >= 0)[:, None, None], rays.common[place], 0.0)
    errors = point_errors(table, tables.get("point_correlations"), None)
    photographed = Photographed(rays.common.shape[-1], 0 if errors is None else _MOST_PATTERNS, rays.bars)
    names = list(zip(gathered.model.targets.bodies, gathered.model.targets.names, strict=True))

    def told(poses: Epochs | None) -> Epochs | None:
        if poses is None:
            return None
        rows = np.array([[row.get((pose, *name), -1) for name in names] for pose in poses.conditions.poses], int)
        return _with_errors(poses, np.where(poses.measured.seen, rows, -1), common, errors)

    calibration = told(gathered.calibration)
    assert calibration is not None
    photographed = replace(photographed, scale_height_m=scale_height(tables, calibration))
    model = replace(gathered.model.at(calibration.conditions), photographed=photographed)
    return replace(gathered, model=model, calibration=calibration, held_out=told(gathered.held_out))


def _with_errors(poses: Epochs, rows: NDArray[np.int64], common: Array, errors: PointErrors | None) -> Epochs:
    """Poses whose points, at rows (B, K) of the table, share errors: common (N, 3, Q) ones, and those of each pose."""
    measured, conditions = poses.measured, poses.conditions
    known = (rows >= 0)[..., None, None]
    shared = np.where(known, common[rows], 0.0)
    own = measured.covariance - shared @ np.swapaxes(shared, -1, -2)
    of_pose = None
    if errors is not None:
        of_pose = np.zeros((*rows.shape, 3, _MOST_PATTERNS))
        for pose, of_points in enumerate(rows):
            seen = np.flatnonzero(of_points >= 0)
            if len(seen) < _FEWEST_POINTS:
                continue
            by_common = shared[pose, seen].reshape(3 * len(seen), -1)
            covariance = errors.covariance(of_points[seen]) - by_common @ by_common.T
            found = shared_errors(covariance, measured.values[pose, seen], _MOST_PATTERNS)
            of_pose[pose, seen, :, : found.patterns.shape[-1]] = found.patterns
            own[pose, seen] = found.own
    turned = np.swapaxes(poses.frames.R, 1, 2)[:, None]
    return replace(
        poses,
        measured=replace(measured, covariance=_held(own, measured.covariance, measured.seen)),
        conditions=replace(
            conditions,
            common_errors=turned @ shared,
            pose_errors=None if of_pose is None else turned @ of_pose,
        ),
    )


def _held(own: Array, whole: Array, seen: NDArray[np.bool_]) -> Array:
    """Covariances (B, K, 3, 3) of points by themselves, no less than a share of the whole in any direction."""
    factor = np.linalg.cholesky(np.where(seen[..., None, None], whole, np.eye(3)))
    inverse = np.linalg.inv(factor)
    values, vectors = np.linalg.eigh(inverse @ own @ np.swapaxes(inverse, -1, -2))
    spread = factor @ vectors * np.sqrt(np.maximum(values, _LEAST_OWN))[..., None, :]
    return np.where(seen[..., None, None], spread @ np.swapaxes(spread, -1, -2), whole)


def _keys(table: pa.Table) -> list[tuple[Any, str]]:
    """The pose and the name of every point, which is body/target where it has none of its own."""
    poses, bodies, targets = (table.column(name).to_pylist() for name in ("pose", "body", "target"))
    names = [f"{body}/{target}" for body, target in zip(bodies, targets, strict=True)]
    if "point" in table.column_names:
        own = table.column("point").to_pylist()
        names = [point or name for point, name in zip(own, names, strict=True)]
    return list(zip(poses, names, strict=True))
