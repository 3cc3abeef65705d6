"""One campaign from layout, effects and seed: what was recorded, and the truth behind it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tests.blind.generator.named_effect import as_record
from tests.blind.generator.quaternions import Array
from tests.blind.generator.sensor import air
from tests.blind.generator.sensor.effects import Effect, Setting
from tests.blind.generator.sensor.layout import CHANNELS, Layout
from tests.blind.generator.sensor.machine import LEGS, Errors, Machine, build, flawless
from tests.blind.generator.sensor.schedule import Schedule, plan

STREAMS = ("build", "plan", "loads", "zero", "noise", "gross", "losses", "signals")
NOMINAL_MV_PER_N = 1 / 980  # 20 mV at 2 t
SECOND_BRIDGES = (0, 3)  # legs with a bridge more, where there are eight signals
SIXTH = 1 / 6


@dataclass(frozen=True)
class Truth:
    """The truth: assembly errors and their compliance, true loads, wrenches and displacements (S, 6), gain and offset
    of the signals (C, 2)."""

    errors: Errors
    machine: Machine
    load: Array
    wrench: Array
    moved: Array
    gain: Array
    effects: tuple[Effect, ...]


@dataclass(frozen=True)
class Campaign:
    """Everything that is written down, and the truth, which is not. Readings (S, 6), m and rad, whether they were made,
    and which are grossly wrong; signals (S, C), mV.
    """

    layout: Layout
    schedule: Schedule
    given: Machine
    readings: Array
    is_observed: Array
    gross: Array
    signals: Array
    truth: Truth


def draw_campaign(layout: Layout, effects: Sequence[Effect], rng: np.random.Generator) -> Campaign:
    """Runs the chain once: schedule, drive, structure, instrument. Each step draws from a stream of its own, so that an
    effect or another noise leaves all other draws as they are.
    """
    stream = dict(zip(STREAMS, rng.spawn(len(STREAMS)), strict=True))
    schedule = plan(layout, stream["plan"])
    errors = draw_errors(layout, stream["build"])
    given = build(layout.sensor, flawless(layout.sensor))
    machine = as_made(layout, given, errors)
    gain, load = _gain(layout, stream["signals"]), _true_loads(layout, schedule, stream["loads"])
    setting = Setting(schedule, machine, layout.interferometer.wavelength)
    answered = answer(layout, load, gain, effects, setting)
    gross = _gross(schedule, layout, stream["gross"])
    own = answered.scatter * stream["noise"].normal(size=gross.shape) + _zeros(schedule, stream["zero"]) + gross
    readings = answered.readings + (0.0 if layout.noise.exact else layout.noise.channels) * own
    hiss = stream["signals"].normal(size=answered.signals.shape)
    truth = Truth(errors, machine, load, answered.wrench, answered.moved, gain, tuple(effects))
    return Campaign(
        layout=layout,
        schedule=schedule,
        given=given,
        readings=readings if layout.interferometer.compensated else _in_air(layout, schedule, readings),
        is_observed=lose(schedule, layout, stream["losses"]),
        gross=gross != 0,
        signals=answered.signals + (0.0 if layout.noise.exact else layout.noise.signal_mv) * hiss,
        truth=truth,
    )


@dataclass(frozen=True)
class Answer:
    """Response without noise: wrench, displacement and readings (S, 6), the factors of their noise, and signals (S, C),
    mV."""

    wrench: Array
    moved: Array
    readings: Array
    scatter: Array
    signals: Array


def as_made(layout: Layout, machine: Machine, errors: Errors) -> Machine:
    """The sensor as made, of the ``machine`` as designed; a compliance that was given is off as a whole."""
    if layout.compliance_given:
        return Machine(machine.legs, machine.compliance * errors.softer[0, 0], machine.tension)
    return build(layout.sensor, errors)


def answer(layout: Layout, load: Array, gain: Array, effects: Sequence[Effect], setting: Setting) -> Answer:
    """Response of a machine to true loads (S, 6); ``gain``: gain and offset of its signals (C, 2)."""
    machine = setting.machine
    wrench = load[:, :, None] * np.eye(6)
    for effect in effects:
        wrench = effect.drive(wrench, setting)
    deflection = wrench @ machine.compliance.T
    for effect in effects:
        deflection = effect.structure(deflection, setting)
    moved = deflection.sum(axis=1)
    readings, scatter = moved, np.ones(moved.shape)
    for effect in effects:
        readings = effect.instrument(readings, moved, setting)
        scatter = effect.scatter(scatter, setting)
    tension = (wrench.sum(axis=1) @ machine.tension.T)[:, bridges(layout)]
    signals = gain[:, 0] * tension + gain[:, 1]
    for effect in effects:
        signals = effect.electric(signals, setting)
    return Answer(wrench.sum(axis=1), moved, readings, scatter, signals)


def draw_errors(layout: Layout, rng: np.random.Generator) -> Errors:
    """Lengths with a sixth of the tolerance's width as sigma, and elastic parameters partly alike in all legs."""
    known = layout.tolerance
    widths = (
        known.platform_radius,
        known.base_radius,
        known.lower_clearance,
        known.middle_clearance,
        known.sensor_installation,
    )
    lengths = [SIXTH * width * rng.normal(size=LEGS) for width in widths]
    alike, own = rng.normal(size=layout.sensor.elastic), rng.normal(size=(LEGS, layout.sensor.elastic))
    softer = np.exp(known.stiffness * (np.sqrt(known.common) * alike + np.sqrt(1 - known.common) * own))
    return Errors(*lengths, softer)


def _true_loads(layout: Layout, schedule: Schedule, rng: np.random.Generator) -> Array:
    """Loads as they are: those that are applied at all differ from what is declared by the load's noise."""
    off = np.array([layout.noise.force] * 3 + [layout.noise.torque] * 3) * (not layout.noise.exact)
    return schedule.load + np.where(schedule.load != 0, off * rng.normal(size=schedule.load.shape), 0.0)


def _zeros(schedule: Schedule, rng: np.random.Generator) -> Array:
    """The zero's own error (S, 6): one draw per run and channel."""
    return rng.normal(size=(schedule.run[-1], 6))[schedule.run - 1]


def _gross(schedule: Schedule, layout: Layout, rng: np.random.Generator) -> Array:
    """Gross errors (S, 6) in sigmas, 0 where there is none."""
    low, high = np.log(layout.faults.gross_sigma)
    hit = rng.random(schedule.load.shape) < layout.faults.gross_share
    size = np.exp(rng.uniform(low, high, hit.shape)) * rng.choice([-1.0, 1.0], hit.shape)
    return np.where(hit, size, 0.0)


def lose(schedule: Schedule, layout: Layout, rng: np.random.Generator) -> Array:
    """Mask of the readings (S, 6) that exist: of measured channels, and lost neither alone nor with their step."""
    lost = rng.random(schedule.load.shape) < layout.faults.missing_share
    steps = rng.random(len(schedule.run)) < layout.faults.missing_steps
    return schedule.watched & ~lost & ~steps[:, None]


def _in_air(layout: Layout, schedule: Schedule, readings: Array) -> Array:
    """Readings as counted in wavelengths of vacuum; the dead path stretches with the air."""
    n = air.index(schedule.air)
    stretched = (n - n[schedule.first]) * layout.interferometer.dead_path
    return n[:, None] * readings + stretched[:, None] * (np.arange(6) < 3)


def _gain(layout: Layout, rng: np.random.Generator) -> Array:
    """Gain (mV/N) and offset (mV) of each signal (C, 2)."""
    gain = NOMINAL_MV_PER_N * rng.uniform(0.7, 1.4, layout.signals)
    return np.stack([gain, rng.uniform(-2.0, 2.0, layout.signals)], axis=1)


def bridges(layout: Layout) -> Array:
    """The leg (C,) whose tension each signal shows."""
    return np.array([*range(LEGS), *SECOND_BRIDGES][: layout.signals], int)


def truth_record(campaign: Campaign, seed: int) -> dict[str, object]:
    """The truth as plain values, for the file next to the campaign folder."""
    truth, schedule, noise = campaign.truth, campaign.schedule, campaign.layout.noise
    rows, columns = np.nonzero(campaign.gross & campaign.is_observed)
    errors = {name: (1e6 * value).tolist() for name, value in vars(truth.errors).items() if name != "softer"}
    return {
        "seed": seed,
        "effects": [as_record(effect) for effect in truth.effects],
        "noise": {"linear_um": 1e6 * noise.linear, "angular_rad": noise.angular, "signal_mv": noise.signal_mv},
        "legs": LEGS,
        "errors_um": errors,
        "softer": truth.errors.softer.tolist(),
        "compliance": truth.machine.compliance.tolist(),
        "gain_mv_per_n": truth.gain[:, 0].tolist(),
        "offset_mv": truth.gain[:, 1].tolist(),
        "gross_errors": [
            [int(schedule.run[n]), int(schedule.step[n]), CHANNELS[k]] for n, k in zip(rows, columns, strict=True)
        ],
    }
