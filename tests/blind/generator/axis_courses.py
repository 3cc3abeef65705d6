"""Effects on an encoder without a catalogued cause: courses over rows, commands and movements, without truing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.blind.generator.axis import CHANNELS, Array, AxisCampaign, AxisLayout, draw_layout, record

Course = Callable[[AxisLayout, np.random.Generator], Array]


def _random_walk(layout: AxisLayout, rng: np.random.Generator) -> Array:
    """Steps from row to row that know nothing of each other."""
    return np.cumsum(rng.standard_normal(len(layout.command)))


def _slow_drift(layout: AxisLayout, rng: np.random.Generator) -> Array:
    """A drift that settles, one that grows, or a part of a slow wave, over the time of the campaign."""
    share = np.arange(len(layout.command)) / len(layout.command)
    shape = int(rng.integers(3))
    if shape == 0:
        return np.exp(-share / rng.uniform(0.15, 0.5))
    return share ** rng.uniform(1.0, 2.0) if shape == 1 else np.sin(2.0 * np.pi * (rng.uniform(0.4, 1.2) * share + 0.1))


def _wave(layout: AxisLayout, rng: np.random.Generator) -> Array:
    """A wave over the position without a period: half a wave to one and a half over the travel."""
    travel = float(np.ptp(layout.command))
    return np.sin(2.0 * np.pi * (rng.uniform(0.5, 1.5) * layout.command / travel + rng.uniform()))


def _hysteresis(layout: AxisLayout, rng: np.random.Generator) -> Array:
    """Friction that winds up over a length: nowhere is it a gap (Dahl's model)."""
    length = float(np.ptp(layout.command)) * rng.uniform(0.15, 0.5)
    force, found = 0.0, [0.0]
    for step in np.diff(layout.command):
        way = np.sign(step)
        force = way + (force - way) * np.exp(-abs(step) / length)
        found.append(float(force))
    return np.array(found)


def _stretch(layout: AxisLayout, rng: np.random.Generator) -> Array:
    """Some successive rows that deviate, and none before or after them."""
    count, rows = len(layout.command), int(rng.integers(3, 9))
    first = int(rng.integers(3, count - rows - 3))
    return ((np.arange(count) >= first) & (np.arange(count) < first + rows)).astype(float)


def _heavy_tails(layout: AxisLayout, rng: np.random.Generator) -> Array:
    """Scatter with tails: far more large deviations than a normal distribution has."""
    return rng.standard_t(2.0, len(layout.command))


COURSES: dict[str, Course] = {
    "random walk": _random_walk,
    "slow drift": _slow_drift,
    "wave over the position": _wave,
    "hysteresis": _hysteresis,
    "outlier stretch": _stretch,
    "heavy tails": _heavy_tails,
}
SCATTER = "heavy tails"
"""The one that follows nothing."""


def draw_course(
    name: str, rng: np.random.Generator, least: float = 3.0, most: float = 10.0, layout: AxisLayout | None = None
) -> AxisCampaign:
    """Draw an axis one of whose encoders follows a course, its rms (of a stretch: its height) ``least`` to ``most``
    standard deviations of a reading."""
    layout = layout or draw_layout(rng)
    channel = str(rng.choice([c for c in CHANNELS if c in layout.channels]))
    course = COURSES[name](layout, rng)
    size = 1.0 if name in ("outlier stretch", SCATTER) else float(np.std(course))
    noise = float(np.hypot(layout.noise["command"], max(layout.noise[c] for c in layout.channels)))
    if name == SCATTER:
        least, most = 1.0, 3.0
    course = course / size * noise * rng.uniform(least, most)
    return record(layout, (), rng, {channel: course})
