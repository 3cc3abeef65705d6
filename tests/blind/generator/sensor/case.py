"""A case: effects of a required strength hidden in a campaign of a given layout; the seed determines the rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from tests.blind.generator.hidden_case import HiddenCase, PlannedMeasure
from tests.blind.generator.quaternions import Array
from tests.blind.generator.sensor.campaign import Campaign
from tests.blind.generator.sensor.draw import LAYOUTS, Plan, draw_plan
from tests.blind.generator.sensor.effects import Effect, Setting
from tests.blind.generator.sensor.folder import write_campaign
from tests.blind.generator.sensor.hidden import KINDS, OfSize
from tests.blind.generator.sensor.strange import Strange
from tests.blind.generator.sensor.strength import Fit, fit_of, fitted, rows_of, strength_of_noise

PLAUSIBLE = 25.0  # sizes beyond that many times the common one are no laboratory's
ATTEMPTS = 12
WITHOUT_SIZE = frozenset({"rows-exchanged"})
OF_A_BEAM = frozenset({"cosine-error", "abbe-offset", "dead-path", "fringe-slip", "interpolation error"})


@dataclass(frozen=True)
class Case(HiddenCase):
    """Effects hidden in a force sensor's campaign."""

    plan: Plan

    def put(self, campaign: Campaign, folder: Path) -> None:
        write_campaign(campaign, folder, self.plan.seed)

    @property
    def reported(self) -> Mapping[str, str]:
        return {**super().reported, "channels": self.plan.layout.programme.channels}


@dataclass(frozen=True)
class Measure(PlannedMeasure):
    """Measures how strongly effects show in a planned campaign."""

    plan: Plan

    @cached_property
    def _fit(self) -> Fit:
        return fit_of(self.plain)

    def strength(self, effect: Effect) -> float:
        """Root of the effect's non-centrality after all that a fit does not know."""
        scatter = effect.scatter(np.ones(self.plain.is_observed.shape), self._setting)
        if np.any(scatter != 1.0):
            return strength_of_noise(self.plain, scatter)
        changed = self.plan.campaign([effect], exact=True)
        if isinstance(effect, Strange) and effect.as_noise:
            return strength_of_noise(self.plain, self._as_noise(changed))
        return self._fit.strength(rows_of(changed) - rows_of(self.exact))

    def _as_noise(self, changed: Campaign) -> Array:
        """Factor on the noise of readings (S, 6) whose change has no shape and adds to the noise."""
        off = (changed.readings - self.exact.readings) / self.plain.layout.noise.channels
        used = fitted(self.plain)
        mean_square = np.sum(np.where(used, off, 0.0) ** 2, axis=0) / np.maximum(used.sum(axis=0), 1)
        return np.sqrt(1 + mean_square) * np.ones(off.shape)

    @property
    def _setting(self) -> Setting:
        plain = self.plain
        return Setting(plain.schedule, plain.truth.machine, plain.layout.interferometer.wavelength)

    def of_strength(self, of_size: OfSize, wanted: float) -> tuple[Effect, float, float]:
        """The effect of the size at which it is as strong as wanted, its strength, and that size."""
        return self.sized(of_size, wanted, 1.0)


def hide(names: Sequence[str], kind: str, wanted: float, seed: int) -> Case:
    """Effects by their names in ``hidden.KINDS``, each of the wanted strength, in a campaign of the layout ``kind``."""
    needs = frozenset[str]().union(*(KINDS[name].needs for name in names))
    plan = draw_plan(kind, needs, seed)
    measure, rng = Measure(plan), np.random.default_rng([seed, 2])
    found = [_hide_one(measure, name, wanted, rng) for name in names]
    return Case(plan, tuple(effect for effect, _ in found), tuple(size for _, size in found))


def _hide_one(measure: Measure, name: str, wanted: float, rng: np.random.Generator) -> tuple[Effect, float]:
    """Draws until the strength is that of a plausible size: what a campaign hardly shows would have to be absurd."""
    if name in WITHOUT_SIZE:
        return KINDS[name].draw(measure.plain, rng)(1.0), float("inf")
    tried = []
    for _ in range(ATTEMPTS):
        effect, found, size = measure.of_strength(KINDS[name].draw(measure.plain, rng), wanted)
        if found > 0.9 * wanted:
            tried.append((size, effect, found))
            if size <= PLAUSIBLE:
                return effect, found
    if not tried:
        raise ValueError(f"{name} does not show in this campaign")
    _, effect, found = min(tried, key=lambda one: one[0])
    return effect, found


def layouts_for(names: Sequence[str]) -> list[str]:
    """The layouts in which effects of these names can be hidden and distinguished from each other."""
    needs = frozenset[str]().union(*(KINDS[name].needs for name in names))
    without: set[str] = set()
    if "both" in needs:
        without.add("one-sided")
    if OF_A_BEAM & set(names):
        without.add("displacement")
    if "leg-stiffness" in names:
        without.add("given")  # of whose legs nothing is said
    if {"crosstalk", "signal-nonlinear"} & set(names):
        without.add("eight")  # whose signals show what nobody says: any mixture of them may be meant
    if "together" in needs:
        return ["together"]
    return [kind for kind in LAYOUTS if kind not in without]
