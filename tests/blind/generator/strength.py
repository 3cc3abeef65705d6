"""Strength of an effect in a campaign: root of its non-centrality after a fit of all unknowns.

What is not known: the geometry (to its tolerance), where the targets sit (to the survey's noise), where the legs'
survey frames sit and how far each leg has turned about itself, the measurement frame of every pose, and where the
actuators stand (to the readings' noise). All derivatives are differences of the generator's own chain; whatever is
held out counts for nothing, as in a fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tests.blind.generator.campaign import Campaign
from tests.blind.generator.hexapod import displacements
from tests.blind.generator.layout import Geometry
from tests.blind.generator.machine import BodyPoses, at_reference, exact_points, stand
from tests.blind.generator.quaternions import IDENTITY, Array, compose, from_vector, rotate, unit

STEP = 1e-3  # mm: far above rounding, far below any curvature; 1e-5 for what has no unit
FREE_MM, FREE_RAD = 10.0, 0.1  # prior of what nothing is known of
LEAST = 1e-9  # singular values below this share of the largest are none
LEVEL = 0.1  # how well the declared noise is known


@dataclass(frozen=True)
class Fit:
    """A fit of the plain machine to what was measured: N poses, R rows each, points before readings.

    ``weight`` (N, R) is one over the noise, 0 for what is not fitted; ``own`` (N, R, P) an orthonormal basis of what a
    pose's own unknowns take; ``shared`` (N R, S) what the common ones do, to the scale of their priors; ``inverse``
    (S, S) their covariance.
    """

    weight: Array
    own: Array
    shared: Array
    inverse: Array

    def overlap(self, changes: Sequence[Array]) -> Array:
        """Gram matrix (C, C) of the parts of changes (N, R) that a fit does not absorb, in units of noise."""
        seen = np.stack([change * self.weight for change in changes])
        seen = seen - np.einsum("nrp,nqp,cnq->cnr", self.own, self.own, seen, optimize=True)
        seen = seen.reshape(len(changes), -1)
        taken = seen @ self.shared
        return seen @ seen.T - taken @ self.inverse @ taken.T


def strength(fit: Fit, change: Array) -> float:
    """Root of the non-centrality of one change (N, R) of what is measured."""
    return float(np.sqrt(max(fit.overlap([change])[0, 0], 0.0)))


def strength_of_noise(campaign: Campaign, scatter: Array) -> float:
    """The same of noise that is ``scatter`` (N, M) times the instrument's: a number of n tells its logarithm to
    1 / sqrt(2 n), and the level of all is known to some per cent only.
    """
    logs = np.repeat(np.log(scatter)[_fitted(campaign)], 3)
    level = 2 * logs.sum()
    return float(np.sqrt(2 * np.sum(logs**2) - level**2 / (2 * len(logs) + LEVEL**-2)))


def strength_of_scatter(squares: float, count: int, others: int) -> float:
    """The same of ``count`` numbers that scatter by more than ``others`` of their sort, from the non-centrality of what
    they were drawn as: one by one that is known, and of a scatter only that mean squares differ. The noise of all is
    known to some per cent, as if from further numbers.
    """
    ratio, known = 1.0 + squares / count, others + LEVEL**-2 / 2
    level = (count * ratio + known) / (count + known)
    return float(np.sqrt((count + known) * np.log(level) - count * np.log(ratio)))


def squares_of_scatter(wanted: float, count: int, others: int) -> float:
    """The non-centrality that such numbers need for a strength, by bisection of its logarithm."""
    low, high = 0.0, 30.0
    for _ in range(60):
        middle = (low + high) / 2
        enough = strength_of_scatter(float(np.exp(middle)), count, others) > wanted
        low, high = (low, middle) if enough else (middle, high)
    return float(np.exp(high))


def change(plain: Campaign, changed: Campaign) -> Array:
    """Change of all measurements (N, R) by an effect, from two campaigns without noise."""
    points = changed.record.points - plain.record.points
    return np.concatenate([points.reshape(len(points), -1), changed.readings - plain.readings], axis=1)


def fit_of(campaign: Campaign) -> Fit:
    """The fit to a campaign in which nothing is hidden."""
    own, shared, further = (_ups if campaign.layout.geometry.mechanism == "ups" else _pus)(campaign)
    weight = _weight(campaign)
    u, s, _ = np.linalg.svd(own * weight[..., None], full_matrices=False)
    basis = np.where(s[:, None] > LEAST * s.max(), u, 0.0)
    shared = shared * weight[..., None]
    shared = shared - basis @ (np.swapaxes(basis, 1, 2) @ shared)
    shared = shared.reshape(-1, shared.shape[-1])
    information = np.eye(shared.shape[1]) + further.T @ further + shared.T @ shared
    return Fit(weight, basis, shared, np.linalg.inv(information))


def _fitted(campaign: Campaign) -> Array:
    held = np.array(campaign.schedule.role) == "verification"
    return campaign.record.is_observed & ~campaign.record.gross & ~held[:, None]


def _weight(campaign: Campaign) -> Array:
    noise, fitted = campaign.layout.noise, _fitted(campaign)
    points = fitted[..., None] / (noise.point_mm * np.array(noise.axis_ratio))
    held = np.array(campaign.schedule.role) == "verification"
    readings = np.where(held[:, None], 0.0, 1 / noise.actuator_mm) * np.ones(campaign.readings.shape)
    return np.concatenate([points.reshape(len(fitted), -1), readings], axis=1)


def _pus(campaign: Campaign) -> tuple[Array, Array, Array]:
    """Columns of a pose's own unknowns (N, R, P), of the common ones (N, R, S), and rows that contain only these."""
    marks, truth = campaign.marks, campaign.truth

    def points(built: Geometry, drho: Array) -> tuple[Array, BodyPoses]:
        machine = at_reference(built, _carried(campaign, built), drho)
        body_poses = stand(machine, at_reference(built, marks, np.zeros((1, drho.shape[1]))))
        return exact_points(machine, body_poses, marks), body_poses

    here, body_poses = points(truth.built, truth.drho)
    legs = truth.drho.shape[1]
    drives = [(points(truth.built, truth.drho + STEP * np.eye(legs)[i])[0] - here) / STEP for i in range(legs)]
    reading = np.broadcast_to(np.eye(legs), (len(here), legs, legs))
    own = [_rows(campaign, np.stack(drives, -1), reading), *_frames(campaign, here)]
    rolls = _rolls(campaign, here, body_poses)
    own += [_rows(campaign, rolls, np.zeros((len(here), legs, rolls.shape[-1])))] if rolls.shape[-1] else []
    slopes = _by_geometry(campaign, lambda built: points(built, truth.drho)[0] - here)
    shape, further = _by_survey(campaign, body_poses.turn[:, _body_of(campaign)], slopes.shape[-1])
    columns = np.concatenate([slopes, shape], -1)
    return np.concatenate(own, -1), _rows(campaign, columns, np.zeros((len(here), legs, columns.shape[-1]))), further


def _ups(campaign: Campaign) -> tuple[Array, Array, Array]:
    """As ``_pus``: points tell where the platform stands, and the readings where the geometry puts it."""
    truth, marks = campaign.truth, campaign.marks
    turn = from_vector(truth.rotation_vector)
    body_poses = _two(truth.position, turn)
    machine = at_reference(truth.built, marks, truth.drho)
    here = exact_points(machine, body_poses, marks)
    reading = displacements(truth.built, body_poses)
    own = []
    for axis in np.eye(3):
        for moved in (_two(truth.position + STEP * axis, turn), _two(truth.position, _turned(turn, axis))):
            points = (exact_points(machine, moved, marks) - here) / STEP
            read = (displacements(truth.built, moved) - reading) / STEP
            own.append(_rows(campaign, points[..., None], read[..., None]))
    own += _frames(campaign, here)

    def seats(built: Geometry) -> Array:
        return exact_points(at_reference(built, _carried(campaign, built), truth.drho), body_poses, marks) - here

    slopes = _by_geometry(campaign, seats)
    reads = _by_geometry(campaign, lambda built: displacements(built, body_poses) - reading)
    shape, further = _by_survey(campaign, body_poses.turn[:, _body_of(campaign)], slopes.shape[-1])
    reads = np.concatenate([reads, np.zeros((*reading.shape, shape.shape[-1]))], -1)
    return np.concatenate(own, -1), _rows(campaign, np.concatenate([slopes, shape], -1), reads), further


def _two(position: Array, turn: Array) -> BodyPoses:
    level = np.tile(IDENTITY, (len(turn), 1))
    return BodyPoses(np.stack([np.zeros_like(position), position], 1), np.stack([level, turn], 1))


def _turned(turn: Array, axis: Array) -> Array:
    return compose(from_vector(STEP * axis), turn)


def _body_of(campaign: Campaign) -> Array:
    names = ["base", "platform", *(f"leg{i}" for i in range(1, campaign.readings.shape[1] + 1))]
    return np.array([names.index(body) for body in campaign.marks.body])


def _rows(campaign: Campaign, points: Array, readings: Array) -> Array:
    """Columns (N, R, P) from those of the points (N, M, 3, P), turned into each pose's measurement frame."""
    seen = rotate(campaign.record.turn[:, None, None], np.moveaxis(points, -1, 2))
    return np.concatenate([np.moveaxis(seen, 2, -1).reshape(len(points), -1, points.shape[-1]), readings], 1)


def _frames(campaign: Campaign, here: Array) -> list[Array]:
    """A pose's measurement frame, shifted and turned."""
    shift = np.broadcast_to(np.eye(3), (*here.shape, 3))
    turn = np.stack([np.cross(axis, here - here.mean(axis=1, keepdims=True)) for axis in np.eye(3)], -1)
    none = np.zeros((*campaign.readings.shape, 3))
    return [_rows(campaign, shift, none), _rows(campaign, turn, none)]


def _rolls(campaign: Campaign, here: Array, body_poses: BodyPoses) -> Array:
    """Points (N, M, 3, legs with targets) as each leg turns about its own axis."""
    columns, body = [], _body_of(campaign)
    for number in range(2, 2 + campaign.readings.shape[1]):
        if np.any(body == number):
            axis = rotate(body_poses.turn[:, number], np.broadcast_to([0.0, 0.0, 1.0], (len(here), 3)))
            column = np.cross(axis[:, None], here - body_poses.position[:, number, None])
            columns.append(np.where((body == number)[:, None], column, 0.0))
    return np.stack(columns, -1) if columns else np.zeros((*here.shape, 0))


def _carried(campaign: Campaign, built: Geometry) -> object:
    """The marks of another geometry: those on attachments sit where these are."""
    place = campaign.marks.place.copy()
    for k, leg in enumerate(campaign.marks.on_leg):
        if leg:
            place[k] = built.b[leg - 1]
    return replace(campaign.marks, place=place)


def _by_geometry(campaign: Campaign, moved: Callable[[Geometry], Array]) -> Array:
    """Motion (..., S) per tolerance of each geometric parameter: a, b, u (x and y), length."""
    built, known, columns = campaign.truth.built, campaign.layout.tolerance, []
    for name, sigma in (("a", known.a_mm), ("b", known.b_mm), ("u", known.u), ("length", known.length_mm)):
        value = getattr(built, name)
        step = 1e-5 if name == "u" else STEP
        for place in np.ndindex(value.shape):
            if name != "u" or place[1] < 2:
                off = value.copy()
                off[place] += step
                columns.append(moved(replace(built, **{name: unit(off) if name == "u" else off})) * sigma / step)
    return np.stack(columns, -1)


def _by_survey(campaign: Campaign, turn: Array, before: int) -> tuple[Array, Array]:
    """Points (N, M, 3, S) as the survey's errors and the legs' survey frames move the targets; turn (N, M, 4) is how
    their bodies stand. Next to them the rows (3 per attachment) that tell its place from the survey, ``before`` columns
    of the geometry first.
    """
    layout, marks = campaign.layout, campaign.marks
    sigma = layout.noise.point_mm if layout.noise.survey_mm is None else layout.noise.survey_mm
    seats = np.flatnonzero(marks.on_leg)
    errors = sigma * _without_frame(campaign)
    frames = _leg_frames(campaign)
    body = np.concatenate([errors, frames], -1)
    further = np.zeros((len(seats), 3, before + body.shape[-1]))
    further[:, :, before : before + errors.shape[-1]] = (_alone(errors, seats) - errors[seats]) / sigma
    for row, k in enumerate(seats):
        first = 3 * len(campaign.truth.built.a) + 3 * (marks.on_leg[k] - 1)
        further[row, :, first : first + 3] = layout.tolerance.b_mm / sigma * np.eye(3)
    body[seats] = 0.0  # they sit where the joints are, whatever the survey says
    along = np.broadcast_to(np.moveaxis(body, -1, 1), (len(turn), len(body), body.shape[-1], 3))
    moved = rotate(turn[:, :, None], along)
    return np.moveaxis(moved, 2, -1), further.reshape(-1, further.shape[-1])


def _alone(errors: Array, seats: Array) -> Array:
    """The seats' own errors, which the survey's noise already weighs: not once more."""
    own = np.zeros_like(errors[seats])
    for row, k in enumerate(seats):
        own[row, :, 3 * k : 3 * k + 3] = errors[k, :, 3 * k : 3 * k + 3]
    return own


def _without_frame(campaign: Campaign) -> Array:
    """Apparent shifts of targets (M, 3) by errors (3 M) of their survey, in the frame that they define."""
    marks = campaign.marks
    count = len(marks.place)
    seen = np.eye(3 * count).reshape(count, 3, 3 * count)
    for body in ("base", "platform"):
        framing, own = marks.framing(body), marks.of(body)
        if len(framing) >= 3:
            rigid = _rigid(marks.place)
            motion = np.linalg.pinv(rigid[framing].reshape(-1, 6)) @ seen[framing].reshape(-1, 3 * count)
            seen[own] = seen[own] - (rigid[own].reshape(-1, 6) @ motion).reshape(len(own), 3, -1)
    return seen


def _rigid(place: Array) -> Array:
    """Columns (M, 3, 6) of a small motion: three shifts, three turns."""
    turns = np.stack([np.cross(axis, place) for axis in np.eye(3)], -1)
    return np.concatenate([np.broadcast_to(np.eye(3), turns.shape), turns], -1)


def _leg_frames(campaign: Campaign) -> Array:
    """Columns (M, 3, 6 per leg with targets) of where each leg's survey frame sits on it, of which nothing is known."""
    marks, body = campaign.marks, np.array(campaign.marks.body)
    free = np.array([FREE_MM] * 3 + [FREE_RAD] * 3)
    legs = [name for name in sorted(set(body)) if name.startswith("leg")]
    columns = [np.where((body == name)[:, None, None], _rigid(marks.place), 0.0) * free for name in legs]
    return np.concatenate(columns, -1) if columns else np.zeros((len(body), 3, 0))
