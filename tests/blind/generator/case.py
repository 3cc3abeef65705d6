"""A case: effects of a required strength hidden in a campaign of a given layout; the seed determines the rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from tests.blind.generator.campaign import Campaign
from tests.blind.generator.draw import LAYOUTS, Plan, draw_plan
from tests.blind.generator.effects import Effect, Setting
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.foreign import Foreign
from tests.blind.generator.hidden import BENDING, KINDS, OfSize
from tests.blind.generator.hidden_case import HiddenCase, PlannedMeasure
from tests.blind.generator.strength import (
    Fit,
    change,
    fit_of,
    squares_of_scatter,
    strength,
    strength_of_noise,
    strength_of_scatter,
)

FIRST = 1e-5  # mm, 1/K or no unit: small enough for any effect to be in proportion


@dataclass(frozen=True)
class Case(HiddenCase):
    """Effects hidden in a photogrammetric campaign.

    ``driver_strengths``: of each effect without a form, how strong the part is that only one of its drivers tells.
    """

    driver_strengths: tuple[Mapping[str, float], ...] = ()

    @property
    def reported(self) -> Mapping[str, object]:
        own = [
            {driver: round(value, 3) for driver, value in driver_strength.items()}
            for driver_strength in self.driver_strengths
        ]
        return {**super().reported, "driver_strengths": own}

    def put(self, campaign: Campaign, folder: Path) -> None:
        write_campaign(campaign, folder, self.plan.seed)


@dataclass(frozen=True)
class Measure(PlannedMeasure):
    """Measures how strongly effects show in a planned campaign."""

    plan: Plan

    @cached_property
    def _fit(self) -> Fit:
        return fit_of(self.plain)

    def strength(self, effect: Effect) -> float:
        """Root of the effect's non-centrality after all that a fit does not know."""
        scatter = effect.scatter(np.ones(self.plain.record.is_observed.shape), self._setting)
        if np.any(scatter != 1.0):
            return strength_of_noise(self.plain, scatter)
        return strength(self._fit, change(self.exact, self.plan.campaign([effect], exact=True)))

    def of_drivers(self, effect: Effect) -> Mapping[str, float]:
        """Strength of the part of an effect that depends on one driver alone, by driver; none for effects with a
        form."""
        if not isinstance(effect, Foreign):
            return {}
        return {driver: self.strength(effect.of_driver(driver)) for driver in effect.drivers}

    @property
    def _setting(self) -> Setting:
        layout = self.plan.layout
        actuator_mm = layout.noise.declared_actuator_mm or layout.noise.actuator_mm
        return Setting(self.plain.schedule, self.plain.marks, layout.targets.follow, actuator_mm)

    def of_strength(self, of_size: OfSize, wanted: float) -> tuple[Effect, float]:
        """The effect of the size at which it is as strong as wanted, and its strength."""
        held = np.array(self.plain.schedule.role) == "verification"
        count = of_size(FIRST).drawn(~held)
        if not count:
            return self.sized(of_size, wanted, FIRST)[:2]
        others = int((~held).sum()) * self.plain.readings.shape[1] - count
        effect, found, _ = self.sized(of_size, float(np.sqrt(squares_of_scatter(wanted, count, others))), FIRST)
        return effect, strength_of_scatter(found**2, count, others)


def hide(names: Sequence[str], kind: str, wanted: float, seed: int) -> Case:
    """Effects by their names in ``hidden.KINDS``, each of the wanted strength, in a campaign of the layout ``kind``."""
    needs = frozenset[str]().union(*(KINDS[name].needs for name in names))
    plan = draw_plan(kind, needs, seed)
    measure, rng = Measure(plan), np.random.default_rng([seed, 2])
    found = []
    for name in names:
        of_size = KINDS[name].draw(measure.plain, rng)
        scaled = name != "targets-swapped"
        found.append(measure.of_strength(of_size, wanted) if scaled else (of_size(1.0), float("inf")))
    effects = tuple(effect for effect, _ in found)
    own = tuple(measure.of_drivers(effect) for effect in effects)
    return Case(plan, effects, tuple(size for _, size in found), own)


def layouts_for(names: Sequence[str]) -> list[str]:
    """The layouts in which effects of these names can be hidden and distinguished from each other."""
    mechanisms = set.intersection({"6-pus", "ups"}, *(set(KINDS[name].mechanisms) for name in names))
    of_legs = {kind: "ups" if kind == "hexapod" else "6-pus" for kind in LAYOUTS}
    without = {kind for kind, mechanism in of_legs.items() if mechanism not in mechanisms}
    if "actuator-gain" in names and BENDING & set(names):
        without.add("bare")  # where nothing on the attachments tells a bending platform from a wrong gain
    return [kind for kind in LAYOUTS if kind not in without]
