"""Each body as the quality checks see it: its points over time, a first robust fit, and what that leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.response import keep_consistent
from truing.estimation.rigid_poses.points import PosePoints, SurveyPoints
from truing.estimation.rigid_poses.rigid import RigidFit
from truing.estimation.rigid_poses.robust import consensus
from truing.estimation.rigid_poses.umeyama import umeyama

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


def first_shape(points: PosePoints) -> SurveyPoints:
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


def body_view(
    body: str, place: SurveyPoints, points: PosePoints, around: Surroundings, *, is_surveyed: bool
) -> BodyView:
    """Return a body fitted robustly pose by pose to its survey, or to its first shape."""
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
