"""Causes of a bench in the generator and in ``truing.simulation``, written independently, agree.

Two benches: set A, every channel in a run of its own, and a small sensor loaded along several axes at once; no noise.
They may differ by a tenth of the noise where the effect is a hundred times that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.blind.generator.sensor import effects as hidden
from tests.blind.generator.sensor import recording
from tests.blind.generator.sensor.campaign import Campaign, bridges, draw_campaign
from tests.blind.generator.sensor.designs import nominal_a, notched
from tests.blind.generator.sensor.draw import BAD_WEATHER
from tests.blind.generator.sensor.layout import CHANNELS, Layout, Noise, Programme, Tolerance
from tests.blind.generator.sensor.schedule import COLUMNS
from tests.blind.test_sensor_agreement import theirs
from truing.simulation.bench.causes import (
    beams,
    channels,
    counts,
    leg_stiffness,
    load_history,
    load_path,
    play_hysteresis,
    signal_nonlinear,
    stiffness,
    zero_step,
)
from truing.simulation.bench.known_readings import ChannelZeros, KnownReadings, ReadingConditions, SignalGains
from truing.simulation.bench.model import BenchModel
from truing.simulation.bench.six_upur.uncertain_sensor import UncertainSensor
from truing.simulation.cause import Cause

FZ, MY, DX, DZ = 2, 4, 0, 2
UM, HOUR_S, MV = 1e-6, 3600.0, 1e-3
EXACTLY_MADE = Tolerance(1e-12, 1e-12, 1e-12, 1e-12, 1e-12)
NOBODY = np.zeros(0, int)

COUPLED = tuple(
    tuple(row) for row in (2.0 * np.eye(6, 6)[:, [0]] * np.eye(6)[0] + 3.0 * np.eye(6)[:, [0]] * np.eye(6)[4]).tolist()
)

# What is hidden; the cause; its values in SI.
CASES: dict[str, tuple[hidden.Effect, Cause, Sequence[float]]] = {
    "offset": (hidden.LoadEccentricity(FZ, (0.003, -0.002, 0.0)), load_path.LoadEccentricity("fz"), [0.003, -0.002]),
    "force of a torque": (
        hidden.LoadEccentricity(MY, (0.01, 0.02, -0.03)),
        load_path.LoadEccentricity("my"),
        [0.01, 0.02, -0.03],
    ),
    "units apart": (
        hidden.LoadImbalance(FZ, (0, 0, 0, 0.001, 0, 0), (0, 0, 0, 0.004, 0, 0)),
        load_path.LoadImbalance("fz", ("x",)),
        [0.001, 0.004],
    ),
    "units that grow apart": (
        hidden.LoadImbalance(MY, (0, 0, 0.1, 0, 0, 0), (0.0,) * 6, (0, 0, 0.2, 0, 0, 0)),
        load_path.LoadImbalance("my", ("z",), (load_path.RATIO, load_path.GROWTH)),
        [0.1, 0.2],
    ),
    "scale": (hidden.StiffnessScale(FZ, 0.02), stiffness.StiffnessScale("fz"), [0.02]),
    "scale, along": (hidden.StiffnessScale(MY, 0.02, True), stiffness.StiffnessScale("my", own=True), [0.02]),
    "asymmetry": (hidden.StiffnessAsymmetry(FZ, 0.03), stiffness.StiffnessAsymmetry("fz"), [0.03]),
    "cubic": (hidden.StiffnessNonlinear(MY, -0.02), stiffness.StiffnessNonlinear("my"), [-0.02]),
    "soft leg": (hidden.LegStiffness(1, -0.3), leg_stiffness.LegStiffness(2), [np.log(0.7)]),
    "play": (hidden.JointClearance(FZ, 8 * UM), stiffness.JointClearance("fz"), [8 * UM]),
    "creep": (hidden.Creep((FZ,), 0.03, 170.0), load_history.Creep("fz", 170.0), [0.03]),
    "creep of all": (hidden.Creep(tuple(range(6)), 0.03, 400.0), load_history.Creep("", 400.0), [0.03]),
    "drift": (recording.ZeroDrift(DZ, 10 * UM / HOUR_S), channels.ZeroDrift("dz"), [10 * UM / HOUR_S]),
    "drift of a run": (
        recording.ZeroDrift(DZ, 10 * UM / HOUR_S, 3),
        channels.ZeroDrift("dz", 3, True),
        [10 * UM / HOUR_S],
    ),
    "warmth": (
        recording.ThermalDrift(DX, 9 * UM, -20 * UM),
        channels.ThermalDrift("dx", ("material_temperature_c", "air_temperature_c")),
        [9 * UM, -20 * UM],
    ),
    "askew": (
        recording.CosineError(DX, 0.05, recording.across(DX, 0.7)),
        beams.CosineError("dx"),
        [0.05 * np.cos(0.7), 0.05 * np.sin(0.7)],
    ),
    "arm": (recording.AbbeOffset(DZ, (0.01, -0.02, 0.0)), beams.AbbeOffset("dz"), [0.01, -0.02]),
    "dead path": (recording.DeadPath(DX, 3.0), channels.DeadPath("dx"), [3.0]),
    "slip": (
        recording.FringeSlip(DZ, 3, False, -7, 9),
        counts.FringeSlip("dz", 3, 9, 9, False, 632.990577e-9 / 2),
        [-7.0],
    ),
    "knock": (
        recording.ZeroStep(3, 9, (2 * UM, 0.0, -3 * UM, 0.0, 1e-5, 0.0)),
        zero_step.ZeroStep(("dx", "dz", "ry"), 3, 9, 9, (UM, UM, 1e-5)),
        [2 * UM, -3 * UM, 1e-5],
    ),
    "step of a signal": (
        recording.ZeroStep(3, 9, (), (0.0, 0.3, 0.0, 0.0, 0.0, 0.0)),
        zero_step.ZeroStep(("v2",), 3, 9, 9, (MV,)),
        [0.3 * MV],
    ),
    "curved signal": (
        recording.SignalNonlinear(2, 0.2, -0.1),
        signal_nonlinear.SignalNonlinear("v3", ("quadratic", "cubic"), (), ("v3",)),
        [0.2 / MV, -0.1 / MV**2],
    ),
    "signal of two loads": (
        recording.SignalNonlinear(2, coupled=COUPLED),
        signal_nonlinear.SignalNonlinear("v3", (), ("fx-fx", "fx-my"), ("v3",)),
        [2 * MV, 3 * MV],
    ),
    "crosstalk": (recording.Crosstalk(2, 4, 0.2), counts.Crosstalk("v3", "v5"), [0.2]),
}


def bench(name: str, effects: Sequence[hidden.Effect] = ()) -> Campaign:
    exact = {"tolerance": EXACTLY_MADE, "signals": 6, "surroundings": BAD_WEATHER}
    if name == "A":
        layout = Layout("A", nominal_a(), noise=Noise(exact=True), programme=Programme(channels="all"), **exact)
    else:
        small = Noise(0.2e-6, 1e-6, exact=True)
        together = Programme(together=4, uneven=0.5)
        ranges = (500.0,) * 3 + (30.0,) * 3
        sensor = notched(np.random.default_rng(3))
        layout = Layout("notches", sensor, ranges, noise=small, programme=together, **exact)
    return draw_campaign(layout, effects, np.random.default_rng(17))


BENCHES = {name: bench(name) for name in ("A", "notches")}


def model_of(campaign: Campaign) -> BenchModel:
    """The bench as it is, all of it exactly known; leg forces are those along elastic legs."""
    schedule, layout = campaign.schedule, campaign.layout
    elastic = theirs(layout.sensor)
    tension = elastic.axial_forces[bridges(layout)]
    rows = MV * campaign.truth.gain[:, :1] * tension
    known = KnownReadings(
        UncertainSensor(elastic.joints, elastic),
        (*CHANNELS, *(f"v{n + 1}" for n in range(layout.signals))),
        np.concatenate([layout.noise.channels, np.full(layout.signals, MV * layout.noise.signal_mv)]),
        schedule.limit,
        np.zeros(6),
        ChannelZeros(NOBODY, NOBODY, np.zeros(0), np.zeros(0, bool)),
        SignalGains(rows, np.zeros(rows.shape), True),
        layout.interferometer.wavelength,
    )
    columns = dict(zip(COLUMNS, schedule.air.T, strict=True))
    span = (float(schedule.time_s[0]), float(schedule.time_s[-1]))
    conditions = ReadingConditions(schedule.run, schedule.step, schedule.time_s, schedule.load, columns, span)
    return BenchModel(known, conditions)


MODELS = {name: model_of(campaign) for name, campaign in BENCHES.items()}


def change_of(model: BenchModel, cause: Cause, values: NDArray) -> NDArray:
    """Change of readings and signals (S, K) by a cause, SI."""
    held = model.with_causes([cause])
    shared = np.zeros(held.shared_size)
    local = np.zeros((len(model.conditions.load), held.local_size))
    before = held.points(shared, local)
    shared[held.layout[cause.key]] = values / held.effect_sigma(cause)
    return (held.points(shared, local) - before)[..., 0]


@pytest.mark.parametrize("name", BENCHES)
@pytest.mark.parametrize("case", CASES)
def test_an_effect_does_the_same_to_all_readings_and_signals(case: str, name: str) -> None:
    effect, cause, values = CASES[case]
    plain, changed = BENCHES[name], bench(name, [effect])
    signals = MV * (changed.signals - plain.signals)
    hidden_change = np.concatenate([changed.readings - plain.readings, signals], axis=1)
    if case == "crosstalk":  # offsets are carried over too, which are no one's to know
        hidden_change = hidden_change - hidden_change.mean(axis=0)
    found = change_of(MODELS[name], cause, np.asarray(values, float))
    if case == "crosstalk":
        found = found - found.mean(axis=0)
    sigma = MODELS[name].known.sigma
    size, gap = np.abs(hidden_change / sigma).max(), np.abs((found - hidden_change) / sigma).max()
    assert size > 3.0
    assert gap < max(0.1, 2e-3 * size), (size, gap)


@pytest.mark.parametrize("name", BENCHES)
def test_hysteresis_is_as_wide_and_as_high_whatever_the_form_of_its_loop(name: str) -> None:
    """The format says where a loop is widest and where it closes: between these a sine is no parabola."""
    effect = hidden.Hysteresis(FZ, 0.02)
    hidden_change = bench(name, [effect]).readings - BENCHES[name].readings
    found = change_of(MODELS[name], stiffness.Hysteresis("fz"), np.array([0.02]))[:, :6]
    assert np.abs(hidden_change).max() > 3e-7
    assert np.abs(found - hidden_change).max() < 0.2 * np.abs(hidden_change).max()


def test_a_deflection_that_drags_does_the_same_where_every_run_begins_at_rest() -> None:
    """The first bench: one run along each axis. Where runs follow each other, what they begin with is not known."""
    effect = hidden.PlayHysteresis(FZ, 0.02, 0.22)
    hidden_change = bench("A", [effect]).readings - BENCHES["A"].readings
    found = change_of(MODELS["A"], play_hysteresis.PlayHysteresis("fz", 0.22), np.array([0.02]))[:, :6]
    assert np.abs(hidden_change).max() > 1e-6
    assert np.abs(found - hidden_change).max() < 2e-3 * np.abs(hidden_change).max()
