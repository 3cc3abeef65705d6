"""Commanded runs and steps, loads, recorded channels, and the climate of the hall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.blind.generator.quaternions import Array
from tests.blind.generator.sensor.layout import AXES, CHANNELS, Layout, Programme, Surroundings

HOUR_S, DAY_S = 3600.0, 86400.0
COLUMNS = ("air_temperature_c", "air_pressure_hpa", "relative_humidity_pct", "material_temperature_c")
TOGETHER = (-800, -400, 0, 400, 800)  # of which loads along several axes at once are drawn


@dataclass(frozen=True)
class Run:
    """Loads (n, 6) in the order applied, and the channels watched."""

    loads: Array
    channels: tuple[str, ...]
    role: str


@dataclass(frozen=True)
class Schedule:
    """One entry per load step, S in all, in time order: ``load`` (S, 6) as declared, N and N m; ``watched`` (S, 6);
    ``air`` (S, 4) the columns of ``COLUMNS`` as they really were; ``limit`` (6,) the largest load of each axis.
    """

    run: Array
    step: Array
    role: tuple[str, ...]
    time_s: Array
    load: Array
    watched: Array
    air: Array
    limit: Array

    @property
    def first(self) -> Array:
        """Row (S,) at which the run of each row starts."""
        return np.searchsorted(self.run, self.run)

    @property
    def since_start(self) -> Array:
        """Time (S,) since the first step of the run, s."""
        return self.time_s - self.time_s[self.first]

    @property
    def axes(self) -> tuple[str, ...]:
        """Those that are loaded at all."""
        return tuple(axis for axis, column in zip(AXES, self.load.T, strict=True) if np.any(column))

    def column(self, name: str) -> Array:
        """A further column (S,)."""
        return self.time_s if name == "time_s" else self.air[:, COLUMNS.index(name)]


def runs_of(layout: Layout, rng: np.random.Generator) -> list[Run]:
    """The programme as runs."""
    programme, limit = layout.programme, np.array(layout.range)
    if programme.together:
        loads = [_together(programme, limit, rng) for _ in range(programme.together)]
    else:
        share = np.array(programme.levels)[:, None] / 1000
        loads = [share * limit * np.eye(6)[AXES.index(axis)] for axis in programme.axes]
    out = []
    for repeat in range(programme.repeats):
        held = repeat >= programme.repeats - programme.held_out
        role = "" if not programme.held_out else "verification" if held else "calibration"
        for load in loads:
            out += [Run(load, channels, role) for channels in _watched(layout, load)]
    return out


def _together(programme: Programme, limit: Array, rng: np.random.Generator) -> Array:
    level = rng.choice(TOGETHER, (programme.steps_together, 6)) / 1000 * limit
    level[0] = level[-1] = 0.0
    return level


def _watched(layout: Layout, loads: Array) -> list[tuple[str, ...]]:
    free = [channel for channel in CHANNELS if channel not in layout.faults.never]
    own = [CHANNELS[k] for k in np.flatnonzero(np.any(loads, axis=0))]
    if layout.programme.channels == "all":
        return [tuple(free)]
    return [(channel,) for channel in (own if layout.programme.channels == "own" else free)]


def plan(layout: Layout, rng: np.random.Generator) -> Schedule:
    """All steps with their times and weather; each of these from a stream of its own."""
    loading, clock, weather = rng.spawn(3)
    runs = runs_of(layout, loading)
    count = [len(run.loads) for run in runs]
    time = _times(layout.programme, count, clock)
    load = np.concatenate([run.loads for run in runs])
    largest = np.abs(load).max(axis=0)
    return Schedule(
        run=np.repeat(np.arange(1, len(runs) + 1), count),
        step=np.concatenate([np.arange(n) for n in count]),
        role=tuple(run.role for run in runs for _ in run.loads),
        time_s=time,
        load=load,
        watched=np.concatenate([np.tile(np.isin(CHANNELS, run.channels), (len(run.loads), 1)) for run in runs]),
        air=_weather(layout.surroundings, time, weather),
        limit=np.array(layout.range) if layout.stated_range else np.where(largest > 0, largest, 1.0),
    )


def _times(programme: Programme, count: list[int], rng: np.random.Generator) -> Array:
    """A pause before every step, a longer one before every run, and lunch within every third run where there is one."""
    pauses = []
    for number, n in enumerate(count):
        pause = programme.pause_s * (1 + programme.uneven * rng.uniform(-1.0, 1.0, n))
        pause[0] = rng.uniform(600.0, 1800.0)
        lunch = int(rng.integers(n // 4, 3 * n // 4))
        if programme.lunch_s and number % 3 == 0:
            pause[lunch] = programme.lunch_s * rng.uniform(0.8, 1.2)
        pauses.append(pause)
    time = np.cumsum(np.concatenate(pauses))
    return (time - time[0]).round(1)


def _weather(surroundings: Surroundings, time: Array, rng: np.random.Generator) -> Array:
    """Air temperature over the day and at random, pressure and humidity at random, the material behind the air."""
    hours = np.diff(time, prepend=time[0]) / HOUR_S
    walk = np.cumsum(np.sqrt(hours)[:, None] * rng.normal(size=(len(time), 3)), axis=0)
    phase = rng.uniform(0.0, 2 * np.pi)
    swing = surroundings.day_k * np.sin(2 * np.pi * time / DAY_S + phase)
    air = surroundings.reference_temperature_c + rng.normal(0.0, 0.2) + swing + surroundings.air_k * walk[:, 0]
    pressure = 1013.0 + rng.normal(0.0, 4.0) + surroundings.pressure_hpa * walk[:, 1]
    humidity = 45.0 + rng.normal(0.0, 4.0) + surroundings.humidity_pct * walk[:, 2]
    material = np.empty_like(air)
    material[0] = air[0] + rng.normal(0.0, 0.1)
    for n in range(1, len(time)):
        kept = np.exp(-(time[n] - time[n - 1]) / surroundings.lag_s)
        material[n] = kept * material[n - 1] + (1 - kept) * air[n - 1]
    return np.stack([air, pressure, np.clip(humidity, 15.0, 85.0), material], axis=1).round(3)


def unloading(load: Array, run: Array) -> Array:
    """Mask (S, 6) of unloading: |F| is smaller than at the step before in the run. A held load stays on its branch."""
    down = np.zeros(load.shape, bool)
    for n in range(1, len(load)):
        if run[n] == run[n - 1]:
            now, before = np.abs(load[n]), np.abs(load[n - 1])
            down[n] = np.where(now == before, down[n - 1], now < before)
    return down
