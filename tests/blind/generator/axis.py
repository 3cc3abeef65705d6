"""Campaigns of one axis drawn at random, with hidden errors: the loop is closed row by row, exactly, without truing."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CAUSES = ("scale-error", "lost-motion", "zero-shift", "periodic-error", "axis-growth")
CHANNELS = ("motor", "load", "measured")
SLIP, SCATTER = "encoders-disagree", "approach-scatter"
# What carries a scale error or a shift: the transmission, or what records.
PLACES = {"axis": "axis", "encoder load": "load", "encoder motor": "motor", "instrument": "measured"}


@dataclass(frozen=True)
class AxisLayout:
    """An axis campaign without hidden effects; deg or mm, as in the file."""

    kind: str
    loop: str
    channels: tuple[str, ...]
    command: Array
    noise: dict[str, float]  # of command and channels
    event_row: int | None
    held_out: NDArray[np.bool_]
    temperature: Array | None = None  # degrees C, of every row

    @property
    def unit(self) -> str:
        """Unit of the axis in files."""
        return "deg" if self.kind == "rotary" else "mm"


@dataclass(frozen=True)
class Hidden:
    """One hidden error: cause, subject, size in the file's unit (a factor less one for a scale), first row."""

    cause: str
    subject: str
    size: float
    from_row: int = 0
    of_event: bool = False
    period: float = 0.0
    phase: float = 0.0
    way: int = 0  # movements after which the axis scatters: up, down, or (0) both


@dataclass(frozen=True)
class AxisCampaign:
    """A layout with what was recorded (N, K) and what is hidden."""

    layout: AxisLayout
    recorded: Array
    hidden: tuple[Hidden, ...] = field(default=())


def draw_layout(rng: np.random.Generator) -> AxisLayout:
    """Draw a rotary or linear axis that is sent up and down its travel, with jitter, a turn-round here and there."""
    kind = str(rng.choice(["rotary", "linear"]))
    half, noise = (float(rng.uniform(20, 170)), 2e-4) if kind == "rotary" else (float(rng.uniform(20, 500)), 5e-4)
    places, sweeps = int(rng.integers(8, 16)), int(rng.integers(3, 6))
    sweep = np.linspace(-half, half, places)
    command = np.concatenate([sweep if n % 2 == 0 else sweep[::-1] for n in range(sweeps)])
    command = np.round(command + rng.uniform(-0.02, 0.02, len(command)) * half, 4)
    loop = str(rng.choice(["motor", "load"], p=[0.7, 0.3]))
    channels = [CHANNELS, CHANNELS, ("motor", "measured"), ("load", "measured"), ("motor", "load")]
    own = channels[int(rng.integers(len(channels)))]
    sigma = {name: noise * float(rng.uniform(0.3, 3.0)) for name in ("command", *own)}
    sigma["command"] *= float(rng.choice([0.0, 1.0]))
    held = np.arange(len(command)) % 5 == 3 if rng.random() < 0.5 else np.zeros(len(command), bool)
    event = int(rng.integers(len(command) // 4, 3 * len(command) // 4)) if rng.random() < 0.5 else None
    warm = _temperature(len(command), rng) if rng.random() < 0.5 else None
    return AxisLayout(kind, loop, own, command, sigma, event, held, warm)


def draw_uneven_layout(rng: np.random.Generator) -> AxisLayout:
    """Draw an axis with both encoders whose path grows unevenly: it stays near a place, or goes far, by turns."""
    layout = draw_layout(rng)
    while not {"motor", "load"} <= set(layout.channels):
        layout = draw_layout(rng)
    count, half = len(layout.command), float(np.abs(layout.command).max())
    near = np.arange(count) // int(rng.integers(6, 12)) % 2 == 0
    steps = np.where(near, 0.03, 1.0) * rng.uniform(-half, half, count)
    places = np.where(near, np.round(rng.uniform(-0.5, 0.5)) * half + steps, steps)
    return replace(layout, command=np.round(places, 4))


def draw_slip(strength: float, rng: np.random.Generator) -> tuple[AxisLayout, Hidden]:
    """Draw a drive or a load encoder that slips, ``strength`` of its standard deviations large."""
    layout = draw_uneven_layout(rng)
    path = np.cumsum(np.abs(np.diff(layout.command, prepend=layout.command[0])))
    size = strength * least(layout, "zero-shift") / float(np.std(path)) * float(rng.choice([-1.0, 1.0]))
    return layout, Hidden(SLIP, str(rng.choice(["axis", "encoder load"])), size)


def draw_scatter(strength: float, rng: np.random.Generator) -> tuple[AxisLayout, Hidden]:
    """Draw a drive, or an axis about a command known to noise, that scatters from one side by ``strength`` times the
    noise."""
    layout = draw_layout(rng)
    while not {"motor", "load"} <= set(layout.channels):
        layout = draw_layout(rng)
    noise = float(np.hypot(layout.noise["command"], max(layout.noise[name] for name in layout.channels)))
    subject = str(rng.choice(["axis", ""])) if layout.noise["command"] else "axis"
    return layout, Hidden(SCATTER, subject, strength * noise, way=int(rng.choice([-1, 1])))


def _courses(layout: AxisLayout, hidden: tuple[Hidden, ...], rng: np.random.Generator) -> dict[str, Array]:
    """Slip, proportional to the path, and random scatter, by place; "command" is the position after a stop."""
    steps = np.diff(layout.command, prepend=layout.command[0])
    found: dict[str, Array] = {}
    for error in hidden:
        if error.cause == SLIP:
            course = error.size * np.cumsum(np.abs(steps))
        elif error.cause == SCATTER:
            ways = [1.0]
            for step in steps[1:]:
                ways.append(float(np.sign(step)) if step != 0.0 else ways[-1])
            own = np.array(ways) == error.way if error.way else np.ones(len(ways), bool)
            course = error.size * rng.standard_normal(len(ways)) * own
        else:
            continue
        place = PLACES.get(error.subject, "command")
        found[place] = found.get(place, np.zeros(len(steps))) + course
    return found


def _temperature(count: int, rng: np.random.Generator) -> Array:
    """Room temperature that follows the sun and a heater, read to a hundredth of a degree."""
    share = np.arange(count) / count
    sun = np.sin(2.0 * np.pi * (rng.uniform(0.5, 3.0) * share + rng.uniform()))
    heater = 0.3 * np.sign(np.sin(2.0 * np.pi * (rng.uniform(4.0, 9.0) * share + rng.uniform())))
    return np.round(rng.uniform(18.0, 25.0) + rng.uniform(0.5, 2.0) * (sun + heater), 2)


def shown(layout: AxisLayout, hidden: Hidden) -> bool:
    """Return True if a hidden error changes a recorded number."""
    quiet = AxisLayout(**{**layout.__dict__, "noise": dict.fromkeys(layout.noise, 0.0)})
    without, within = (record(quiet, errors, np.random.default_rng(0)).recorded for errors in ((), (hidden,)))
    return bool(np.any(np.ptp(within - without, axis=0) > 1e-12))


def least(layout: AxisLayout, cause: str) -> float:
    """The standard deviation with which a fit by eye would know the size of an error, in the file's unit."""
    noise = float(np.hypot(layout.noise["command"], max(layout.noise[name] for name in layout.channels)))
    spread = float(np.std(layout.command)) if cause == "scale-error" else 1.0
    if cause == "periodic-error":
        spread = np.sqrt(0.5)
    if cause == "axis-growth" and layout.temperature is not None:
        spread = float(np.std((layout.temperature - layout.temperature.mean()) * layout.command))
    return noise / spread / np.sqrt(len(layout.command) / 4.0)


def draw_one(cause: str, strength: float, rng: np.random.Generator) -> tuple[AxisLayout, Hidden]:
    """Draw an error, ``strength`` of its standard deviations large, and a layout that shows it."""
    while True:
        layout = draw_layout(rng)
        if cause == "axis-growth" and layout.temperature is None:
            continue
        made = _draw_hidden(layout, cause, strength, rng)
        if shown(layout, made):
            return layout, made


def _draw_hidden(layout: AxisLayout, cause: str, strength: float, rng: np.random.Generator) -> Hidden:
    size = strength * least(layout, cause) * float(rng.choice([-1.0, 1.0]))
    if cause == "lost-motion":
        return Hidden(cause, "", abs(size))
    subject = str(rng.choice(list(PLACES)))
    if cause == "periodic-error":
        travel = float(np.ptp(layout.command))
        step = travel / len(np.unique(np.round(layout.command / travel, 1)))
        period = float(np.exp(rng.uniform(np.log(1.2 * step), np.log(travel / 2.2))))
        return Hidden(cause, subject, abs(size), period=period, phase=float(rng.uniform(-np.pi, np.pi)))
    if cause in ("scale-error", "axis-growth"):
        return Hidden(cause, subject, size)
    row = int(rng.integers(len(layout.command) // 4, 3 * len(layout.command) // 4))
    of_event = layout.event_row is not None
    return Hidden(cause, subject, size, layout.event_row if layout.event_row is not None else row, of_event)


def record(
    layout: AxisLayout, hidden: tuple[Hidden, ...], rng: np.random.Generator, courses: Mapping[str, Array] | None = None
) -> AxisCampaign:
    """Record every row: the drive turns until the encoder of its loop reads the command, by bisection.

    ``courses`` (N,) add to what encoders read, by their names, in the file's unit.
    """
    rows, way, last = [], 1.0, None
    own = _courses(layout, hidden, rng)
    stop = own.pop("command", np.zeros(len(layout.command)))
    added = {**own, **(courses or {})}
    for number, command in enumerate(layout.command):
        if last is not None and command != last:
            way = 1.0 if command > last else -1.0
        last = command
        wanted = command + rng.normal(0.0, 1.0) * layout.noise["command"] + stop[number]
        warmer = 0.0 if layout.temperature is None else float(layout.temperature[number] - layout.temperature.mean())
        reach = 20.0 + 0.1 * abs(wanted)
        low, high = wanted - reach, wanted + reach
        for _ in range(80):
            middle = (low + high) / 2.0
            read = _readings(middle, way, number, hidden, added, warmer)[layout.loop]
            low, high = (middle, high) if read < wanted else (low, middle)
        found = _readings((low + high) / 2.0, way, number, hidden, added, warmer)
        rows.append([found[name] + rng.normal(0.0, layout.noise[name]) for name in layout.channels])
    return AxisCampaign(layout, np.array(rows), hidden)


def _readings(
    turned: float, way: float, row: int, hidden: tuple[Hidden, ...], added: Mapping[str, Array], warmer: float
) -> dict[str, float]:
    """Readings of all encoders with the motor at ``turned``, ``warmer`` kelvin above the mean of the campaign."""
    factor, shift = dict.fromkeys(PLACES.values(), 1.0), dict.fromkeys(PLACES.values(), 0.0)
    wave: dict[str, list[Hidden]] = {place: [] for place in PLACES.values()}
    gap = 0.0
    for error in hidden:
        if error.cause == "lost-motion":
            gap += error.size
        elif error.cause == "scale-error":
            factor[PLACES[error.subject]] *= 1.0 + error.size
        elif error.cause == "axis-growth":
            factor[PLACES[error.subject]] *= 1.0 + error.size * warmer
        elif error.cause == "periodic-error":
            wave[PLACES[error.subject]].append(error)
        elif error.cause == "zero-shift" and row >= error.from_row:
            shift[PLACES[error.subject]] += error.size
    for name, course in added.items():
        shift[name] += course[row]

    def seen(place: str, at: float) -> float:
        waves = sum(own.size * np.sin(2.0 * np.pi * at / own.period + own.phase) for own in wave[place])
        return float(at * factor[place] + shift[place] + waves)

    load = seen("axis", turned) - gap * way
    return {"motor": seen("motor", turned), "load": seen("load", load) + 11.0, "measured": seen("measured", load) - 3.0}


def write(campaign: AxisCampaign, folder: Path, name: str = "axis") -> Path:
    """Write the campaign as a folder, and what is hidden next to it; return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    own, unit = campaign.layout, campaign.layout.unit
    heads = ["pose", "role", "time_s", f"command_{unit}", *(f"{c}_{unit}" for c in own.channels), "event"]
    warm = own.temperature
    heads += [] if warm is None else ["temperature_c"]
    lines = [",".join(heads)]
    for n, values in enumerate(campaign.recorded):
        role = "verification" if own.held_out[n] else "calibration"
        event = "power-cycle" if own.event_row is not None and n >= own.event_row else ""
        numbers = ",".join(f"{v:.7f}" for v in values)
        lines.append(
            f"{n + 1},{role},{60 * n},{own.command[n]:.4f},{numbers},{event}{'' if warm is None else f',{warm[n]:.2f}'}"
        )
    (folder / "configurations.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "campaign.toml").write_text(settings_text(own, name), encoding="utf-8")
    truth = [error.__dict__ for error in campaign.hidden]
    folder.with_suffix(".truth.json").write_text(json.dumps(truth), encoding="utf-8")
    return folder


def settings_text(axis_layout: AxisLayout, name: str) -> str:
    """Return campaign.toml of a layout."""
    encoders = [c for c in axis_layout.channels if c != "measured"]
    noise = [f"{what}_{axis_layout.unit} = {float(sigma)!r}" for what, sigma in axis_layout.noise.items()]
    lines = [
        *("[campaign]", f'name = "{name}"', 'kind = "photogrammetry"', "[mechanism]", 'type = "axis"'),
        *(f'kind = "{axis_layout.kind}"', f'loop = "{axis_layout.loop}"', f'command = "command_{axis_layout.unit}"'),
        *(f'{c} = "{c}_{axis_layout.unit}"' for c in encoders),
        *("[noise]", *noise),
    ]
    return "\n".join(lines) + "\n"
