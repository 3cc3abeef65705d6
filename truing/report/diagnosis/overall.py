"""How far predictions miss before anything is accepted and after everything is, as a whole."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from truing.report.diagnosis.compared import READINGS, compared
from truing.report.diagnosis.judged import Judged, whole_gain
from truing.report.diagnosis.reading_misses import reading_misses
from truing.report.tables import Tables

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Overall:
    """Rms of measured minus predicted before and after; ``floor_words`` says what the floor is that of."""

    before: float
    after: float
    floor: float | None
    unit: str
    held_out: bool
    floor_words: str = "noise floor"


def overall(found: list[Judged], tables: Tables, *, held_out: bool) -> Overall | None:
    """What all findings together bring; None where it was not evaluated, or in mixed units.

    A finding on a bench is told over the channels that it moves. Several are told over all channels of the first one's
    unit, beside the noise that was declared for these.
    """
    effects = [row for row in found if not row.is_noise]
    if compared(tables) is READINGS and len(effects) > 1:
        return _of_readings(effects[0].unit, tables, held_out)
    pair = whole_gain(found, held_out)
    return None if pair is None else Overall(*pair, effects[-1].floor, effects[-1].unit, held_out)


def _of_readings(unit: str, tables: Tables, held_out: bool) -> Overall | None:
    misses = reading_misses(tables)
    if misses is None:
        return None
    own = misses[(misses["unit"] == unit) & ((misses["role"] == "verification") == held_out)]
    if not len(own):
        return None
    floor = _rms(own["sigma"]) if own["sigma"].notna().all() else None
    return Overall(_rms(own["before"]), _rms(own["after"]), floor, unit, held_out, "declared noise")


def _rms(values: pd.Series) -> float:
    return float(np.sqrt(np.mean(values.to_numpy(dtype=float) ** 2)))
