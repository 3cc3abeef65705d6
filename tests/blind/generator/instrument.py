"""Measured data: measurement frames, noise, gross errors, missing targets, the survey, the readings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.blind.generator.layout import DataFaults, Layout, Noise, Surroundings
from tests.blind.generator.machine import Marks
from tests.blind.generator.quaternions import Array, fit_motion, from_vector, inverse, rotate, unit
from tests.blind.generator.schedule import Schedule

FEWEST_SEEN = 4  # of base and platform in every pose: below, no one would have kept the pose


@dataclass(frozen=True)
class Record:
    """Points (N, M, 3) in the frame of each pose's measurement, whether they were seen, and which are grossly
    wrong (N, M); how the base frame is turned into the measurement's (N, 4).
    """

    points: Array
    is_observed: Array
    gross: Array
    turn: Array


def record_points(points: Array, scatter: Array, marks: Marks, layout: Layout, rng: np.random.Generator) -> Record:
    """Measures points (N, M, 3) given in the base frame, with ``scatter`` (N, M) times the instrument's noise;
    noise, gross errors and losses each from a stream of their own.
    """
    frames, noise, gross, losses = rng.spawn(4)
    turn, shift = _own_frames(len(points), layout.surroundings, frames)
    measured = rotate(turn[:, None], points) + shift
    measured += scatter[..., None] * _point_noise(points.shape, layout.noise, noise)
    wrong = _hit(points.shape[:2], layout.faults.gross_share, gross)
    low, high = np.log(layout.faults.gross_mm)
    errors = unit(gross.normal(size=points.shape)) * np.exp(gross.uniform(low, high, points.shape[:2]))[..., None]
    measured += np.where(wrong[..., None], errors, 0.0)
    return Record(measured, _seen(points.shape[:2], marks, layout.faults, losses), wrong, turn)


def _own_frames(n: int, surroundings: Surroundings, rng: np.random.Generator) -> tuple[Array, Array]:
    angle = surroundings.frame_turn_rad * rng.uniform(0.0, 1.0, (n, 1))
    turn = from_vector(angle * unit(rng.normal(size=(n, 3))))
    return turn, rng.normal(0.0, surroundings.frame_shift_mm, (n, 1, 3))


def _point_noise(shape: tuple[int, ...], noise: Noise, rng: np.random.Generator) -> Array:
    draw = rng.standard_t(5, shape) / np.sqrt(5 / 3) if noise.heavy_tails else rng.normal(size=shape)
    return noise.point_mm * np.array(noise.axis_ratio) * draw


def _hit(shape: tuple[int, ...], share: float, rng: np.random.Generator) -> Array:
    """Exactly the share of the entries, rounded, at random."""
    chosen = np.zeros(shape, bool)
    chosen.flat[rng.permutation(chosen.size)[: round(share * chosen.size)]] = True
    return chosen


def _seen(shape: tuple[int, ...], marks: Marks, faults: DataFaults, rng: np.random.Generator) -> Array:
    is_observed = ~_hit(shape, faults.missing_share, rng)
    for body in ("base", "platform"):
        columns = marks.framing(body)
        short = is_observed[:, columns].sum(axis=1) < FEWEST_SEEN
        is_observed[np.ix_(short, columns)] = True
    return is_observed


def survey(marks: Marks, layout: Layout, rng: np.random.Generator) -> Array:
    """The surveyed places (M, 3): true ones with the instrument's noise, laid into the frames that they
    define themselves.

    Base and platform: turned and shifted so that the least-squares motion from the survey of the targets
    without leg to the targets is none. Legs: the survey's own axes, or any other frame where ``leg_frame`` is
    "free".
    """
    noise, frames = rng.spawn(2)
    sigma = layout.noise.point_mm if layout.noise.survey_mm is None else layout.noise.survey_mm
    places = marks.place + sigma * noise.normal(size=marks.place.shape)
    for body in ("base", "platform"):
        framing, own = marks.framing(body), marks.of(body)
        if len(framing) >= 3:
            turn, shift = fit_motion(places[framing], marks.place[framing])
            places[own] = rotate(turn, places[own]) + shift
    if layout.targets.leg_frame == "free":
        for body in sorted({body for body in marks.body if body.startswith("leg")}):
            own = marks.of(body)
            turn = from_vector(frames.normal(size=3))
            places[own] = rotate(turn, places[own]) + frames.normal(0.0, 100.0, 3)
    return places


def read_actuators(indicated: Array, layout: Layout, rng: np.random.Generator) -> Array:
    """Readings rho0 + drho (N, 6) of actuators that stand at ``indicated`` drho, mm."""
    return layout.geometry.rho0 + indicated + rng.normal(0.0, layout.noise.actuator_mm, indicated.shape)


def settle(schedule: Schedule, surroundings: Surroundings, rng: np.random.Generator) -> Array:
    """Positions at which the actuators stop (N, 6), mm, near the commanded values."""
    return schedule.asked + rng.normal(0.0, surroundings.positioning_mm, schedule.asked.shape)


def declared_sigma(noise: Noise) -> tuple[float, Array]:
    """The noise that the campaign declares: one number, and one per axis of the measurement frame (3,),
    mm.
    """
    ratio = np.array(noise.axis_ratio)
    level = noise.declared_point_mm
    if level is None:
        level = noise.point_mm * float(np.sqrt(np.mean(ratio**2)))
    return level, level * ratio / np.sqrt(np.mean(ratio**2))


def back_to_body(turn: Array, position: Array, points: Array) -> Array:
    """Points (..., 3) of the base frame in the frame of a body that stands at (turn, position)."""
    return rotate(inverse(turn), points - position)
