"""Strength of an effect in rays relative to the survey of the bodies, if rays alone cannot show it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tests.blind.generator.quaternions import Array, compose, from_vector, rotate
from tests.photographs.hidden import CameraEffect
from tests.photographs.lens import Lens, View
from tests.photographs.rays import Photographed
from tests.photographs.strength import (
    STEP_MM,
    STEP_RAD,
    RayMeasure,
    bar_rows,
    pixels,
    shift_of,
    stepped,
)


@dataclass(frozen=True)
class SurveyMeasure(RayMeasure):
    """The same campaign with bodies that are as their survey says, within its noise, and stand anywhere in every pose.

    Readings and the mechanism are left out: the strength is a lower bound of what a diagnosis has.
    """

    def strength(self, effect: CameraEffect) -> float:
        """Root of the non-centrality that the effect has in rays, bars and survey."""
        still = replace(self.shooting, sigma_px=0.0, missing_share=0.0, gross_share=0.0)
        plain, changed = (replace(self, shooting=still).photographed(own) for own in ((), (effect,)))
        fitted = [n for n, role in enumerate(plain.campaign.schedule.role) if role != "verification"]
        rows = np.concatenate([self._against_survey(plain, changed, pose) for pose in fitted])
        noise = self.shooting.layout.noise
        survey = np.full(3 * len(plain.campaign.marks.body), noise.survey_mm or noise.point_mm)
        lengths = np.array([bar.sigma_mm for bar in self.shooting.bars])
        prior = np.concatenate([np.zeros(rows.shape[1] - 1 - len(survey) - len(lengths)), 1 / survey, 1 / lengths])
        whole = np.concatenate([rows, np.column_stack([np.diag(prior), np.zeros(len(prior))])])
        shared, shift = whole[:, :-1], whole[:, -1]
        scale = np.maximum(np.linalg.norm(shared, axis=0), 1e-300)
        best = np.linalg.lstsq(shared / scale, shift, rcond=1e-12)[0]
        return float(np.linalg.norm(shift - shared / scale @ best))

    def _against_survey(self, plain: Photographed, changed: Photographed, pose: int) -> Array:
        """Rows of one pose, free of its stations, the poses of its bodies and the ends of bars: by lenses, by the
        survey and by bars' lengths, then the shift."""
        lenses, marks = plain.shooting.lenses, plain.campaign.marks
        station, point, shift = shift_of(plain, changed, pose)
        view, points = View(plain.views.turn[pose], plain.views.centre[pose]), plain.points[pose]

        def seen(view: View = view, points: Array = points, lenses: tuple[Lens, ...] = lenses) -> Array:
            return pixels(view, points, lenses)[station, point].ravel()

        here, rays = seen(), np.arange(2 * len(station))
        of_station, of_point = np.repeat(station, 2), np.repeat(point, 2)
        turned, by_point = np.zeros((len(rays), 6 * len(view.centre))), np.zeros((len(rays), 3 * len(points)))
        for k, axis in enumerate(np.eye(3)):
            spin = from_vector(np.broadcast_to(STEP_RAD * axis, view.centre.shape))
            turned[rays, 6 * of_station + k] = seen(view=replace(view, centre=view.centre + STEP_MM * axis)) - here
            turned[rays, 6 * of_station + 3 + k] = seen(view=replace(view, turn=compose(spin, view.turn))) - here
            by_point[rays, 3 * of_point + k] = (seen(points=points + STEP_MM * axis) - here) / STEP_MM
        bars = bar_rows(plain, points, 0, 3 * len(points) + len(plain.shooting.bars) + 1)
        sigma, count = self.shooting.sigma_px, 3 * len(marks.body)
        by_lens = np.stack([seen(lenses=own) - here for own in _each_stepped(lenses)], -1)
        none = np.zeros((len(rays), len(plain.shooting.bars)))
        moves = _motions(points, marks.body)
        survey = by_point[:, :count] @ _turned_axes(plain, pose)
        local = np.concatenate([turned, by_point @ moves, by_point[:, count:]], 1) / sigma
        left = np.column_stack([by_lens, survey, none, shift.ravel()]) / sigma
        of_bars = bars[:, : 3 * len(points)]
        width = left.shape[1]
        local = np.concatenate(
            [local, np.column_stack([np.zeros((len(bars), turned.shape[1])), of_bars @ moves, of_bars[:, count:]])]
        )
        left = np.concatenate([left, np.zeros((len(bars), width))])
        left[len(rays) :, width - 1 - len(bars) : -1] = bars[:, 3 * len(points) : -1]
        return _free_of(local, left)


def _each_stepped(lenses: tuple[Lens, ...]) -> list[tuple[Lens, ...]]:
    return [(*lenses[:n], own, *lenses[n + 1 :]) for n, lens in enumerate(lenses) for own in stepped(lens)]


def _motions(points: Array, bodies: Sequence[str]) -> Array:
    """Derivatives (3 M, 6 bodies) of all points by translation and rotation of every body; zero for ends of scale
    bars."""
    names = list(dict.fromkeys(bodies))
    found = np.zeros((len(points), 3, len(names), 6))
    for n, body in enumerate(bodies):
        arm = (points[n] - points[: len(bodies)].mean(0)) / 1e3
        found[n, :, names.index(body), :3] = np.eye(3)
        found[n, :, names.index(body), 3:] = np.cross(np.eye(3), arm).T
    return found.reshape(3 * len(points), -1)


def _turned_axes(plain: Photographed, pose: int) -> Array:
    """Derivatives (3 M, 3 M) of a pose's surveyed targets by the coordinates of the survey."""
    marks = plain.campaign.marks
    turn = from_vector(plain.campaign.truth.rotation_vector[pose])
    found = np.zeros((len(marks.body), 3, len(marks.body), 3))
    axes = rotate(np.broadcast_to(turn, (3, 4)), np.eye(3)).T
    for n, body in enumerate(marks.body):
        found[n, :, n] = axes if body == "platform" else np.eye(3)
    return found.reshape(3 * len(marks.body), -1)


def _free_of(local: Array, left: Array) -> Array:
    own = local / np.maximum(np.linalg.norm(local, axis=0), 1e-300)
    value, vectors = np.linalg.eigh(own.T @ own)
    kept = value > 1e-11 * value[-1]
    basis = own @ (vectors[:, kept] / np.sqrt(value[kept]))
    return np.asarray(left - basis @ (basis.T @ left))
