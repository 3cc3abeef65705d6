"""A force sensor with eight cells, two of them on already measured legs: 20 mV at 2 t, drawn within 0.5 %."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tests.blind.generator.sensor.campaign import Campaign, draw_campaign
from tests.blind.generator.sensor.effects import Effect
from tests.blind.generator.sensor.folder import write_campaign
from tests.blind.generator.sensor.layout import Layout, Programme

Array = np.ndarray
BRIDGES = [0, 1, 2, 3, 4, 5, 0, 3]  # the leg of each cell
RATED_N, OUTPUT, OUTPUT_SIGMA, SUPPLY_V, AMPLIFICATION = 19600.0, 2.0, 0.01, 10.0, 3.0
MV_PER_N = OUTPUT * SUPPLY_V * AMPLIFICATION / RATED_N
SIGNAL_MV, OFFSET_MV = 0.02, 0.4
CHAIN = f"""
[signals.chain]
rated_load_n = {RATED_N}
output_mv_per_v = {OUTPUT}
output_sigma_mv_per_v = {OUTPUT_SIGMA}
supply_v = {SUPPLY_V}
amplification = {AMPLIFICATION}
"""


@dataclass(frozen=True)
class Cells:
    """Forces (8, 6) of the cells per load, N per N and per N m; gain (8,), mV per N; offset (8,), mV."""

    forces: Array
    gain: Array
    offset: Array

    def signals(self, wrench: Array, rng: np.random.Generator) -> Array:
        """Signals (N, 8), mV, of wrenches (N, 6)."""
        return wrench @ self.forces.T * self.gain + self.offset + SIGNAL_MV * rng.normal(size=(len(wrench), 8))


def campaign(seed: int, effects: list[Effect], signals: bool = True, **more: object) -> tuple[Campaign, Cells]:
    """A campaign of one run for each load, all channels read at once."""
    noise = replace(Layout("").noise, signal_mv=SIGNAL_MV)
    layout = Layout("cells", signals=8 if signals else 0, noise=noise, programme=Programme(pause_s=60.0), **more)
    drawn, rng = draw_campaign(layout, effects, np.random.default_rng(seed)), np.random.default_rng([seed, 1])
    gain = MV_PER_N * (1 + OUTPUT_SIGMA / OUTPUT * rng.normal(size=8))
    cells = Cells(drawn.truth.machine.tension[BRIDGES], gain, rng.uniform(-OFFSET_MV, OFFSET_MV, 8))
    return replace(drawn, signals=cells.signals(drawn.truth.wrench, rng) if signals else drawn.signals), cells


def folder(place: Path, drawn: Campaign, more: str) -> Path:
    """The campaign's folder, with further sections of campaign.toml."""
    made = write_campaign(drawn, place, 0)
    text = (made / "campaign.toml").read_text(encoding="utf-8")
    (made / "campaign.toml").write_text(text + more, encoding="utf-8")
    return made
