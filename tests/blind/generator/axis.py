"""Campaigns of one axis drawn at random, with hidden errors: the loop is closed row by row, exactly, without truing."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CAUSES = ("scale-error", "lost-motion", "zero-shift")
CHANNELS = ("motor", "load", "measured")
# What carries a scale error or a shift: the transmission, or what records.
PLACES = {"axis": "axis", "encoder load": "load", "encoder motor": "motor", "instrument": "measured"}


@dataclass(frozen=True)
class AxisLayout:
    """What a campaign of an axis looks like before anything is hidden: units of the file, deg or mm."""

    kind: str
    loop: str
    channels: tuple[str, ...]
    command: Array
    noise: dict[str, float]  # of command and channels
    event_row: int | None
    held_out: NDArray[np.bool_]

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
    return AxisLayout(kind, loop, own, command, sigma, event, held)


def shown(layout: AxisLayout, hidden: Hidden) -> bool:
    """Whether a hidden error moves anything that was recorded."""
    quiet = AxisLayout(**{**layout.__dict__, "noise": dict.fromkeys(layout.noise, 0.0)})
    without, within = (record(quiet, errors, np.random.default_rng(0)).recorded for errors in ((), (hidden,)))
    return bool(np.any(np.ptp(within - without, axis=0) > 1e-12))


def least(layout: AxisLayout, cause: str) -> float:
    """The standard deviation with which a fit by eye would know the size of an error, in the file's unit."""
    noise = float(np.hypot(layout.noise["command"], max(layout.noise[name] for name in layout.channels)))
    spread = float(np.std(layout.command)) if cause == "scale-error" else 1.0
    return noise / spread / np.sqrt(len(layout.command) / 4.0)


def draw_one(cause: str, strength: float, rng: np.random.Generator) -> tuple[AxisLayout, Hidden]:
    """Draw an error, ``strength`` of its standard deviations large, and a layout that shows it."""
    while True:
        layout = draw_layout(rng)
        made = _draw_hidden(layout, cause, strength, rng)
        if shown(layout, made):
            return layout, made


def _draw_hidden(layout: AxisLayout, cause: str, strength: float, rng: np.random.Generator) -> Hidden:
    size = strength * least(layout, cause) * float(rng.choice([-1.0, 1.0]))
    if cause == "lost-motion":
        return Hidden(cause, "", abs(size))
    subject = str(rng.choice(list(PLACES)))
    if cause == "scale-error":
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
    added = courses or {}
    for number, command in enumerate(layout.command):
        if last is not None and command != last:
            way = 1.0 if command > last else -1.0
        last = command
        wanted = command + rng.normal(0.0, 1.0) * layout.noise["command"]
        reach = 20.0 + 0.1 * abs(wanted)
        low, high = wanted - reach, wanted + reach
        for _ in range(80):
            middle = (low + high) / 2.0
            read = _readings(middle, way, number, hidden, added)[layout.loop]
            low, high = (middle, high) if read < wanted else (low, middle)
        found = _readings((low + high) / 2.0, way, number, hidden, added)
        rows.append([found[name] + rng.normal(0.0, layout.noise[name]) for name in layout.channels])
    return AxisCampaign(layout, np.array(rows), hidden)


def _readings(
    turned: float, way: float, row: int, hidden: tuple[Hidden, ...], added: Mapping[str, Array]
) -> dict[str, float]:
    """What every encoder reads, the motor standing at ``turned``."""
    factor, shift = dict.fromkeys(PLACES.values(), 1.0), dict.fromkeys(PLACES.values(), 0.0)
    gap = 0.0
    for error in hidden:
        if error.cause == "lost-motion":
            gap += error.size
        elif error.cause == "scale-error":
            factor[PLACES[error.subject]] *= 1.0 + error.size
        elif row >= error.from_row:
            shift[PLACES[error.subject]] += error.size
    for name, course in added.items():
        shift[name] += course[row]
    load = turned * factor["axis"] - gap * way + shift["axis"]
    return {
        "motor": turned * factor["motor"] + shift["motor"],
        "load": load * factor["load"] + shift["load"] + 11.0,
        "measured": load * factor["measured"] + shift["measured"] - 3.0,
    }


def write(campaign: AxisCampaign, folder: Path, name: str = "axis") -> Path:
    """Write the campaign as a folder, and what is hidden beside it; return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    own, unit = campaign.layout, campaign.layout.unit
    heads = ["pose", "role", "time_s", f"command_{unit}", *(f"{c}_{unit}" for c in own.channels), "event"]
    lines = [",".join(heads)]
    for n, values in enumerate(campaign.recorded):
        role = "verification" if own.held_out[n] else "calibration"
        event = "power-cycle" if own.event_row is not None and n >= own.event_row else ""
        numbers = ",".join(f"{v:.7f}" for v in values)
        lines.append(f"{n + 1},{role},{60 * n},{own.command[n]:.4f},{numbers},{event}")
    (folder / "configurations.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "campaign.toml").write_text(settings_text(own, name), encoding="utf-8")
    truth = [error.__dict__ for error in campaign.hidden]
    folder.with_suffix(".truth.json").write_text(json.dumps(truth), encoding="utf-8")
    return folder


def settings_text(own: AxisLayout, name: str) -> str:
    """Return campaign.toml of a layout."""
    encoders = [c for c in own.channels if c != "measured"]
    noise = [f"{what}_{own.unit} = {float(sigma)!r}" for what, sigma in own.noise.items()]
    lines = [
        *("[campaign]", f'name = "{name}"', 'kind = "photogrammetry"', "[mechanism]", 'type = "axis"'),
        *(f'kind = "{own.kind}"', f'loop = "{own.loop}"', f'command = "command_{own.unit}"'),
        *(f'{c} = "{c}_{own.unit}"' for c in encoders),
        *("[noise]", *noise),
    ]
    return "\n".join(lines) + "\n"
