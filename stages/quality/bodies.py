"""Each body as the quality checks see it: its points over time, a first robust fit, and what that leaves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from schemas.columns import COLUMNS
from stages.common.point_arrays import number_column, pose_ids, pose_points, survey_points
from truing.belonging.counted_times import merely_counts
from truing.estimation.response import keep_consistent
from truing.estimation.rigid_poses.points import PosePoints, SurveyPoints
from truing.estimation.rigid_poses.rigid import RigidFit
from truing.estimation.rigid_poses.robust import consensus
from truing.estimation.rigid_poses.umeyama import umeyama

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LEAST_TARGETS = 3
_POSES_TO_COMPARE = 2


@dataclass(frozen=True)
class Surroundings:
    """The poses in the order of time, with what may drive the bodies.

    poses (B ids); time (B,) in s; settings (B, D) actuator or drive readings in the units of the table,
    without columns that do not vary; temperature (B,) in degrees C or None; names of the settings; unobserved:
    poses of the configurations without any point; shared: points came out of networks of rays, whose errors they
    share in part; is_counted: times merely number the poses.
    """

    poses: tuple[int | str, ...]
    time: Array
    settings: Array
    names: tuple[str, ...]
    temperature: Array | None
    unobserved: tuple[int | str, ...] = ()
    shared: bool = False
    is_counted: bool = False

    @property
    def covariates(self) -> Array:
        """(B, C) settings, temperature and time, each scaled to unit spread; as many as a third of the poses
        allow."""
        columns = [*self.settings.T, *(() if self.temperature is None else (self.temperature,)), self.time]
        spread = [(c - np.nanmean(c)) / np.nanstd(c) for c in columns if np.nanstd(c) > 0.0]
        kept = spread[: max(0, len(self.poses) // 3)]
        return np.nan_to_num(np.column_stack(kept)) if kept else np.zeros((len(self.poses), 0))


@dataclass(frozen=True)
class BodyView:
    """One body: its survey (or first shape), its points, the robust fit of its frame, and the residuals in
    that frame.

    residuals (B, T, 3) in m, zero where not seen; sigma (B, T, 3) declared, of measurement and survey
    together; frame (T,) which targets make the frame; gross (B, T) seen, but far from its place; is_surveyed: places
    come from a survey, not from one of the poses.
    """

    name: str
    survey: SurveyPoints
    points: PosePoints
    fit: RigidFit
    residuals: Array
    sigma: Array
    frame: Mask
    gross: Mask
    is_surveyed: bool = True

    @property
    def measured_sigma(self) -> Array:
        """(B, T, 3) declared standard deviation of the measurement alone, in m."""
        return np.sqrt(np.einsum("btii->bti", self.points.cov))

    @property
    def framed(self) -> Mask:
        """(B,) whether enough targets of the frame were seen to say where the body is."""
        return np.asarray((self.points.seen & self.frame).sum(axis=1) >= _LEAST_TARGETS)

    @property
    def why_no_places(self) -> str:
        """Why nothing tells whether targets are in their places; empty where something does."""
        if not self.framed.any():
            return f"{self.name}: no pose shows three targets, and fewer give no frame"
        if not self.is_surveyed and self.framed.sum() < _POSES_TO_COMPARE:
            return f"{self.name}: one pose without a survey has nothing to be compared with"
        return ""

    @property
    def good(self) -> Mask:
        """(B, T) seen, in its place, in a pose whose fit stands."""
        return self.points.seen & ~self.gross & self.fit.ok[:, None]


def surroundings(observations: pa.Table, configurations: pa.Table | None, drives: tuple[str, ...]) -> Surroundings:
    """The poses that were observed, ordered by time where the campaign tells it, else as they came."""
    observed, shared = pose_ids(observations), "point" in observations.column_names
    if configurations is None:
        none = np.zeros((len(observed), 0))
        return Surroundings(observed, np.arange(float(len(observed))), none, (), None, shared=shared, is_counted=True)
    time = number_column(configurations, "time_s")
    order = np.argsort(time, kind="stable")
    ids = configurations.column("pose").to_pylist()
    seen = set(observed)
    rows = np.array([i for i in order if ids[i] in seen], dtype=np.int64)
    names = [n for n in configurations.schema.names if COLUMNS["rho"].matches(n) or n in drives]
    values = {n: number_column(configurations, n)[rows] for n in names}
    varying = tuple(n for n in names if np.nanstd(values[n]) > 0.0)
    has_temperature = "temperature_c" in configurations.schema.names
    return Surroundings(
        tuple(ids[i] for i in rows),
        time[rows],
        np.column_stack([values[n] for n in varying]) if varying else np.zeros((len(rows), 0)),
        varying,
        number_column(configurations, "temperature_c")[rows] if has_temperature else None,
        tuple(pose for pose in ids if pose not in seen),
        shared,
        merely_counts(time[order], np.arange(len(order)), np.zeros(len(order), dtype=np.int64)),
    )


def body_views(tables: Mapping[str, pa.Table], around: Surroundings) -> list[BodyView]:
    """Every body of the observations, fitted robustly pose by pose."""
    observations, survey = tables["observations"], tables.get("survey")
    bodies = dict.fromkeys(observations.column("body").to_pylist())
    return [_view(observations, survey, body, around) for body in bodies]


def _view(observations: pa.Table, survey: pa.Table | None, body: str, around: Surroundings) -> BodyView:
    place = survey_points(survey, body) if survey is not None else None
    is_surveyed = place is not None and bool(place.targets)
    if place is None or not is_surveyed:
        place = _first_shape(pose_points(observations, body, around.poses))
    points = pose_points(observations, body, around.poses, place.targets)
    frame = place.leg == 0
    if frame.sum() < 3:
        frame = np.ones_like(frame)
    sigma = np.sqrt(np.einsum("btii->bti", points.cov) + np.einsum("tii->ti", place.cov)[None])
    usable = points.seen & frame
    mean_sigma = np.where(points.seen, np.sqrt((sigma**2).mean(axis=2)), 1.0)
    source = np.broadcast_to(place.points, points.points.shape)
    inlier, _ = consensus(source, points.points, usable, mean_sigma)
    fit = umeyama(source, points.points, (usable & inlier) / mean_sigma**2, sigma=mean_sigma)
    residuals = np.where((points.seen & fit.ok[:, None])[..., None], fit.residuals(source, points.points), 0.0)
    gross = usable & ~inlier
    gross |= _gross_attachments(residuals, sigma, points.seen & ~frame & fit.ok[:, None], around.covariates)
    return BodyView(body, place, points, fit, np.nan_to_num(residuals), sigma, frame, gross, is_surveyed)


def _first_shape(points: PosePoints) -> SurveyPoints:
    """Without a survey, the pose that shows most targets stands in for it; its noise counts as the survey's."""
    richest = int(points.seen.sum(axis=1).argmax())
    seen = points.seen[richest]
    names = tuple(t for t, s in zip(points.targets, seen, strict=True) if s)
    count = len(names)
    return SurveyPoints(names, points.points[richest, seen], points.cov[richest, seen], np.zeros(count, np.int64))


def _gross_attachments(residuals: Array, sigma: Array, seen: Mask, covariates: Array) -> Mask:
    """Attachments may follow the actuators; gross is what is far from its own regression on them."""
    gross = np.zeros(seen.shape, bool)
    for target in np.nonzero(seen.any(axis=0))[0]:
        rows = seen[:, target]
        if rows.sum() < covariates.shape[1] + 4:
            continue
        cov = sigma[rows, target][:, :, None] ** 2 * np.eye(3)
        kept = keep_consistent(covariates[rows], residuals[rows, target], 9.0 * cov)
        gross[rows, target] = ~kept.all(axis=1)
    return gross
