"""Measurements of an arm: points of targets, poses of the tip, or distances to stations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator.arms.arm import Arm
from tests.blind.generator.arms.motion import State, places
from tests.blind.generator.arms.schedule import Schedule
from tests.blind.generator.arms.transforms import Array, any_rotation, rotation, small_vector

INSTRUMENTS = ("points-pose", "points-series", "points-campaign", "poses", "distances")
BOTH = "points-and-distances"  # drawn only by name
ROTATIONS = ("quaternion", "rotation vector", "euler")
EULER = ("XYZ", "ZYX", "ZYZ", "xyz")


@dataclass(frozen=True)
class Target:
    """A target on a link: its place (3,), m, in the link's frame, and whether that is known from a survey."""

    name: str
    link: int
    place: Array
    surveyed: bool


@dataclass(frozen=True)
class Instrument:
    """An instrument: ``frame`` says within what it stands still; ``noise`` is in m, ``turn_noise`` in rad.

    ``base`` holds rotation and place of the base frame in each measurement frame; ``stations`` (S, 3) are in the
    measurement frame. ``is_observed`` (N, M) marks the targets seen of each pose.
    """

    kind: str
    frame: str
    targets: tuple[Target, ...]
    noise: float
    turn_noise: float
    base: tuple[Array, Array]
    stations: Array
    is_observed: NDArray[np.bool_]
    rotations: str = "quaternion"
    euler: str = "XYZ"

    def groups(self, schedule: Schedule) -> NDArray[np.int64]:
        """Index (N,) of each pose's measurement frame."""
        if self.frame == "pose":
            return np.arange(len(schedule.time))
        return schedule.series if self.frame == "series" else np.zeros(len(schedule.time), np.int64)


@dataclass(frozen=True)
class Seen:
    """Points (N, M, 3), the tip's rotation (N, 3, 3) and origin (N, 3) in the measurement frame, distances (N, S M)."""

    points: Array
    turned: Array
    moved: Array
    distances: Array


def draw_instrument(kind: str, arm: Arm, schedule: Schedule, rng: np.random.Generator) -> Instrument:
    """Draw an instrument of one of the kinds, its targets and where it stands."""
    family, _, frame = ("points", "", "campaign") if kind == BOTH else kind.partition("-")
    count = len(schedule.time)
    if not frame:
        frame = "series" if family == "poses" and schedule.series[-1] and rng.random() < 0.3 else "campaign"
    targets: list[Target] = []
    if family != "poses":
        number, surveyed = int(rng.choice([1, 3, 4])), bool(rng.random() < 0.5)
        for tip in arm.tips:
            places_ = rng.uniform(-0.12, 0.12, (number, 3)) + np.array([0.0, 0.0, 0.03])
            own = len(targets)
            targets += [Target(f"T{own + n + 1}", tip, place, surveyed) for n, place in enumerate(places_)]
    if family == "points" and (frame == "pose" or rng.random() < 0.4):
        surveyed = bool(rng.random() < 0.6)
        corners = np.array([[1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0.3]]) * 0.4 + rng.normal(0, 0.08, (4, 3))
        targets += [Target(f"B{n + 1}", 0, place, surveyed) for n, place in enumerate(corners)]
    shared = max(int(Instrument.groups(_bare(frame), schedule).max()) + 1, 1)
    spread = 0.05 if frame == "pose" else 0.3
    mean = any_rotation(rng)
    base = (
        np.stack([rotation(rng.normal(0.0, spread, 3)) @ mean for _ in range(shared)]),
        rng.uniform(-3.0, 3.0, 3) + rng.normal(0.0, spread, (shared, 3)),
    )
    stations = base[1][0] + rng.uniform(-1.0, 1.0, (int(rng.choice([1, 3])) if "distances" in kind else 0, 3)) * 2.0
    is_observed = rng.random((count, len(targets))) >= (rng.choice([0.0, 0.02]) if len(targets) > 1 else 0.0)
    if frame == "pose":  # else a pose could lose the frame that it is measured in
        is_observed[:, [target.link == 0 for target in targets]] = True
    return Instrument(
        family,
        frame,
        tuple(targets),
        round(float(np.exp(rng.uniform(np.log(5e-6), np.log(50e-6)))), 7),
        round(float(np.exp(rng.uniform(np.log(1e-5), np.log(1e-4)))), 7),
        base,
        stations,
        is_observed,
        str(rng.choice(ROTATIONS)),
        str(rng.choice(EULER)),
    )


def _bare(frame: str) -> Instrument:
    none = np.zeros((0, 3))
    return Instrument("points", frame, (), 1.0, 1.0, (none, none), none, np.zeros((0, 0), bool))


def see(instrument: Instrument, schedule: Schedule, arm: Arm, state: State) -> Seen:
    """Measurement without noise."""
    found = places(arm, state)
    group = instrument.groups(schedule)
    turned, moved = instrument.base[0][group], instrument.base[1][group]
    moved = moved + np.einsum("nij,nj->ni", turned, state.twist[:, :3])
    turned = turned @ rotation(state.twist[:, 3:])
    carriers = np.array([target.link for target in instrument.targets], int)
    own = np.array([target.place for target in instrument.targets]).reshape(-1, 3) + state.shift
    points = found.moved[:, carriers] + np.einsum("nmij,nmj->nmi", found.turned[:, carriers], own)
    points = moved[:, None] + np.einsum("nij,nmj->nmi", turned, points)
    tip = arm.tips[0]
    away = points[:, None] - instrument.stations[None, :, None]
    return Seen(
        points,
        turned @ found.turned[:, tip],
        moved + np.einsum("nij,nj->ni", turned, found.moved[:, tip]),
        np.linalg.norm(away, axis=-1).reshape(len(points), -1),
    )


def rows(instrument: Instrument, seen: Seen, reference: Seen) -> Array:
    """Differences (N, R) of what is recorded, seen less reference, each over its noise; 0 where nothing is seen."""
    if instrument.kind == "poses":
        turn = small_vector(seen.turned @ np.swapaxes(reference.turned, -1, -2))
        return np.concatenate([(seen.moved - reference.moved) / instrument.noise, turn / instrument.turn_noise], axis=1)
    if instrument.kind == "distances":
        shown = np.tile(instrument.is_observed, (1, len(instrument.stations)))
        return (seen.distances - reference.distances) / instrument.noise * shown
    change = (seen.points - reference.points) * instrument.is_observed[:, :, None] / instrument.noise
    shown = np.tile(instrument.is_observed, (1, len(instrument.stations)))
    along = (seen.distances - reference.distances) / instrument.noise * shown
    return np.concatenate([change.reshape(len(change), -1), along], axis=1)


def largest(instrument: Instrument, seen: Seen, reference: Seen) -> float:
    """Largest displacement, m, of what is seen."""
    if instrument.kind == "poses":
        return float(np.abs(seen.moved - reference.moved).max())
    return float(np.abs(seen.points - reference.points).max())
