"""How far predictions miss before anything is accepted and after everything is, as a whole."""

from __future__ import annotations

from dataclasses import dataclass

from truing.report.diagnosis.compared import READINGS, compared
from truing.report.diagnosis.judged import Judged, whole_gain
from truing.report.diagnosis.reading_misses import reading_misses, root_mean_square
from truing.report.tables import Tables


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

    A finding on a bench is told over the channels that it moves. Several are told over all channels of the unit in
    which they bring most, beside the noise that was declared for these.
    """
    effects = [row for row in found if not row.is_noise]
    if compared(tables) is READINGS and len(effects) > 1:
        units = dict.fromkeys(row.unit for row in effects)
        told = [one for unit in units if (one := _of_readings(unit, tables, held_out)) is not None]
        return max(told, key=lambda one: one.before / one.after if one.after > 0.0 else 1.0, default=None)
    pair = whole_gain(found, held_out)
    return None if pair is None else Overall(*pair, effects[-1].floor, effects[-1].unit, held_out)


def as_it_is(rows: list[Judged], tables: Tables, *, held_out: bool) -> list[Overall]:
    """How far the simulation misses where nothing was found: on a bench unit by unit."""
    if compared(tables) is READINGS:
        misses = reading_misses(tables)
        units = [] if misses is None else list(dict.fromkeys(misses["unit"]))
        return [one for unit in units if (one := _of_readings(unit, tables, held_out)) is not None]
    told = next((row for row in rows if row.rms[0] is not None), None)
    size = None if told is None else (told.held_out if held_out else told.rms)[0]
    return [] if told is None or size is None else [Overall(size, size, told.floor, told.unit, held_out)]


def _of_readings(unit: str, tables: Tables, held_out: bool) -> Overall | None:
    misses = reading_misses(tables)
    if misses is None:
        return None
    own = misses[(misses["unit"] == unit) & ((misses["role"] == "verification") == held_out)]
    if not len(own):
        return None
    floor = root_mean_square(own["sigma"]) if own["sigma"].notna().all() else None
    before, after = root_mean_square(own["before"]), root_mean_square(own["after"])
    return Overall(before, after, floor, unit, held_out, "declared noise")
