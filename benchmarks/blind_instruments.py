"""Causes, layouts and result files of the blind benchmark, instrument by instrument."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from tests.blind.generator import case, draw, hidden
from tests.blind.generator.arms import case as arm_case
from tests.blind.generator.arms.effects import ADDED as ADDED_TO_ARMS
from tests.blind.generator.arms.foreign import FOREIGN as FOREIGN_TO_ARMS
from tests.blind.generator.arms.layouts import LAYOUTS as ARMS
from tests.blind.generator.sensor import case as sensor_case
from tests.blind.generator.sensor import draw as sensor_draw
from tests.blind.generator.sensor import hidden as sensor_hidden
from tests.photographs import hidden_case as photographed

PROJECT = Path(__file__).resolve().parents[1]
DOCS = PROJECT / "docs"


class HiddenCampaign(Protocol):
    """A campaign with hidden effects."""

    def write(self, folder: Path) -> Path:
        """Write the campaign's folder, and its truth next to it; returns the folder."""


@dataclass(frozen=True)
class Instrument:
    """Instrument of the benchmark: catalogued and uncatalogued effects, layouts, and functions that draw campaigns.

    ``subjects``: subjects of effects, in words. ``obvious``: share of single effects far above the detectable size.
    ``unforeseen``: further uncatalogued effects, added after the diagnosis was complete; ``foreign``: effects of
    foreign worlds. ``page_name``: its page in docs; ``short_name``: prefix of its result files and figures;
    ``seed``: of the campaigns of its page.
    """

    catalogue: Sequence[str]
    uncatalogued: Sequence[str]
    layouts: Sequence[str]
    draw_two: Callable[[np.random.Generator], tuple[str, str]]
    layouts_for: Callable[[Sequence[str]], list[str]]
    hide: Callable[[Sequence[str], str, float, int], HiddenCampaign]
    page_name: str
    short_name: str
    subjects: str
    obvious: float = 0.0
    unforeseen: Sequence[str] = ()
    foreign: Sequence[str] = ()
    added: Sequence[str] = ()
    seed: int = 2

    @property
    def page(self) -> Path:
        """Path of its page on the quality of the diagnosis."""
        return DOCS / f"{self.page_name}.md"

    @property
    def results(self) -> Path:
        """Recorded results of its page."""
        return DOCS / "experiments" / f"{self.short_name.replace('-', '_')}_results.jsonl.gz"

    @property
    def unforeseen_results(self) -> Path:
        """Recorded results on unforeseen effects."""
        return DOCS / "experiments" / f"{self.short_name.replace('-', '_')}_unforeseen.jsonl.gz"

    @property
    def added_results(self) -> Path:
        """Recorded results on causes that joined the catalogue after the campaigns of the page were drawn."""
        return DOCS / "experiments" / f"{self.short_name.replace('-', '_')}_added.jsonl.gz"

    @property
    def foreign_results(self) -> Path:
        """Recorded results on foreign worlds."""
        return DOCS / "experiments" / f"{self.short_name.replace('-', '_')}_foreign.jsonl.gz"

    def figure(self, name: str) -> Path:
        """Path of a figure of the page."""
        return DOCS / "figures" / f"{self.short_name}-{name}.svg"


INSTRUMENTS = {
    "photogrammetry": Instrument(
        tuple(hidden.CATALOGUE),
        tuple(hidden.STRANGE),
        tuple(draw.LAYOUTS),
        hidden.draw_two,
        case.layouts_for,
        case.hide,
        "how-well-does-it-diagnose",
        "blind",
        "legs or targets",
        foreign=tuple(hidden.FOREIGN),
        added=tuple(hidden.ADDED),
        seed=941201,
    ),
    "sensor": Instrument(
        tuple(sensor_hidden.CATALOGUE),
        tuple(sensor_hidden.STRANGE),
        tuple(sensor_draw.LAYOUTS),
        sensor_hidden.draw_two,
        sensor_case.layouts_for,
        sensor_case.hide,
        "how-well-does-it-diagnose-a-sensor",
        "blind-sensor",
        "loads, channels, runs or signals",
        obvious=0.2,
        unforeseen=tuple(sensor_hidden.UNFORESEEN),
        foreign=tuple(sensor_hidden.FOREIGN),
        added=tuple(sensor_hidden.ADDED),
        seed=941102,
    ),
    "photographs": Instrument(
        tuple(photographed.CATALOGUE),
        tuple(photographed.STRANGE),
        tuple(photographed.LAYOUTS),
        photographed.draw_two,
        photographed.layouts_for,
        photographed.hide,
        "how-well-does-it-diagnose-photographs",
        "blind-photographs",
        "cameras or bars",
        obvious=0.2,
    ),
    "arms": Instrument(
        arm_case.CATALOGUE,
        FOREIGN_TO_ARMS,
        ARMS,
        arm_case.draw_two,
        arm_case.layouts_for,
        arm_case.hide,
        "how-well-does-it-diagnose-an-arm",
        "blind-arm",
        "joints, links or targets",
        obvious=0.2,
        foreign=FOREIGN_TO_ARMS,
        added=ADDED_TO_ARMS,
        seed=941103,
    ),
}
