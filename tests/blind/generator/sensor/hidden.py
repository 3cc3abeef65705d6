"""Effects drawn at random: load, channel, run or signal, and shape; `strength` sets their size.

Of size 1 each is about as large as a laboratory meets it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from tests.blind.generator.sensor import effects, foreign, recording, strange, unforeseen
from tests.blind.generator.sensor.campaign import Campaign
from tests.blind.generator.sensor.effects import Effect, Elastic
from tests.blind.generator.sensor.layout import AXES
from tests.blind.generator.sensor.recording import across

OfSize = Callable[[float], Effect]
Draw = Callable[[Campaign, np.random.Generator], OfSize]
EITHER_SIDE = 3  # steps that show a slip, before it and after it
HOUR_S = 3600.0


@dataclass(frozen=True)
class Kind:
    """A kind of effect: its draw for a campaign, and its requirements on the campaign (see ``draw_plan``)."""

    draw: Draw
    needs: frozenset[str] = frozenset()


def _axis(campaign: Campaign, rng: np.random.Generator) -> int:
    return AXES.index(str(rng.choice(campaign.schedule.axes)))


def _channel(campaign: Campaign, rng: np.random.Generator, first: int = 6) -> int:
    """A channel that is watched, of the ``first`` ones."""
    return int(rng.choice(np.flatnonzero(campaign.is_observed.any(axis=0)[:first])))


def _noise(campaign: Campaign, channel: int) -> float:
    return float(campaign.layout.noise.channels[channel])


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _eccentric(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    axis = _axis(campaign, rng)
    way = np.array(across(axis % 3, float(rng.uniform(-np.pi, np.pi))))
    if axis >= 3:
        way = rng.normal(size=3) / 0.5  # forces in N for torques in N m: some 5 mm of 1 m
    size_of = float(np.abs(campaign.layout.sensor.upper_mm).max()) / 1e3
    unit = 0.01 * size_of if axis < 3 else 0.01 / size_of
    return lambda size: effects.LoadEccentricity(axis, tuple((size * unit * way).tolist()))


def _imbalanced(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    """An imbalance that differs between pushing and pulling or grows with the load; half of the draws add a constant
    ratio."""
    axis = _axis(campaign, rng)
    size_of = float(np.abs(campaign.layout.sensor.upper_mm).max()) / 1e3
    across_to = [k for k in range(3) if k != axis % 3]
    places = rng.choice(across_to, int(rng.integers(1, 3)), replace=False) + (3 if axis < 3 else 0)
    pattern = np.zeros(6)
    pattern[places] = rng.choice([-1.0, 1.0], len(places)) * rng.uniform(0.5, 1.5, len(places))
    pattern *= 0.01 * size_of if axis < 3 else 0.01 / size_of
    ratio = (0.5 if rng.random() < 0.5 else 0.0) * _sign(rng) * pattern
    grows = rng.random() < 0.25
    none = np.zeros(6)

    def of_size(size: float) -> Effect:
        parts = (ratio, none, pattern) if grows else (ratio, pattern, none)
        return effects.LoadImbalance(axis, *(tuple((size * part).tolist()) for part in parts))

    return of_size


def _elastic(kind: type[Elastic], unit: float, *, either: bool = True) -> Draw:
    def draw(campaign: Campaign, rng: np.random.Generator) -> OfSize:
        axis, along_only = _axis(campaign, rng), bool(rng.random() < 0.3)
        amount = unit * (_sign(rng) if either else 1.0)
        return lambda size: kind(axis, size * amount, along_only)

    return draw


def _soft(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    leg, sign = int(rng.integers(len(AXES))), _sign(rng)
    return lambda size: effects.LegStiffness(leg, float(np.expm1(0.1 * sign * size)))


def _play(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    axis = _axis(campaign, rng)
    return lambda size: effects.JointClearance(axis, size * 3 * _noise(campaign, axis))


def _dragging(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    axis, threshold = _axis(campaign, rng), float(rng.uniform(0.06, 0.25))
    return lambda size: effects.PlayHysteresis(axis, 0.005 * size, threshold)


def _creeping(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    axes = (_axis(campaign, rng),) if rng.random() < 0.6 else tuple(range(6))
    tau = float(np.exp(rng.uniform(np.log(0.7), np.log(6.0))) * campaign.layout.programme.pause_s)
    return lambda size: effects.Creep(axes, 0.02 * size, tau)


def _noisy(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    run = int(rng.choice(np.unique(campaign.schedule.run)))
    read = np.flatnonzero(campaign.is_observed[campaign.schedule.run == run].any(axis=0))
    return lambda size: recording.NoisyRun(run, 1 + size, int(read[0]) if len(read) == 1 else None)


def _drifting(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    channel, sign = _channel(campaign, rng), _sign(rng)
    run = None
    if campaign.layout.programme.channels != "all" and rng.random() < 0.4:
        run = int(rng.choice(np.unique(campaign.schedule.run[campaign.is_observed[:, channel]])))
    rate = 10 * sign * _noise(campaign, channel) / HOUR_S
    return lambda size: recording.ZeroDrift(channel, size * rate, run)


def _thermal(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    channel, sign = _channel(campaign, rng), _sign(rng)
    material, of_air = ((1.0, 0.0), (0.0, 1.0), (1.0, 0.6))[rng.choice(3, p=[0.45, 0.45, 0.1])]
    per_k = 20 * sign * _noise(campaign, channel)
    return lambda size: recording.ThermalDrift(channel, size * per_k * material, size * per_k * of_air)


def _askew(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    channel = _channel(campaign, rng)
    aside = across(channel, float(rng.uniform(-np.pi, np.pi)))
    return lambda size: recording.CosineError(channel, 0.01 * size, aside)


def _arm(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    channel = _channel(campaign, rng, 3)
    way = 0.01 * np.array(across(channel, float(rng.uniform(-np.pi, np.pi))))
    return lambda size: recording.AbbeOffset(channel, tuple((size * way).tolist()))


def _dead(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    channel = _channel(campaign, rng, 3)
    return lambda size: recording.DeadPath(channel, 0.2 * size)


def _slipped(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    schedule, sign = campaign.schedule, _sign(rng)
    while True:
        channel, run = _channel(campaign, rng, 3), int(rng.integers(1, schedule.run[-1] + 1))
        shown = schedule.step[(schedule.run == run) & campaign.is_observed[:, channel]]
        if len(shown) > 2 * EITHER_SIDE:
            break
    start = int(rng.choice(shown[EITHER_SIDE:-EITHER_SIDE]))
    alone = not np.any(np.delete(schedule.watched[schedule.run == run], channel, axis=1))
    return lambda size: recording.FringeSlip(channel, run, alone, int(sign) * max(round(5 * size), 1), start)


def _knocked(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    """One rotation, one signal, or all of either sort, in a run that shows enough of them on either side."""
    schedule, noise, signals = campaign.schedule, campaign.layout.noise, campaign.layout.signals
    of_signals, alone = bool(signals and rng.random() < 0.5), bool(rng.random() < 0.6)
    count = signals if of_signals else len(AXES)
    unit = np.full(signals, noise.signal_mv) if of_signals else noise.channels
    chosen = np.ones(count, bool)
    if alone:
        chosen = np.arange(count) == (rng.integers(count) if of_signals else _channel_of_six(campaign, rng))
    shown = np.ones(len(schedule.run), bool) if of_signals else campaign.is_observed[:, chosen].all(axis=1)
    runs = [run for run in np.unique(schedule.run) if np.sum(shown & (schedule.run == run)) > 2 * EITHER_SIDE]
    if not runs:
        raise ValueError("no run shows a step of the zero")
    run = int(rng.choice(runs))
    start = int(rng.choice(schedule.step[shown & (schedule.run == run)][EITHER_SIDE:-EITHER_SIDE]))
    pattern = 5 * unit * chosen * rng.choice([-1.0, 1.0], count) * rng.uniform(0.5, 1.5, count)

    def of_size(size: float) -> Effect:
        moved = tuple((size * pattern).tolist())
        return recording.ZeroStep(run, start, *(((), moved) if of_signals else (moved, ())))

    return of_size


def _channel_of_six(campaign: Campaign, rng: np.random.Generator) -> int:
    """A measured rotation: a jump of a displacement alone could be slipped fringes."""
    return int(rng.choice([k for k in range(3, len(AXES)) if campaign.is_observed[:, k].any()]))


def _talking(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    one, other = rng.choice(len(AXES), 2, replace=False).tolist()  # not a second bridge: nobody knows what that shows
    fraction = 0.005 * _sign(rng)
    return lambda size: recording.Crosstalk(one, other, size * fraction)


def _bent(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    """A bridge of its own, not a second one; by its own powers, or by squares and products of all loads."""
    signal, sign = int(rng.integers(0, len(AXES))), _sign(rng)
    if rng.random() < 0.4:
        coupled = np.triu(rng.normal(size=(len(AXES), len(AXES)))) * campaign.layout.noise.signal_mv
        return lambda size: recording.SignalNonlinear(signal, coupled=tuple(map(tuple, (3 * size * coupled).tolist())))
    quadratic, cubic = ((1.0, 0.0), (0.0, 1.0), (1.0, 0.7))[rng.integers(3)]
    largest = float(np.ptp(campaign.signals[:, signal]))
    unit = (0.005 * sign * quadratic / largest, 0.005 * sign * cubic / largest**2)
    return lambda size: recording.SignalNonlinear(signal, size * unit[0], size * unit[1])


def _exchanged(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    """Of whatever size: two steps with different loads."""
    schedule = campaign.schedule
    run = int(rng.integers(1, schedule.run[-1] + 1))
    steps = np.flatnonzero(schedule.run == run)
    while True:
        one, other = sorted(rng.choice(steps, 2, replace=False).tolist())
        if np.any(schedule.load[one] != schedule.load[other]):
            break
    pair = (int(schedule.step[one]), int(schedule.step[other]))
    return lambda size: recording.RowsExchanged(run, pair)


CATALOGUE: Mapping[str, Kind] = {
    "load-eccentricity": Kind(_eccentric, frozenset({"six"})),
    "load-imbalance": Kind(_imbalanced, frozenset({"six", "both"})),
    "stiffness-scale": Kind(_elastic(effects.StiffnessScale, 0.02)),
    "stiffness-asymmetry": Kind(_elastic(effects.StiffnessAsymmetry, 0.01), frozenset({"both"})),
    "stiffness-nonlinear": Kind(_elastic(effects.StiffnessNonlinear, 0.01)),
    "leg-stiffness": Kind(_soft, frozenset({"six"})),
    "hysteresis": Kind(_elastic(effects.Hysteresis, 0.005, either=False)),
    "play-hysteresis": Kind(_dragging, frozenset({"both"})),
    "joint-clearance": Kind(_play, frozenset({"both"})),
    "creep": Kind(_creeping, frozenset({"uneven"})),
    "zero-drift": Kind(_drifting),
    "thermal-drift": Kind(_thermal, frozenset({"weather"})),
    "cosine-error": Kind(_askew, frozenset({"six"})),
    "abbe-offset": Kind(_arm, frozenset({"six"})),
    "dead-path": Kind(_dead, frozenset({"weather"})),
    "fringe-slip": Kind(_slipped),
    "zero-step": Kind(_knocked, frozenset({"six"})),
    "noise-burst": Kind(_noisy),
    "crosstalk": Kind(_talking, frozenset({"signals"})),
    "signal-nonlinear": Kind(_bent, frozenset({"signals"})),
    "rows-exchanged": Kind(_exchanged, frozenset({"signals"})),
}


def _own_or_any(campaign: Campaign, axis: int, rng: np.random.Generator) -> int:
    """A channel that is watched while the axis is loaded."""
    loaded = campaign.schedule.load[:, axis] != 0
    return int(rng.choice(np.flatnonzero(campaign.is_observed[loaded].any(axis=0))))


def _of_load(kind: type[strange.StrangeOfLoad], *, across_it: bool = False) -> Draw:
    """Of a load along any axis; ``across_it`` not in its own component, where it would be a stiffness."""

    def draw(campaign: Campaign, rng: np.random.Generator) -> OfSize:
        axis, sign = _axis(campaign, rng), _sign(rng)
        channel = _own_or_any(campaign, axis, rng)
        while across_it and channel == axis:
            axis, channel = _axis(campaign, rng), _channel(campaign, rng)
        return lambda size: kind(channel, size * 3 * sign * _noise(campaign, channel), axis)

    return draw


def _of_channel(make: Callable[[int, float, Campaign, np.random.Generator], OfSize], first: int = 6) -> Draw:
    def draw(campaign: Campaign, rng: np.random.Generator) -> OfSize:
        channel = _channel(campaign, rng, first)
        return make(channel, 3 * _sign(rng) * _noise(campaign, channel), campaign, rng)

    return draw


def _product(channel: int, unit: float, campaign: Campaign, rng: np.random.Generator) -> OfSize:
    first, second = sorted(rng.choice(len(AXES), 2, replace=False).tolist())
    return lambda size: strange.LoadProduct(channel, size * unit, (first, second))


def _humidity(channel: int, unit: float, campaign: Campaign, rng: np.random.Generator) -> OfSize:
    return lambda size: strange.FollowsColumn(channel, size * unit, "relative_humidity_pct")


def _pressure(channel: int, unit: float, campaign: Campaign, rng: np.random.Generator) -> OfSize:
    return lambda size: strange.FollowsColumn(channel, size * unit, "air_pressure_hpa")


def _breathing(channel: int, unit: float, campaign: Campaign, rng: np.random.Generator) -> OfSize:
    """Six to twenty-five steps a period."""
    period = float(rng.uniform(6.0, 25.0) * campaign.layout.programme.pause_s)
    phase = float(rng.uniform(-np.pi, np.pi))
    return lambda size: strange.Breathes(channel, size * unit, period, phase)


def _lunch(channel: int, unit: float, campaign: Campaign, rng: np.random.Generator) -> OfSize:
    tau = float(rng.uniform(2.0, 5.0) * campaign.layout.programme.pause_s)
    return lambda size: strange.SettlesAfterLunch(channel, size * unit, tau)


def _subfringe(channel: int, unit: float, campaign: Campaign, rng: np.random.Generator) -> OfSize:
    phase = float(rng.uniform(-np.pi, np.pi))
    return lambda size: strange.InterpolationError(channel, size * abs(unit), phase)


def _trembling(channel: int, unit: float, campaign: Campaign, rng: np.random.Generator) -> OfSize:
    return lambda size: strange.NoisyChannel(channel, size)


def _growing_noise(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    axis = _axis(campaign, rng)
    return lambda size: strange.NoiseGrows(size, axis)


WEATHER = frozenset({"weather"})
STRANGE: Mapping[str, Kind] = {
    "a joint slips beyond half load": Kind(_of_load(strange.JointSlips)),
    "platform bulges under a load": Kind(_of_load(strange.Bulges, across_it=True), frozenset({"both", "six"})),
    "mount settles under the largest load": Kind(_of_load(strange.SettlesForGood)),
    "load of two steps before": Kind(_of_load(strange.Remembers)),
    "product of two loads": Kind(_of_channel(_product), frozenset({"together"})),
    "channel follows humidity": Kind(_of_channel(_humidity), WEATHER),
    "channel follows pressure": Kind(_of_channel(_pressure), WEATHER),
    "load cell warms": Kind(_of_load(strange.LoadCellWarms), WEATHER),
    "channel breathes": Kind(_of_channel(_breathing)),
    "settles after lunch": Kind(_of_channel(_lunch), frozenset({"lunch"})),
    "interpolation error": Kind(_of_channel(_subfringe, 3)),
    "a channel trembles": Kind(_of_channel(_trembling)),
    "noise grows with load": Kind(_growing_noise),
}


def _at_a_stop(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    axis, sign = _axis(campaign, rng), _sign(rng)
    channel, x = _own_or_any(campaign, axis, rng), campaign.schedule.load[:, axis]
    way = sign if x.min() < 0 < x.max() else float(np.sign(x[np.argmax(np.abs(x))]))
    unit = 3 * _sign(rng) * _noise(campaign, channel)
    return lambda size: unforeseen.TouchesAStop(channel, size * unit, axis, way)


def _bimetal(channel: int, unit: float, campaign: Campaign, rng: np.random.Generator) -> OfSize:
    return lambda size: unforeseen.BendsWithWarmth(channel, size * unit)


def _restless(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    start = float(rng.uniform(0.0, 1.0 - unforeseen.RestlessHours.LASTS))
    return lambda size: unforeseen.RestlessHours(size, start)


UNFORESEEN: Mapping[str, Kind] = {
    "touches a stop": Kind(_at_a_stop),
    "sticks in the middle": Kind(_of_load(unforeseen.SticksInTheMiddle)),
    "seats in contact": Kind(_of_load(unforeseen.SeatsInContact, across_it=True), frozenset({"six"})),
    "tires": Kind(_of_load(unforeseen.Tires)),
    "belt in humid air": Kind(_of_load(unforeseen.BeltInHumidAir), WEATHER),
    "bends with warmth": Kind(_of_channel(_bimetal), WEATHER),
    "restless hours": Kind(_restless),
}
FOREIGN: Mapping[str, Kind] = {name: Kind(draw) for name, draw in foreign.FOREIGN.items()}
# Those that joined the catalogue after the campaigns of the page were drawn: they are drawn by themselves, so that a
# seed and a number stay the campaign that the page tells of.
ADDED = frozenset({"leg-stiffness", "noise-burst", "play-hysteresis", "signal-nonlinear", "zero-step"})
KINDS: Mapping[str, Kind] = {**CATALOGUE, **STRANGE, **UNFORESEEN, **FOREIGN}

# Of two effects of a family one holds the other, or what is left of it when the other is there: two of them are one.
FAMILIES = (
    frozenset({"load-eccentricity", "load-imbalance"}),
    frozenset({"stiffness-scale", "cosine-error"}),
    frozenset({"zero-drift", "thermal-drift", "dead-path"}),
)


def draw_two(rng: np.random.Generator) -> tuple[str, str]:
    """Two effects of the catalogue that are no more than each other."""
    while True:
        first, second = rng.choice(sorted(set(CATALOGUE) - ADDED), 2, replace=False).tolist()
        if not any({first, second} <= family for family in FAMILIES):
            return first, second
