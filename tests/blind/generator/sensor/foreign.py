"""Foreign worlds of a bench: effects drawn from random functions, several of them at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from tests.blind.generator.quaternions import Array
from tests.blind.generator.sensor.campaign import Campaign
from tests.blind.generator.sensor.effects import Setting
from tests.blind.generator.sensor.layout import AXES, LOADS
from tests.blind.generator.sensor.schedule import COLUMNS
from tests.blind.generator.sensor.strange import Strange, column_of
from tests.blind.generator.smooth import random_function, random_walk, remanence

TAILS = 2.0  # degrees of freedom of Student's t


@dataclass(frozen=True)
class Foreign(Strange):
    """An effect on one channel whose shape the seed alone knows."""

    seed: int


@dataclass(frozen=True)
class FollowsInputs(Foreign):
    """A reading follows a function of loads, time and weather."""

    inputs: tuple[str, ...]

    @property
    def drivers(self) -> tuple[str, ...]:
        return self.inputs

    def course(self, setting: Setting) -> Array:
        schedule = setting.schedule
        known = [
            schedule.load[:, LOADS.index(name)] if name in LOADS else column_of(schedule, name) for name in self.inputs
        ]
        return random_function(np.column_stack(known), self.seed)


@dataclass(frozen=True)
class Remembers(Foreign):
    """Friction remembers all turning points of a load since the campaign began."""

    axis: int

    @property
    def drivers(self) -> tuple[str, ...]:
        return (LOADS[self.axis],)

    def course(self, setting: Setting) -> Array:
        return remanence(setting.schedule.load[:, self.axis], self.seed)


class NobodyRecorded(Foreign):
    """A reading that depends on an unrecorded quantity."""

    @property
    def drivers(self) -> tuple[str, ...]:
        return ()

    def course(self, setting: Setting) -> Array:
        return random_walk(len(setting.schedule.run), self.seed)


class LandsElsewhere(Foreign):
    """Every step lands elsewhere, with heavy tails."""

    @property
    def drivers(self) -> tuple[str, ...]:
        return ()

    def course(self, setting: Setting) -> Array:
        return np.clip(np.random.default_rng(self.seed).standard_t(TAILS, len(setting.schedule.run)) / 10, -1, 1)


OfSize = Callable[[float], Foreign]
Draw = Callable[[Campaign, np.random.Generator], OfSize]


def _of(build: Callable[[Campaign, np.random.Generator, int, int], Foreign]) -> Draw:
    def draw(campaign: Campaign, rng: np.random.Generator) -> OfSize:
        channel = int(rng.choice(np.flatnonzero(campaign.is_observed.any(axis=0))))
        noise = float(campaign.layout.noise.channels[channel])
        effect = build(campaign, rng, channel, int(rng.integers(2**31)))
        return lambda size: replace(effect, amount=size * noise)

    return draw


def _axis(campaign: Campaign, rng: np.random.Generator) -> str:
    return LOADS[AXES.index(str(rng.choice(campaign.schedule.axes)))]


def _inputs(campaign: Campaign, rng: np.random.Generator) -> tuple[str, ...]:
    """A load; half of the time the weather or the time in addition, or alone."""
    load, other = _axis(campaign, rng), str(rng.choice(["time_s", *COLUMNS]))
    return ((other,), (load, other), (load,), (load,))[rng.integers(4)]


FOREIGN: Mapping[str, Draw] = {
    "foreign course": _of(lambda c, rng, k, seed: FollowsInputs(k, 0.0, seed, _inputs(c, rng))),
    "friction remembers": _of(lambda c, rng, k, seed: Remembers(k, 0.0, seed, LOADS.index(_axis(c, rng)))),
    "nobody recorded it": _of(lambda c, rng, k, seed: NobodyRecorded(k, 0.0, seed)),
    "lands elsewhere": _of(lambda c, rng, k, seed: LandsElsewhere(k, 0.0, seed)),
}
