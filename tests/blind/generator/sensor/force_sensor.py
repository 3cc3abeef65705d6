"""The sample campaign: nominal set A on a bench as the force-sensor paper has it, its z load off the centre.

One beam watches one channel at a time: six runs under the load of each axis. Next to it what the paper prints.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tests.blind.generator.certificate import certificate_lines
from tests.blind.generator.sensor.campaign import Campaign, draw_campaign
from tests.blind.generator.sensor.effects import LoadEccentricity
from tests.blind.generator.sensor.folder import write_campaign
from tests.blind.generator.sensor.layout import AXES, CHANNELS, UNITS, Layout, Programme, Tolerance

SEED = 20170929
OFFSET_M = (0.012, -0.008, 0.0)
LAYOUT = Layout(
    name="force-sensor",
    tolerance=Tolerance(stiffness=0.02),
    programme=Programme(channels="separate", pause_s=60.0),
    signals=6,
    certificate=certificate_lines("force sensor, simulated", "bench, simulated", "2026-11-22", "2026-11-23"),
)
# Figures 12 to 17: theoretical maximum, measured maxima at positive and at negative load, as printed.
PUBLISHED = (
    ("2327.3", "2079.88", "-2129.72"),
    ("1714.85", "1799.87", "-1838.26"),
    ("336.5", "428.21", "-206.99"),
    ("766.2", "729.4", "-700.57"),
    ("731.4", "612.75", "-697.37"),
    ("685.75", "635.94", "-674.47"),
)
# Largest loading point of Table 3, N and N m.
PUBLISHED_LOAD = 9000


def force_sensor_campaign(layout: Layout = LAYOUT, seed: int = SEED) -> Campaign:
    """The sample campaign in memory."""
    return draw_campaign(layout, [LoadEccentricity(AXES.index("fz"), OFFSET_M)], np.random.default_rng(seed))


def write_force_sensor(folder: Path) -> Path:
    """Writes the sample campaign and the published figures into ``folder``; the same bytes every time."""
    write_campaign(force_sensor_campaign(), folder, SEED)
    (folder / "published.csv").write_text("\n".join(_published()) + "\n", encoding="utf-8", newline="\n")
    return folder


def _published() -> Iterable[str]:
    yield "figure,load_axis,load,channel,unit,theoretical_maximum,measured_positive,measured_negative"
    rows = zip(AXES, CHANNELS, UNITS, PUBLISHED, strict=True)
    for number, (axis, channel, unit, printed) in enumerate(rows, start=12):
        yield f"{number},{axis},{PUBLISHED_LOAD},{channel},{unit},{','.join(printed)}"
