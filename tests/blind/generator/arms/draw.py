"""Draws a campaign of an arm: layout, notation, instrument, true geometry, hidden effects, and what was recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tests.blind.generator.arms import effects as hidden
from tests.blind.generator.arms.arm import Arm, Link, modified, serial
from tests.blind.generator.arms.effects import ADDED, CAUSES, LINK_CAUSES, Effect, draw_effect, hide
from tests.blind.generator.arms.foreign import FOREIGN, draw_foreign
from tests.blind.generator.arms.geometry import NOTATIONS, Design, Tolerance
from tests.blind.generator.arms.instrument import BOTH, INSTRUMENTS, Instrument, Seen, draw_instrument, see
from tests.blind.generator.arms.layouts import LAYOUTS, ROWS, TREES, with_masses, with_other_frames
from tests.blind.generator.arms.schedule import draw_schedule
from tests.blind.generator.arms.strength import Bench, Fit, apart, linear_fit, of_scatter, squares_of_scatter
from tests.blind.generator.arms.transforms import Array, X, Y, Z, rotation

OFFSET = 4.0  # tolerances: the least hidden offset
LARGEST = 0.01  # m: no effect moves a point farther
BOUNDS = {  # sizes beyond them belong to no machine: 1/K, 1, rad/(N m), 1/(N m²), rad or m
    "link-growth": 2e-4,
    "joint-gain": 0.02,
    "joint-compliance": 3e-4,
    "joint-sag": 3e-4,
    "link-bending": 1e-3,
    "joint-offset": 0.05,
}
APART = 0.7  # share of its strength that an effect keeps next to another one
ATTEMPTS = 60
# A robot with loops needs a class of its own where it is diagnosed: it is drawn by name.
_OF_ITSELF = tuple(name for name in LAYOUTS if name != "delta")


@dataclass(frozen=True)
class ArmCampaign:
    """A campaign as recorded: readings (N, K), what the instrument saw, surveyed places (M, 3); and the truth. SI."""

    seed: int
    layout: str
    bench: Bench
    arm: Arm
    effects: tuple[Effect, ...]
    readings: Array
    recorded: Seen
    survey: Array


def draw(
    seed: int,
    *,
    layout: str | None = None,
    instrument: str | None = None,
    causes: Sequence[str] | None = None,
    strength: float = 10.0,
    foreign: bool = False,
    notation: str | None = None,
    poses: int | None = None,
) -> ArmCampaign:
    """Draw a campaign; ``causes=None`` draws none, one or two, and ``foreign`` adds one or two of no catalogued form.

    Such an effect has a name of ``FOREIGN`` and may stand among the causes.

    What is None is drawn, a layout among those without loops. Raises ValueError for unknown names, and where no drawn
    arm can show the causes.
    """
    _expect("layout", layout, LAYOUTS)
    _expect("notation", notation, NOTATIONS)
    _expect("instrument", instrument, (*INSTRUMENTS, BOTH, "points"))
    for cause in causes or ():
        _expect("cause", cause, (*CAUSES, *ADDED, *FOREIGN))
    if instrument == "points-pose" and any(cause in hidden.BASE_CAUSES for cause in causes or ()):
        raise ValueError(f"causes {causes} cannot be shown where every pose has a frame of its own")
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, 1701, attempt])
        wanted = _causes(causes, foreign, rng)
        kind = _instrument(instrument, wanted, rng)
        name = layout or str(rng.choice(_OF_ITSELF))
        if notation in ("standard", "modified") and name not in ROWS:
            if layout:
                raise ValueError(f"layout {layout!r} has no rows: notation urdf or screws is expected")
            continue
        loaded = any(c in hidden.OF_GRAVITY for c in wanted)
        own = "urdf" if "joint-sag" in wanted else notation
        bench = _bench(name, own, kind, loaded, rng, poses, tells_masses="joint-sag" not in wanted)
        effects = _effects(bench, wanted, strength, rng)
        if effects is not None:
            return record(seed, name, bench, effects, rng)
    raise ValueError(f"causes {wanted} cannot be shown by layout {layout!r} with instrument {instrument!r}")


def _expect(what: str, value: str | None, names: Sequence[str]) -> None:
    if value is not None and value not in names:
        raise ValueError(f"{what} {value!r}: expected one of {', '.join(names)}")


def _causes(causes: Sequence[str] | None, foreign: bool, rng: np.random.Generator) -> list[str]:
    count = int(rng.choice([0, 1, 2], p=[0.3, 0.5, 0.2]))
    if causes is None:
        wanted = [] if foreign else [str(cause) for cause in rng.choice(CAUSES, count, replace=False)]
        wanted = wanted[:1] if "joints-exchanged" in wanted else wanted
    else:
        wanted = list(causes)
    if foreign:
        wanted += [str(name) for name in rng.choice(FOREIGN, int(rng.integers(1, 3)), replace=False)]
    return wanted


def _instrument(asked: str | None, wanted: Sequence[str], rng: np.random.Generator) -> str:
    if asked is not None and asked != "points":
        return asked
    share = np.array([0.2, 0.15, 0.25, 0.2, 0.2])
    if any(cause.startswith("base") or cause == "foreign slow-base" for cause in wanted):
        share[0] = 0.0
    share[3] *= "target-moved" not in wanted
    share[3:] *= asked is None
    return str(rng.choice(INSTRUMENTS, p=share / share.sum()))


def _bench(
    name: str,
    notation: str | None,
    kind: str,
    loaded: bool,
    rng: np.random.Generator,
    poses: int | None,
    tells_masses: bool = True,
) -> Bench:
    design = _design(name, notation, loaded, rng)
    if not tells_masses:
        design = replace(design, arm=replace(design.arm, payload=0.0), tells_masses=False)
    tolerance = None
    if rng.random() < 0.75:
        degrees = np.round([rng.uniform(0.05, 0.3), rng.uniform(0.02, 0.1)], 3)
        offset, angle = np.radians(degrees)
        tolerance = Tolerance(float(offset), round(float(rng.uniform(2e-4, 1e-3)), 5), float(angle))
    noisy = float(rng.random() < 0.5)
    slides = np.array([design.arm.joints[n].kind == "prismatic" for n in design.arm.actuated])
    sigma = noisy * np.where(slides, round(rng.uniform(1e-6, 5e-6), 7), np.radians(round(rng.uniform(1e-4, 1e-3), 5)))
    schedule = draw_schedule(design.arm, sigma, rng, poses)
    return Bench(design, tolerance, schedule, draw_instrument(kind, design.arm, schedule, rng), sigma)


def _design(name: str, notation: str | None, loaded: bool, rng: np.random.Generator) -> Design:
    payload = round(float(rng.uniform(0.5, 6.0)), 2) if loaded or rng.random() < 0.6 else 0.0
    centre = np.round(rng.uniform(-0.05, 0.05, 3) + np.array([0.0, 0.0, 0.05]), 4) * (payload > 0.0)
    gravity = [-Z, Z, X, Y][int(rng.choice(4, p=[0.8, 0.1, 0.05, 0.05]))]
    load = {"payload": payload, "payload_com": centre, "gravity": gravity}
    if name in TREES:
        arm = TREES[name](rng)
        single = len(arm.tips) == 1 and len(arm.actuated) == sum(j.kind != "fixed" for j in arm.joints)
        own = notation or ("screws" if single and rng.random() < 0.3 else "urdf")
        if own == "screws" and not single:
            own = "urdf"
        return Design(_dressed(replace(arm, **load), own, rng), own)
    rows = ROWS[name](rng)
    own = notation or str(rng.choice(NOTATIONS, p=[0.4, 0.25, 0.2, 0.15]))
    rows = modified(rows) if own == "modified" else rows
    prefix = str(rng.choice(["joint", "axis_", "j"]))
    arm = serial(rows, own if own == "modified" else "standard", prefix)
    return Design(_dressed(replace(arm, **load), own, rng), own, rows if own in ("standard", "modified") else ())


def _dressed(arm: Arm, notation: str, rng: np.random.Generator) -> Arm:
    """The arm of a URDF with masses and frames of any kind; other notations know no masses but the payload."""
    if notation != "urdf":
        return replace(arm, links=tuple(Link(link.name) for link in arm.links))
    return with_other_frames(arm if arm.loops else with_masses(arm, rng), rng)


def _effects(bench: Bench, wanted: Sequence[str], strength: float, rng: np.random.Generator) -> list[Effect] | None:
    """Effects of the causes, sized, or None where this campaign cannot show them."""
    if "joints-exchanged" in wanted and len(wanted) > 1:
        raise ValueError("joints-exchanged cannot be hidden with another cause")
    candidates = [_candidates(cause, bench, rng) for cause in wanted]
    if not all(candidates):
        return None
    if not wanted:
        return []
    fit, found = linear_fit(bench), list[Effect]()
    for candidate in candidates:
        sized = (_sized(effect, fit, strength, rng) for effect in candidate)
        chosen = next((effect for effect in sized if effect is not None), None)
        if chosen is None:
            return None
        found.append(chosen)
    return found if len(found) == 1 or _stand_apart(fit, found) else None


def _candidates(cause: str, bench: Bench, rng: np.random.Generator) -> list[Effect]:
    family, _, kind = cause.partition(" ")
    draw_ = draw_foreign if family == "foreign" else draw_effect
    found = draw_(kind or cause, bench.design.arm, bench.schedule, bench.instrument, rng)
    return [effect for effect in found if not _is_undescribed(effect, bench.design)]


def _is_undescribed(effect: Effect, design: Design) -> bool:
    """Return True for an effect of a link whose length the description leaves open: d of a slide is the zero of its
    reading."""
    slides = {joint.child for joint in design.arm.joints if joint.kind == "prismatic"}
    return bool(design.rows) and effect.cause in LINK_CAUSES and effect.where in slides


def _stand_apart(fit: Fit, effects: Sequence[Effect]) -> bool:
    kept = apart(fit, effects)
    return all(own >= APART * effect.strength for own, effect in zip(kept, effects, strict=True))


def _sized(effect: Effect, fit: Fit, strength: float, rng: np.random.Generator) -> Effect | None:
    """The effect at the size at which it has the asked strength; None where that would be too large."""
    if effect.cause == "joints-exchanged":
        return replace(effect, strength=fit.strength(effect))
    trial = _trial(effect, fit)
    unit = fit.strength(replace(effect, size=trial)) / trial
    if effect.cause == "joint-offset" and fit.bench.tolerance is not None:
        slide = fit.bench.joint_kind(effect.where) == "prismatic"
        size = (fit.bench.tolerance.length if slide else fit.bench.tolerance.offset) * rng.uniform(OFFSET, 2.0 * OFFSET)
        if size * unit < OFFSET - 1.0:
            return None
    elif unit <= 0.0:
        return None
    else:
        size = _wanted(effect, fit, strength) / unit
    size *= 1.0 if effect.cause in hidden.OF_GRAVITY else float(rng.choice([-1.0, 1.0]))
    if effect.cause in ("joint-backlash", "approach-scatter", "link-growth"):
        size = abs(size)
    sized = replace(effect, size=size)
    small = abs(size) <= BOUNDS.get(effect.cause, np.inf)
    if not small or (effect.cause != "joint-offset" and fit.displacement(sized) > LARGEST):
        return None
    return replace(sized, strength=_reached(sized, fit, abs(size) * unit))


def _trial(effect: Effect, fit: Fit) -> float:
    """A size that moves what is seen by about a tenth of a millimetre."""
    first = 1e-6 if effect.cause in hidden.OF_GRAVITY else 1e-5
    return first * 1e-4 / max(fit.displacement(replace(effect, size=first)), 1e-9)


def _wanted(effect: Effect, fit: Fit, strength: float) -> float:
    """Root of the non-centrality that an effect needs for a strength."""
    return float(np.sqrt(squares_of_scatter(strength, _fitted(fit)))) if _scatters(effect) else strength


def _reached(effect: Effect, fit: Fit, root: float) -> float:
    """Strength of an effect of this root of its non-centrality."""
    return of_scatter(root**2, _fitted(fit)) if _scatters(effect) else root


def _scatters(effect: Effect) -> bool:
    """Return True if an effect has as many numbers as poses and shows in their sum of squares alone."""
    return effect.cause == "approach-scatter" or effect.fixed.get("kind") == "heavy-tails"


def _fitted(fit: Fit) -> int:
    return int(np.sum(~fit.bench.schedule.held_out))


def record(seed: int, layout: str, bench: Bench, effects: Sequence[Effect], rng: np.random.Generator) -> ArmCampaign:
    """Records of a campaign with hidden effects."""
    arm = bench.design.arm
    if bench.tolerance is not None:
        sigmas = bench.design.sigmas(bench.tolerance)
        arm = bench.design.changed(sigmas * rng.normal(size=len(sigmas)))
    schedule, instrument = bench.schedule, bench.instrument
    seen = see(instrument, schedule, arm, hide(effects, arm, schedule, len(instrument.targets)))
    readings = schedule.readings + bench.joint_noise * rng.normal(size=schedule.readings.shape)
    survey = np.array([target.place for target in instrument.targets]).reshape(-1, 3)
    survey = survey + instrument.noise * rng.normal(size=survey.shape)
    return ArmCampaign(seed, layout, bench, arm, tuple(effects), readings, _with_noise(seen, instrument, rng), survey)


def _with_noise(seen: Seen, instrument: Instrument, rng: np.random.Generator) -> Seen:
    noise = instrument.noise
    return Seen(
        seen.points + noise * rng.normal(size=seen.points.shape),
        rotation(instrument.turn_noise * rng.normal(size=seen.moved.shape)) @ seen.turned,
        seen.moved + noise * rng.normal(size=seen.moved.shape),
        seen.distances + noise * rng.normal(size=seen.distances.shape),
    )
