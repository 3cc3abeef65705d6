"""What modelling the causes brings on a bench: every reading before and after, channel by channel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from truing.report.diagnosis import reading_figures
from truing.report.diagnosis.compared import READINGS
from truing.report.diagnosis.reading_misses import channels_of, root_mean_square
from truing.report.diagnosis.resampled import rms_with_interval
from truing.report.load_steps import axes_of
from truing.report.numbers import plain, sign
from truing.report.page import Listing

if TYPE_CHECKING:
    import pandas as pd

Drawn = list[tuple[object, str]]
_HEADS = (
    *("channel", "runs", "readings", "noise alone leaves"),
    *("rms before", "rms after", "largest before", "largest after", "unit"),
)


def drawn_readings(misses: pd.DataFrame, modelled: bool) -> Drawn:
    """Where predictions miss, how that follows the load, and how it came in time."""
    unknown = channels_of(misses[misses["noise_floor"].isna()])
    left = "what is left with the causes modelled"
    words = (
        f"The noise is what that declared leaves; of {', '.join(unknown)} it is {left}"
        if unknown
        else "The noise is what that declared leaves"
    )
    if len(unknown) == misses["channel"].nunique():
        words = f"The noise is {left}"
    straight = "A straight line through zero is a wrong slope; what differs between up and down depends on the past."
    found = [(reading_figures.where_missed(misses, modelled), f"{words}.")]
    if axes_of(misses):
        found.append((reading_figures.against_load(misses, modelled), straight))
    walk = "Under each block stands its run and the axis that it loads; one zero per run and channel is taken away."
    return [*found, *((figure, walk) for figure in reading_figures.in_order(misses, modelled))]


def by_channel(misses: pd.DataFrame) -> Listing:
    """Rms and largest of each channel, held-out runs apart, with intervals from resampled runs."""
    rng = np.random.default_rng(0)
    held_out = misses["role"].eq("verification")
    rows = tuple(
        (f"{channel}, {words}" if held_out.any() else channel, *_cells(own, rng))
        for channel in channels_of(misses)
        for words, chosen in ((READINGS.fitted, ~held_out), (READINGS.held_out, held_out))
        if len(own := misses[chosen & misses["channel"].eq(channel)])
    )
    caption = "Measured minus predicted, channel by channel; in brackets 95 % intervals from runs drawn again"
    return Listing(_HEADS, rows, caption=caption, held_by="reading_errors.parquet")


def _cells(own: pd.DataFrame, rng: np.random.Generator) -> tuple[str, ...]:
    runs = own.groupby("run", sort=False)
    counts = runs.size()
    sizes = [rms_with_interval(runs[when].agg(root_mean_square), rng, counts) for when in ("before", "after")]
    most = [plain(own[when].abs().max()) for when in ("before", "after")]
    noise = plain(root_mean_square(own["noise_floor"]))
    return (str(len(counts)), f"{len(own):,}", noise, *sizes, *most, sign(str(own["unit"].iloc[0])))
