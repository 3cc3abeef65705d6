"""Commanded configurations, their order in time, and the temperature meanwhile."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tests.blind.generator.layout import LEGS, Surroundings
from tests.blind.generator.quaternions import Array

TABLES = Path(__file__).with_name("telescope_configurations.csv")
STROKE_MM = 1.3
# Further columns, as they go in time: air that changes slowly, and a load that is changed from pose to pose.
COLUMNS: Mapping[str, Callable[[int, np.random.Generator], Array]] = {
    "humidity_pct": lambda n, rng: 45 + np.cumsum(rng.normal(0.0, 1.5, n)),
    "pressure_hpa": lambda n, rng: 1013 + np.cumsum(rng.normal(0.0, 0.6, n)),
    "load_n": lambda n, rng: 50.0 * rng.integers(0, 4, n) + rng.normal(0.0, 0.5, n),
    "payload_kg": lambda n, rng: 8.0 + 10.0 * rng.integers(0, 4, n),
}


@dataclass(frozen=True)
class Schedule:
    """One entry per pose, in the order of the files; ``rank`` (N,) is the pose's place in time."""

    pose: tuple[int, ...]
    role: tuple[str, ...]
    asked: Array  # (N, 6) displacement asked of each actuator, mm
    time_s: Array
    temperature_c: Array
    reference_temperature_c: float
    further: Mapping[str, Array] = field(default_factory=dict)  # other columns (N,), by name

    @property
    def rank(self) -> Array:
        return np.argsort(np.argsort(self.time_s))

    @property
    def heat(self) -> Array:
        """Temperature above the reference temperature (N,), K."""
        return self.temperature_c - self.reference_temperature_c


def published_moves() -> list[tuple[int, str, Array]]:
    """Pose id, role and displacements (6,) of the report's tables 3 and 4 at +-1.3 mm: 40 calibration poses,
    then 6 for verification.
    """
    with TABLES.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return [
        (number, row["role"], STROKE_MM * np.array([float(row[f"level_{i}"]) for i in range(1, LEGS + 1)]))
        for number, row in enumerate(rows, start=1)
    ]


def even_moves(
    calibration: int, verification: int, rng: np.random.Generator, stroke_mm: float = STROKE_MM
) -> list[tuple[int, str, Array]]:
    """Displacements drawn evenly from the whole stroke, those held out from half of it."""
    roles = ["calibration"] * calibration + ["verification"] * verification
    reach = np.array([1.0] * calibration + [0.5] * verification)[:, None]
    asked = stroke_mm * reach * rng.uniform(-1.0, 1.0, (len(roles), LEGS))
    return [(n, role, row) for n, (role, row) in enumerate(zip(roles, asked, strict=True), 1)]


def random_moves(
    calibration: int, verification: int, rng: np.random.Generator, stroke_mm: float = STROKE_MM
) -> list[tuple[int, str, Array]]:
    """Displacements drawn evenly from the levels -1, 0, 1 of the stroke, with their pose ids and roles."""
    roles = ["calibration"] * calibration + ["verification"] * verification
    levels = rng.integers(-1, 2, (len(roles), LEGS)).astype(float)
    levels[calibration:] /= 2  # held out inside the range of what is fitted
    return [(n, role, stroke_mm * level) for n, (role, level) in enumerate(zip(roles, levels, strict=True), 1)]


def at_rest(pose: int = 0) -> tuple[int, str, Array]:
    """The reference configuration, measured as a pose of its own."""
    return pose, "reference", np.zeros(LEGS)


def plan(moves: Sequence[tuple[int, str, Array]], surroundings: Surroundings, rng: np.random.Generator) -> Schedule:
    """Moves in the order given (or shuffled in time), one pause apart, while the temperature walks slowly."""
    n = len(moves)
    order = rng.permutation(n) if surroundings.shuffled else np.arange(n)
    rank = np.argsort(order)
    ticks = np.cumsum(surroundings.pause_s * rng.uniform(0.8, 1.2, n)).round(1)
    walk = np.cumsum(rng.normal(0.0, surroundings.temperature_step_c, n))
    return Schedule(
        pose=tuple(pose for pose, _, _ in moves),
        role=tuple(role for _, role, _ in moves),
        asked=np.array([asked for _, _, asked in moves]),
        time_s=(ticks - ticks[0])[rank],
        temperature_c=(surroundings.reference_temperature_c + walk).round(2)[rank],
        reference_temperature_c=surroundings.reference_temperature_c,
        further={name: COLUMNS[name](n, rng).round(2)[rank] for name in surroundings.columns},
    )
