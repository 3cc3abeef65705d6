"""Strengths of effects on a force sensor agree with values that follow without a model of the sensor."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.blind.generator.sensor.case import Case, Measure, hide, layouts_for
from tests.blind.generator.sensor.draw import LAYOUTS, Plan, draw_plan
from tests.blind.generator.sensor.effects import Effect, LoadEccentricity, StiffnessScale
from tests.blind.generator.sensor.hidden import CATALOGUE, KINDS, STRANGE
from tests.blind.generator.sensor.layout import LOADS, Layout, Noise, Programme, Tolerance
from tests.blind.generator.sensor.recording import FringeSlip, ZeroDrift
from tests.blind.generator.sensor.schedule import COLUMNS
from tests.tolerance import assert_between
from truing.schemas.campaign import Campaign as Settings

EXACTLY_MADE = Tolerance(1e-12, 1e-12, 1e-12, 1e-12, 1e-12)
DZ, HALF_WAVE = 2, 632.990577e-9 / 2


def planned(layout: Layout) -> Plan:
    return Plan("planned", layout, 11)


def test_a_slip_is_as_strong_as_the_readings_before_and_after() -> None:
    """21 readings of one run and its zero: a jump between 9 and 12 of them, whose zero has one sigma before it."""
    measure = Measure(planned(Layout("slip", tolerance=EXACTLY_MADE, programme=Programme(channels="own"))))
    found = measure.strength(FringeSlip(DZ, 3, True, 10, 9))
    before, after = 9 + 1, 12  # the zero's prior is one reading more
    expected = 10 * HALF_WAVE / 0.5e-6 * np.sqrt(before * after / (before + after))
    # The zero's prior has one sigma and each reading too: of the mean before, 1 / 10; of the mean after, 1 / 12.
    assert_between(found / expected, 0.999, 1.001, what="strength over that of two means")


def test_a_drift_is_as_strong_as_its_slope() -> None:
    layout = Layout("drift", tolerance=EXACTLY_MADE, programme=Programme(channels="own", uneven=0.0))
    measure = Measure(planned(layout))
    rate = 1e-9
    since = measure.plain.schedule.since_start[measure.plain.schedule.run == 3]
    seen = rate * since / 0.5e-6
    expected = np.sqrt(seen @ seen - seen.sum() ** 2 / (len(seen) + 1))
    assert_between(measure.strength(ZeroDrift(DZ, rate)) / expected, 0.999, 1.001, what="strength over a line's")


def test_uncertain_legs_and_loads_weaken_effects_that_resemble_them() -> None:
    known = Layout("known", tolerance=EXACTLY_MADE)
    unsure = replace(known, tolerance=replace(known.tolerance, stiffness=0.05))
    offset = LoadEccentricity(DZ, (0.001, 0.0, 0.0))
    one, other = (Measure(planned(layout)).strength(offset) for layout in (known, unsure))
    assert other < 0.99 * one
    noisy = replace(known, noise=Noise(force=20.0, torque=10.0))
    scale = StiffnessScale(DZ, 0.001)
    sure, loose = (Measure(planned(layout)).strength(scale) for layout in (known, noisy))
    assert loose < 0.7 * sure


def _layout_of(name: str, number: int) -> str:
    """Those that are quickly drawn: mostly where the compliance is given, and has no elements to differ."""
    there = layouts_for([name])
    return "given" if "given" in there and number % 4 else "together"


@pytest.mark.parametrize("name", sorted(set(KINDS) - {"rows-exchanged"}))
def test_every_kind_reaches_the_strength_asked_for(name: str) -> None:
    number = sorted(KINDS).index(name)
    case = hide([name], _layout_of(name, number), 30.0, number)
    near = 0.25 if name == "fringe-slip" else 0.02  # slips come in whole numbers
    assert_between(case.strengths[0], 30 * (1 - near), 30 * (1 + near), what="strength")
    effect = case.effects[0]
    assert effect.id == (name if name in CATALOGUE else "unexplained")
    assert_shows(case, effect)


def assert_shows(case: Case, effect: Effect) -> None:
    """The campaign with the effect is another one, in readings or signals, and its drivers are there to be seen."""
    plain, changed = case.plan.campaign(), case.plan.campaign([effect])
    readings = np.abs((changed.readings - plain.readings) / plain.layout.noise.channels).max()
    signals = np.abs(changed.signals - plain.signals).max(initial=0.0) / plain.layout.noise.signal_mv
    assert max(readings, signals) > 0.5
    assert set(effect.drivers) <= {"time_s", *COLUMNS, *LOADS}
    if set(effect.drivers) & set(COLUMNS):
        assert plain.layout.surroundings.recorded


def test_effects_outside_the_catalogue_have_inputs_or_a_channel() -> None:
    campaign = draw_plan("together", frozenset({"weather", "lunch"}), 2).campaign()
    for number, name in enumerate(sorted(STRANGE)):
        effect = STRANGE[name].draw(campaign, np.random.default_rng(number))(1.0)
        assert effect.id == "unexplained"
        assert effect.drivers or effect.subject, name


@pytest.mark.parametrize("kind", sorted(LAYOUTS))
def test_every_layout_is_a_campaign_that_the_settings_understand(kind: str, tmp_path: Path) -> None:
    import tomllib

    folder = Case(draw_plan(kind, frozenset({"signals"}), 5), (), ()).write(tmp_path / "drawn")
    with (folder / "campaign.toml").open("rb") as file:
        settings = Settings.model_validate(tomllib.load(file))
    assert settings.mechanism.type == "6-upur"
    lines = [len(path.read_text(encoding="utf-8").splitlines()) for path in folder.glob("*.csv")]
    assert len(lines) >= 2
    assert max(lines) > 60
