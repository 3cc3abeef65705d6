"""Strengths of effects agree with values that follow without a model of the machine, and cases with the request."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.blind.generator.case import Case, Measure, hide, layouts_for
from tests.blind.generator.draw import LAYOUTS, Plan, draw_plan
from tests.blind.generator.effects import ActuatorGain, Effect, TargetMoved
from tests.blind.generator.foreign import Foreign
from tests.blind.generator.hidden import CATALOGUE, KINDS, STRANGE
from tests.blind.generator.layout import DataFaults, Layout, Noise, Surroundings, Targets, Tolerance
from tests.blind.generator.schedule import at_rest, published_moves
from tests.blind.generator.smooth import own_part, random_function
from tests.blind.generator.strange import Strange, VibratingTarget
from tests.blind.generator.strength import squares_of_scatter, strength_of_scatter
from tests.stages.line import run_line
from tests.tolerance import assert_between, assert_close

CLEAN = Layout(
    name="clean",
    faults=DataFaults(0.0, 0.0),
    targets=Targets(base=10, platform=8, per_leg=0),
    surroundings=Surroundings(temperature_step_c=0.3),
)


def planned(layout: Layout = CLEAN, moves: Sequence[tuple] = (at_rest(), *published_moves())) -> Plan:
    return Plan("clean", layout, moves, 11)


def test_a_gain_is_as_strong_as_the_readings_noise_leaves_it() -> None:
    """Points without noise on a machine that is known: only the readings hide it, row by row."""
    layout = replace(CLEAN, noise=Noise(1e-5, actuator_mm=0.001), tolerance=Tolerance(1e-9, 1e-9, 1e-12, 1e-9))
    measure = Measure(planned(layout))
    moved = measure.plain.truth.drho[np.array(measure.plain.schedule.role) != "verification", 3]
    expected = 1e-4 * np.sqrt(np.sum(moved**2)) / 0.001
    found = measure.strength(ActuatorGain(1e-4 * np.eye(6)[3]))
    assert_between(found / expected, 0.999, 1.001, what="strength over that of the readings alone")


def test_a_moved_target_is_as_strong_as_its_sightings_before_and_after() -> None:
    """Its place is a mean of n + 1 sightings before (one by the survey) and of m after, among many other targets."""
    measure = Measure(planned(replace(CLEAN, targets=replace(CLEAN.targets, base=40))))
    before, after = 20, 21  # of 41 that are fitted
    expected = 0.02 / 0.005 * np.sqrt((before + 1) * after / (before + 1 + after))
    found = measure.strength(TargetMoved("base", "B31", (0.0, 0.02, 0.0), before))
    assert_between(found / expected, 0.93, 1.0, what="strength over that of a target by itself")


def test_signal_strength_of_a_scattering_target_follows_from_its_scatter() -> None:
    """A hundred and twenty-three numbers tell the logarithm of their noise to 1 / sqrt(246), less what all share."""
    measure = Measure(planned())
    found = measure.strength(VibratingTarget("base", "B05", 1.5))
    assert_between(found / (np.log(1.5) * np.sqrt(2 * 123)), 0.97, 1.0, what="strength over that of its own points")


def test_signal_strength_grows_with_fitted_poses_and_not_with_held_out_ones() -> None:
    moves = [at_rest(), *published_moves()]
    held = [(pose, "verification", asked) for pose, _, asked in moves[1:]]
    again = [(pose + 100, role, asked) for pose, role, asked in held]
    fitted = [(pose + 100, "calibration", asked) for pose, _, asked in held]
    gain = ActuatorGain(0.002 * np.ones(6))
    once, more, twice = (Measure(planned(moves=[*moves, *added])).strength(gain) for added in ((), again, fitted))
    assert_between(more / once, 0.9, 1.1, what="with more held out")
    assert_between(twice / once, 1.2, 1.5, what="with twice as many fitted")


def test_an_effect_twice_as_large_is_twice_as_strong() -> None:
    measure = Measure(planned())
    once, twice = (measure.strength(ActuatorGain(size * np.ones(6))) for size in (1e-4, 2e-4))
    assert_between(twice / once, 1.999, 2.001, what="ratio")


def test_the_part_of_a_sum_that_one_column_determines_is_its_own_term() -> None:
    inputs = np.random.default_rng(3).normal(size=(40, 2))
    alone = random_function(inputs[:, :1], 5)
    assert_close(own_part(inputs[:, :1], 5, 0), alone - alone.mean(), atol=1e-12)
    parts = [own_part(inputs, 5, column) for column in (0, 1)]
    whole = random_function(inputs, 5)
    assert all(0.1 * whole.var() < part.var() < 2.0 * whole.var() for part in parts)


SCALED = sorted(set(KINDS) - {"targets-swapped"})


@pytest.mark.parametrize("name", SCALED)
def test_every_kind_reaches_the_strength_asked_for(name: str) -> None:
    number = SCALED.index(name)
    kind = "hexapod" if "ups" in KINDS[name].mechanisms and number % 2 else "few"
    case = hide([name], kind, 7.0, number)
    assert_between(case.strengths[0], 6.9, 7.1, what="strength")
    effect = case.effects[0]
    assert effect.id == (name if name in CATALOGUE else "unexplained")
    assert_shows(case, effect)
    assert_parts(effect, case.driver_strengths[0], case.strengths[0])


def assert_parts(effect: Effect, of_drivers: Mapping[str, float], strength: float) -> None:
    """The part of a single driver is the whole effect; each of several drivers has a part."""
    assert sorted(of_drivers) == (sorted(effect.drivers) if isinstance(effect, Foreign) else [])
    for own in of_drivers.values():
        assert_between(own / strength, 0.1 if len(of_drivers) > 1 else 1 - 1e-6, 1.5, what="part")


def assert_shows(case: Case, effect: Effect) -> None:
    """The campaign with the effect is another one, in points or readings, and its drivers are there to be seen."""
    plain, changed = case.plan.campaign(), case.plan.campaign([effect])
    points = np.abs(changed.record.points - plain.record.points).max()
    readings = np.abs(changed.readings - plain.readings).max()
    assert max(points, readings) > 1e-4
    legs = plain.readings.shape[1]
    columns = {"time_s", "temperature_c", *plain.schedule.further, *(f"rho{leg + 1}_mm" for leg in range(legs))}
    assert set(effect.drivers) <= columns


def test_effects_outside_the_catalogue_have_inputs_or_a_target() -> None:
    campaign = draw_plan("telescope", frozenset({"humidity_pct", "load_n", "pressure_hpa"}), 2).campaign()
    for number, name in enumerate(sorted(STRANGE)):
        effect = STRANGE[name].draw(campaign, np.random.default_rng(number))(1.0)
        assert isinstance(effect, Strange)
        assert effect.drivers or effect.subject, name


def test_swapped_targets_are_seen_in_the_poses_named() -> None:
    case = hide(["targets-swapped"], "noisy", 1.0, 3)
    poses = [int(pose) for pose in str(case.effects[0].parameters()["poses"][0]).split()]
    assert 1 <= len(poses) <= 6
    assert_shows(case, case.effects[0])


@pytest.mark.parametrize("kind", sorted(LAYOUTS))
def test_every_layout_is_a_campaign_that_can_be_read(kind: str, tmp_path: Path) -> None:
    number = sorted(LAYOUTS).index(kind)
    folder = Case(draw_plan(kind, frozenset({"load_n"}), number), (), ()).write(tmp_path / "drawn")
    tables, _ = run_line(folder, "ingest")
    assert 31 <= len(tables["configurations"]) <= 81


def test_the_same_seed_draws_the_same_campaign() -> None:
    one, other = (draw_plan("noisy", frozenset(), 5).campaign() for _ in range(2))
    assert_close(one.record.points, other.record.points, atol=0.0)


def test_effects_of_every_mechanism_have_layouts() -> None:
    assert "hexapod" in layouts_for(["actuator-gain"])
    assert "hexapod" not in layouts_for(["actuator-gain", "flexure-shift"])


def test_the_strength_of_a_scatter_is_that_of_its_mean_square() -> None:
    """Far fewer numbers than there are others, twice as far off as these: the logarithm of a mean square of n is known
    to sqrt(2 / n), and the likelihood of its excess follows; the strength that is asked for is met."""
    for wanted in (3.0, 6.0, 20.0):
        squares = squares_of_scatter(wanted, 40, 200)
        assert_close(strength_of_scatter(squares, 40, 200), wanted, atol=1e-6, what="strength")
    few, ratio = 40, 1.1
    found = strength_of_scatter((ratio - 1.0) * few, few, 10**7)
    assert_between(found / (np.log(ratio) * np.sqrt(few / 2)), 0.95, 1.05, what="over that of the logarithm")
    assert strength_of_scatter(40.0, 120, 120) < strength_of_scatter(40.0, 40, 200)  # as all might be noisier
