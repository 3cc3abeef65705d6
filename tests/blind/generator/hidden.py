"""Effects drawn at random: legs or target, input, and shape; `strength` sets their size."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from tests.blind.generator import foreign, strange
from tests.blind.generator.campaign import Campaign
from tests.blind.generator.effects import (
    ActuatorGain,
    ActuatorZeroShift,
    ApproachScatter,
    Backlash,
    BaseDeformation,
    BodyJump,
    Effect,
    FlexureShift,
    GravitySag,
    InPlaneDeformation,
    LegCompliance,
    LegDrift,
    LegThermal,
    LinearDeformation,
    MatrixDeformation,
    MeasurementScale,
    NoiseBurst,
    NonlinearDeformation,
    PeriodicError,
    TargetMoved,
    TargetsSwapped,
    ThermalExpansion,
    approach,
)
from tests.blind.generator.quaternions import Array, unit

OfSize = Callable[[float], Effect]
EITHER_SIDE = 4  # poses that show a moved target, before its move and after it


@dataclass(frozen=True)
class Kind:
    """A kind of effect: its draw for a campaign, and its requirements on the campaign (see ``draw_plan``)."""

    draw: Callable[[Campaign, np.random.Generator], OfSize]
    needs: frozenset[str] = frozenset()
    mechanisms: tuple[str, ...] = ("6-pus", "ups")


def _legs(campaign: Campaign, rng: np.random.Generator) -> Array:
    """Amounts (L,) near one and of either sign, zero where a leg is spared: all, one, or some legs."""
    count = campaign.readings.shape[1]
    concerned = int(rng.choice([count, count, count, 1, 1, 1, 2, 2, 3]))
    chosen = np.isin(np.arange(count), rng.choice(count, concerned, replace=False))
    common = rng.choice([-1.0, 1.0]) if rng.random() < 0.5 else rng.choice([-1.0, 1.0], count)
    return np.where(chosen, common * rng.uniform(0.7, 1.3, count), 0.0)


def _stroke(campaign: Campaign) -> float:
    return float(np.abs(campaign.truth.drho).max())


def _in_time(campaign: Campaign, *targets: int) -> list[int]:
    """Rows of the poses that are fitted and show the targets, in time order."""
    role = np.array(campaign.schedule.role)
    shown = campaign.record.is_observed[:, list(targets)] & ~campaign.record.gross[:, list(targets)]
    usable = (role != "verification") & shown.all(axis=1)
    return [n for n in np.argsort(campaign.schedule.time_s) if usable[n]]


def _linear(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    amount = _legs(campaign, rng) / _stroke(campaign)
    return lambda size: LinearDeformation(size * amount)


def _matrix(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    legs = campaign.readings.shape[1]
    pattern = rng.normal(size=(legs, legs)) / _stroke(campaign)
    return lambda size: MatrixDeformation(size * pattern)


def _nonlinear(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    """Curved, or bent more at the ends, with some slope: at the stroke's end the bend is of the size asked for."""
    amount, stroke = _legs(campaign, rng), _stroke(campaign)
    slope = rng.uniform(0.1, 0.5)
    curved, cubic = ((1.0, 0.0), (0.0, 1.0))[rng.integers(2)]
    shapes = slope * amount / stroke, curved * amount / stroke**2, cubic * amount / stroke**3
    return lambda size: NonlinearDeformation(*(size * shape for shape in shapes))


def _in_plane(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    """Each leg concerned towards somewhere else in the platform's plane."""
    amount = _legs(campaign, rng) / _stroke(campaign)
    towards = rng.uniform(-np.pi, np.pi, len(amount))
    return lambda size: InPlaneDeformation(size * amount * np.cos(towards), size * amount * np.sin(towards))


def _compliance(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    """All legs alike, one of them, or two."""
    weight, count = campaign.layout.weight, campaign.readings.shape[1]
    assert weight is not None
    concerned = int(rng.choice([count, count, 1, 1, 2]))
    chosen = np.isin(np.arange(count), rng.choice(count, concerned, replace=False))
    own = np.where(chosen, 1.0 if concerned == count else rng.uniform(0.7, 1.3, count), 0.0)
    reported = campaign.schedule.further.get("payload_kg")
    masses = np.full(len(campaign.readings), weight.mass_kg) if reported is None else reported
    return lambda size: LegCompliance(size * own, masses, np.array(weight.centre_mm), np.array(weight.up))


def _sagging(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    """Every target of the platform by its own, or one of them."""
    weight, marks = campaign.layout.weight, campaign.marks
    assert weight is not None
    names = [marks.name[k] for k in marks.of("platform")]
    chosen = names if rng.random() < 0.5 else [str(rng.choice(names))]
    sags = rng.normal(size=len(chosen)) if len(chosen) > 1 else np.ones(1)
    up = np.array(weight.up)
    return lambda size: GravitySag(tuple(zip(chosen, (size * sags).tolist(), strict=True)), up)


def _thermal(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    if rng.random() < 0.4:
        return lambda size: ThermalExpansion(size, size, size)
    base, platform, legs = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 1.8, 3)
    return lambda size: ThermalExpansion(size * base, size * platform, size * legs)


def _leg_thermal(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    """All legs alike, or one of them, or two."""
    sign, count = rng.choice([-1.0, 1.0]), campaign.readings.shape[1]
    concerned = int(rng.choice([count, count, 1, 1, 2]))
    chosen = np.isin(np.arange(count), rng.choice(count, concerned, replace=False))
    own = np.where(chosen, sign if concerned == count else sign * rng.uniform(0.7, 1.3, count), 0.0)
    return lambda size: LegThermal(size * own)


def _base(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    driver = "temperature" if rng.random() < 0.5 else f"rho{rng.integers(1, campaign.readings.shape[1] + 1)}"
    pattern = unit(rng.normal(size=3))
    return lambda size: BaseDeformation(driver, *(float(size * value) for value in pattern))


def _gain(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    amount = _legs(campaign, rng) / _stroke(campaign)
    return lambda size: ActuatorGain(size * amount)


def _backlash(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    amount = np.abs(_legs(campaign, rng))
    return lambda size: Backlash(size * amount)


def _zero_shift(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    """One actuator, or all of them by amounts of either sign."""
    rows, count = _in_time(campaign), campaign.readings.shape[1]
    pose = campaign.schedule.pose[rows[int(rng.integers(EITHER_SIDE, len(rows) - EITHER_SIDE + 1))]]
    amount = rng.choice([-1.0, 1.0], count) * rng.uniform(0.3, 1.3, count)
    if rng.random() < 0.7:
        amount = np.where(np.arange(count) == rng.integers(count), np.sign(amount), 0.0)
    return lambda size: ActuatorZeroShift(size * amount, pose)


def _periodic(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    amount = np.abs(_legs(campaign, rng))
    pitch = campaign.layout.actuator_pitch_mm or float(rng.uniform(0.25, 0.5) * min(_stroke(campaign), 8.0))
    phase = rng.uniform(-np.pi, np.pi, len(amount))
    return lambda size: PeriodicError(size * amount, pitch, phase)


def _drift(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    amount = _legs(campaign, rng)
    tau = float(rng.uniform(0.08, 0.4) * np.ptp(campaign.schedule.time_s)) if rng.random() < 0.5 else None
    return lambda size: LegDrift(size * amount, tau)


def _landing(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    """All actuators for a while, or one of them, or all that come from one side."""
    draws, reported, subject = rng.normal(size=campaign.truth.drho.shape), (), ""
    which = rng.integers(3)
    if which == 0:
        own, reported = _for_a_while(campaign, rng)
        draws *= own[:, None]
    elif which == 1:
        leg = int(rng.integers(draws.shape[1]))
        draws *= np.arange(draws.shape[1]) == leg
        subject = f"leg{leg + 1}"
    else:
        came = approach(campaign.truth.drho, campaign.schedule, 5 * campaign.layout.noise.actuator_mm)
        draws *= came == rng.choice([-1, 1])
    return lambda size: ApproachScatter(size, draws, subject, reported)


def _for_a_while(campaign: Campaign, rng: np.random.Generator) -> tuple[Array, tuple[tuple[str, int], ...]]:
    """Poses (N,) that follow each other, a fifth to two fifths of all, and the first and the last by name."""
    rows, rank = _in_time(campaign), campaign.schedule.rank
    length = int(rng.uniform(0.2, 0.4) * len(rows))
    first = int(rng.integers(len(rows) - length + 1))
    ends = rows[first], rows[first + length - 1]
    own = (rank >= rank[ends[0]]) & (rank <= rank[ends[1]])
    names = (campaign.schedule.pose[end] for end in ends)
    return own, tuple(zip(("from_pose", "to_pose"), names, strict=True))


def _burst(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    own, reported = _for_a_while(campaign, rng)
    return lambda size: NoiseBurst(1 + size, own, reported)


def _flexure(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    return FlexureShift


def _scale(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    sign = rng.choice([-1.0, 1.0])
    if rng.random() < 0.5:
        return lambda size: MeasurementScale(scale=size * sign)
    return lambda size: MeasurementScale(scale_per_k=size * sign)


def _moved(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    marks = campaign.marks
    while True:
        k = int(rng.integers(len(marks.name)))
        rows = _in_time(campaign, k)[EITHER_SIDE:-EITHER_SIDE]
        if rows:
            break
    start = campaign.schedule.pose[rng.choice(rows)]
    way = unit(rng.normal(size=3))
    return lambda size: TargetMoved(marks.body[k], marks.name[k], tuple((size * way).tolist()), start)


def _remounted(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    """Platform or base, shifted and turned by as much as its outer targets shift."""
    body, rows = str(rng.choice(["platform", "base"])), _in_time(campaign)
    pose = campaign.schedule.pose[rows[int(rng.integers(EITHER_SIDE, len(rows) - EITHER_SIDE + 1))]]
    places = campaign.marks.place[list(campaign.marks.of(body))]
    radius = float(np.linalg.norm(places - places.mean(axis=0), axis=1).max())
    shift, turn = unit(rng.normal(size=3)), unit(rng.normal(size=3)) / radius
    return lambda size: BodyJump(body, tuple((size * shift).tolist()), tuple((size * turn).tolist()), pose)


def _swapped(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    """Of whatever size: how far two targets lie apart is not to be chosen."""
    marks = campaign.marks
    body = rng.choice(sorted(set(marks.body)))
    first, second = sorted(rng.choice(marks.of(body), 2, replace=False).tolist())
    rows = _in_time(campaign, first, second)
    chosen = rng.choice(rows, min(int(rng.integers(1, 7)), len(rows)), replace=False)
    poses = tuple(sorted(campaign.schedule.pose[n] for n in chosen))
    return lambda size: TargetsSwapped(str(body), (marks.name[first], marks.name[second]), poses)


CATALOGUE: Mapping[str, Kind] = {
    "platform-deformation-linear": Kind(_linear),
    "platform-deformation-matrix": Kind(_matrix),
    "platform-deformation-nonlinear": Kind(_nonlinear, frozenset({"even"})),
    "in-plane-deformation": Kind(_in_plane),
    "thermal-expansion": Kind(_thermal),
    "base-deformation": Kind(_base),
    "actuator-gain": Kind(_gain),
    "actuator-backlash": Kind(_backlash),
    "actuator-periodic-error": Kind(_periodic, frozenset({"even"})),
    "actuator-zero-shift": Kind(_zero_shift),
    "approach-scatter": Kind(_landing),
    "noise-burst": Kind(_burst),
    "leg-drift": Kind(_drift),
    "leg-thermal": Kind(_leg_thermal),
    "leg-compliance": Kind(_compliance, frozenset({"weighed"})),
    "gravity-sag": Kind(_sagging, frozenset({"upright"}), ("ups",)),
    "flexure-shift": Kind(_flexure, frozenset({"even", "wide"}), ("6-pus",)),
    "measurement-scale": Kind(_scale),
    "target-moved": Kind(_moved),
    "body-jump": Kind(_remounted),
    "targets-swapped": Kind(_swapped),
}


def _follows_humidity(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    amount = _legs(campaign, rng)
    return lambda size: strange.ReadingsFollow(size * amount, "humidity_pct")


def _coupled(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    amount = _legs(campaign, rng)
    return lambda size: strange.CrossCoupling(size * amount)


def _product(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    amount = _legs(campaign, rng)
    first, second = sorted(rng.choice(len(amount), 2, replace=False).tolist())
    return lambda size: strange.DriveProduct(size * amount, (first + 1, second + 1))


def _attachments_follow(column: str) -> Callable[[Campaign, np.random.Generator], OfSize]:
    def draw(campaign: Campaign, rng: np.random.Generator) -> OfSize:
        amount = _legs(campaign, rng)
        return lambda size: strange.AttachmentsFollow(size * amount, column)

    return draw


def _time_of_day(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    """One to two and a half periods within the campaign."""
    amount = _legs(campaign, rng)
    period = float(np.ptp(campaign.schedule.time_s) / rng.uniform(1.0, 2.5))
    phase = float(rng.uniform(-np.pi, np.pi))
    return lambda size: strange.TimeOfDay(size * amount, period, phase)


def _memory(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    amount, kept = np.abs(_legs(campaign, rng)), float(rng.uniform(0.2, 0.6))
    return lambda size: strange.FadingMemory(size * amount, kept)


def _sticking(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    amount, limit = np.abs(_legs(campaign, rng)), float(rng.uniform(0.0, 0.4))
    return lambda size: strange.Sticking(size * amount, limit)


def _warming(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    amount = _legs(campaign, rng)
    return lambda size: strange.WarmingScrew(size * amount)


def _refracting(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    sign = rng.choice([-1.0, 1.0])
    return lambda size: strange.RefractingAir(size * sign)


def _wandering(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    k, way = _any_target(campaign, rng), unit(rng.normal(size=3))
    body, name = campaign.marks.body[k], campaign.marks.name[k]
    return lambda size: strange.WanderingTarget(body, name, tuple((size * way).tolist()), "temperature_c")


def _any_target(campaign: Campaign, rng: np.random.Generator) -> int:
    return int(rng.integers(len(campaign.marks.name)))


def _growing_noise(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    return lambda size: strange.GrowingNoise(size, "temperature_c")


def _vibrating(campaign: Campaign, rng: np.random.Generator) -> OfSize:
    k = _any_target(campaign, rng)
    return lambda size: strange.VibratingTarget(campaign.marks.body[k], campaign.marks.name[k], 1 + size)


STRANGE: Mapping[str, Kind] = {
    "readings follow humidity": Kind(_follows_humidity, frozenset({"humidity_pct"})),
    "neighbouring actuators coupled": Kind(_coupled, frozenset({"even"})),
    "product of two drives": Kind(_product, frozenset({"even"})),
    "platform bends under a load": Kind(_attachments_follow("load_n"), frozenset({"load_n"})),
    "platform creeps": Kind(_attachments_follow("time_s")),
    "legs breathe with the time of day": Kind(_time_of_day),
    "hysteresis with memory": Kind(_memory, frozenset({"even"})),
    "an actuator sticks": Kind(_sticking, frozenset({"even"})),
    "leadscrews warm": Kind(_warming, frozenset({"even"})),
    "scale follows the air pressure": Kind(_refracting, frozenset({"pressure_hpa"})),
    "a target's holder bends": Kind(_wandering),
    "noise grows with temperature": Kind(_growing_noise),
    "a target trembles": Kind(_vibrating),
}
FOREIGN: Mapping[str, Kind] = {name: Kind(draw, frozenset({"even"})) for name, draw in foreign.FOREIGN.items()}
# Those that joined the catalogue after the campaigns of the page were drawn: they are drawn by themselves, so that a
# seed and a number stay the campaign that the page tells of.
ADDED = frozenset(
    {
        "approach-scatter",
        "noise-burst",
        "in-plane-deformation",
        "leg-compliance",
        "gravity-sag",
        "actuator-zero-shift",
        "body-jump",
    }
)
KINDS: Mapping[str, Kind] = {**CATALOGUE, **STRANGE, **FOREIGN}

BENDING = frozenset(
    {
        "platform-deformation-linear",
        "platform-deformation-matrix",
        "platform-deformation-nonlinear",
        "in-plane-deformation",
    }
)
# Of two effects of a family one holds the other, or what is left of it when the other is there: two of them are one.
FAMILIES = (BENDING, frozenset({"thermal-expansion", "leg-thermal", "measurement-scale"}))


def draw_two(rng: np.random.Generator) -> tuple[str, str]:
    """Two effects of the catalogue that are no more than each other."""
    while True:
        first, second = rng.choice(sorted(set(CATALOGUE) - ADDED), 2, replace=False).tolist()
        if not any({first, second} <= family for family in FAMILIES):
            return first, second
