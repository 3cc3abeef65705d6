"""Layouts of force-sensor campaigns drawn at random, before effects are hidden in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tests.blind.generator.sensor.campaign import Campaign, draw_campaign
from tests.blind.generator.sensor.designs import leaved, notched
from tests.blind.generator.sensor.effects import Effect
from tests.blind.generator.sensor.layout import (
    ARCSEC,
    CHANNELS,
    DataFaults,
    Interferometer,
    Layout,
    Noise,
    Programme,
    Surroundings,
    Tolerance,
    noiseless,
)

ONE_SIDED = (0, 200, 400, 600, 800, 1000, 800, 600, 400, 200, 0)
IN_FIFTHS = (*ONE_SIDED, *(-level for level in ONE_SIDED[1:]))
BAD_WEATHER = Surroundings(day_k=2.0, air_k=0.5, pressure_hpa=2.5, humidity_pct=4.0)


@dataclass(frozen=True)
class Plan:
    """Everything about a campaign but the effects: the layout, and the seed."""

    kind: str
    layout: Layout
    seed: int

    def campaign(self, effects: Sequence[Effect] = (), *, exact: bool = False) -> Campaign:
        """The campaign with effects in it; the same draws whatever they are, and without any noise where exact."""
        layout = noiseless(self.layout) if exact else self.layout
        return draw_campaign(layout, effects, np.random.default_rng(self.seed))


def _programme(rng: np.random.Generator) -> Programme:
    """One axis at a time, as benches go about it."""
    channels = str(rng.choice(["all", "separate", "own"], p=[0.55, 0.3, 0.15]))
    repeats = 1 if channels == "separate" else int(rng.integers(1, 4))
    held_out = int(repeats == 3 and rng.random() < 0.5)
    levels = IN_FIFTHS if rng.random() < 0.4 else Programme().levels
    return Programme(channels=channels, repeats=repeats, held_out=held_out, levels=levels)


def _plain(rng: np.random.Generator) -> Layout:
    return Layout("plain", programme=_programme(rng))


def _noisy(rng: np.random.Generator) -> Layout:
    faults = DataFaults(missing_share=rng.uniform(0.02, 0.06))
    return Layout("noisy", noise=Noise(2e-6, 0.8 * ARCSEC), faults=faults, programme=_programme(rng))


def _gaps(rng: np.random.Generator) -> Layout:
    """Some channels were never measured, some steps are lost."""
    never = tuple(str(name) for name in rng.choice(CHANNELS, int(rng.integers(1, 3)), replace=False))
    faults = DataFaults(missing_share=0.05, missing_steps=0.04, never=never)
    return Layout("gaps", faults=faults, programme=replace(_programme(rng), channels="all"))


def _notches(rng: np.random.Generator) -> Layout:
    ranges = (500.0,) * 3 + (30.0,) * 3
    noise = Noise(0.2e-6, 0.2 * ARCSEC, signal_mv=0.002)
    tolerance = Tolerance(20e-6, 20e-6, 10e-6, 10e-6, 20e-6)
    return Layout("notches", notched(rng), ranges, tolerance, noise, programme=_programme(rng))


def _leaves(rng: np.random.Generator) -> Layout:
    ranges = (20e3,) * 3 + (4e3,) * 3
    noise = Noise(0.1e-6, 0.05 * ARCSEC)
    tolerance = Tolerance(60e-6, 60e-6, 20e-6, 20e-6, 40e-6)
    return Layout("leaves", leaved(rng), ranges, tolerance, noise, programme=_programme(rng))


def _one_sided(rng: np.random.Generator) -> Layout:
    levels = (*ONE_SIDED, *ONE_SIDED[1:])
    return Layout("one-sided", programme=replace(_programme(rng), levels=levels))


def _together(rng: np.random.Generator) -> Layout:
    runs = int(rng.integers(3, 6))
    return Layout("together", programme=Programme(together=runs, steps_together=int(rng.integers(20, 36))))


def _signals(rng: np.random.Generator) -> Layout:
    return Layout("signals", programme=_programme(rng), signals=6)


def _eight(rng: np.random.Generator) -> Layout:
    return Layout("eight", programme=_programme(rng), signals=8)


def _displacement(rng: np.random.Generator) -> Layout:
    programme = replace(_programme(rng), channels="all")
    return Layout("displacement", noise=Noise(1e-6, 2e-6), programme=programme, written_as="displacement")


def _given(rng: np.random.Generator) -> Layout:
    return Layout("given", programme=_programme(rng), compliance_given=True)


def _raw(rng: np.random.Generator) -> Layout:
    optics = Interferometer(dead_path=round(float(rng.uniform(0.05, 0.3)), 3), compensated=False)
    return Layout("raw", programme=_programme(rng), interferometer=optics)


def _loads(rng: np.random.Generator) -> Layout:
    return Layout("loads", noise=Noise(force=2.0, torque=1.0), programme=_programme(rng))


LAYOUTS: dict[str, Callable[[np.random.Generator], Layout]] = {
    "plain": _plain,
    "noisy": _noisy,
    "gaps": _gaps,
    "notches": _notches,
    "leaves": _leaves,
    "one-sided": _one_sided,
    "together": _together,
    "signals": _signals,
    "eight": _eight,
    "displacement": _displacement,
    "given": _given,
    "raw": _raw,
    "loads": _loads,
}


def draw_plan(kind: str, needs: frozenset[str], seed: int) -> Plan:
    """A campaign's plan by the name of its layout. ``needs``: "six" components under each load, "uneven" pauses,
    a "lunch" break, "weather" that changes, "signals".
    """
    rng = np.random.default_rng([seed, 1])
    layout = LAYOUTS[kind](rng)
    programme = layout.programme
    if "six" in needs and programme.channels == "own":
        programme = replace(programme, channels="all")
    if "uneven" in needs:
        programme = replace(programme, uneven=0.7)
    if "lunch" in needs:
        programme = replace(programme, lunch_s=3000.0)
    weather = BAD_WEATHER if "weather" in needs or rng.random() < 0.2 else Surroundings()
    # The weather must be known where readings are to be compensated with it.
    recorded = bool("weather" in needs or kind == "raw" or rng.random() < 0.8)
    signals = layout.signals or 6 * int("signals" in needs or rng.random() < 0.2)
    stiffness = float(rng.choice([0.0, 0.02, 0.05], p=[0.3, 0.4, 0.3]))
    layout = replace(
        layout,
        programme=replace(programme, pause_s=float(rng.choice([40.0, 60.0, 90.0, 150.0]))),
        surroundings=replace(weather, recorded=recorded),
        signals=signals,
        tolerance=replace(layout.tolerance, stiffness=stiffness, common=float(rng.choice([0.2, 0.5, 0.8]))),
        stated_range=bool(rng.random() < 0.7),
    )
    return Plan(kind, layout, seed)
