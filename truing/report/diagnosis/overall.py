"""How far predictions miss before anything is accepted and after everything is, as a whole."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from truing.report.diagnosis.compared import READINGS, compared
from truing.report.diagnosis.judged import Judged, whole_gain
from truing.report.diagnosis.reading_misses import reading_misses, root_mean_square
from truing.report.tables import Tables, filled

if TYPE_CHECKING:
    import pandas as pd

_FEWEST_POSES = 8  # whose scatter tells how much a pose is worth


# Against noise: errors of at most so many times the noise floor, or of so many times less, are called at it.
AT_THE_FLOOR = 1.1
# How rarely chance leaves errors that are called smaller than noise allows.
_UNLIKELY = 1e-3


@dataclass(frozen=True)
class Overall:
    """Rms of measured minus predicted before and after; ``freedom``: independent numbers in it, 0 where unknown."""

    before: float
    after: float
    floor: float | None
    unit: str
    held_out: bool
    freedom: float = 0.0

    @property
    def is_below_noise(self) -> bool:
        """Whether noise as large as declared would hardly ever leave so little."""
        if self.floor is None or self.after * AT_THE_FLOOR >= self.floor or not self.freedom > 0.0:
            return False
        from scipy.special import chdtr

        return bool(chdtr(self.freedom, self.freedom * (self.after / self.floor) ** 2) < _UNLIKELY)

    @property
    def why_below(self) -> str:
        """What makes errors smaller than the declared noise allows."""
        large = "the declared noise is too large"
        return large if self.held_out else f"{large}, or the model is over-fitted"


def overall(found: list[Judged], tables: Tables, *, held_out: bool) -> Overall | None:
    """What all findings together bring; None where it was not evaluated, or in mixed units.

    A finding on a bench is told over the channels that it moves. Several are told over all channels of the unit in
    which they bring most, beside what noise alone leaves in these.
    """
    effects = [row for row in found if not row.is_noise]
    if compared(tables) is READINGS and len(effects) > 1:
        units = dict.fromkeys(row.unit for row in effects)
        told = [one for unit in units if (one := _of_readings(unit, tables, held_out)) is not None]
        return max(told, key=lambda one: one.before / one.after if one.after > 0.0 else 1.0, default=None)
    pair = whole_gain(found, held_out)
    if pair is None:
        return None
    unit = effects[-1].unit
    return Overall(*pair, effects[-1].floor, unit, held_out, _freedom(tables, unit, held_out))


def as_it_is(rows: list[Judged], tables: Tables, *, held_out: bool) -> list[Overall]:
    """How far the simulation misses where nothing was found: on a bench unit by unit."""
    if compared(tables) is READINGS:
        misses = reading_misses(tables)
        units = [] if misses is None else list(dict.fromkeys(misses["unit"]))
        return [one for unit in units if (one := _of_readings(unit, tables, held_out)) is not None]
    told = next((row for row in rows if row.rms[0] is not None), None)
    size = None if told is None else (told.held_out if held_out else told.rms)[0]
    return (
        []
        if told is None or size is None
        else [Overall(size, size, told.floor, told.unit, held_out, _freedom(tables, told.unit, held_out))]
    )


def _freedom(tables: Tables, unit: str, held_out: bool) -> float:
    """Independent numbers behind an rms, at least: readings of a channel less one zero per run; of points, poses.

    Numbers of one pose have errors in common. How many it is worth follows from the scatter of the poses' mean squares.
    """
    if compared(tables) is READINGS:
        own = _own_readings(unit, tables, held_out)
        if own is None:
            return 0.0
        zeros = own.groupby(["run", "channel"]).ngroups
        return max(len(own) - zeros, 0) / own["channel"].nunique()
    poses = filled(tables, "prediction")
    if poses is None:
        return 0.0
    squares = poses["rms_after"].dropna().to_numpy(dtype=float) ** 2
    worth = 1.0
    if len(squares) >= _FEWEST_POSES and squares.std(ddof=1) > 0.0:
        worth = max(1.0, 2.0 * float(squares.mean() / squares.std(ddof=1)) ** 2)
    return worth * int((poses["role"].eq("verification") == held_out).sum())


def _own_readings(unit: str, tables: Tables, held_out: bool) -> pd.DataFrame | None:
    misses = reading_misses(tables)
    if misses is None:
        return None
    own = misses[(misses["unit"] == unit) & ((misses["role"] == "verification") == held_out)]
    return own if len(own) else None


def _of_readings(unit: str, tables: Tables, held_out: bool) -> Overall | None:
    own = _own_readings(unit, tables, held_out)
    if own is None:
        return None
    floor = root_mean_square(own["noise_floor"]) if own["noise_floor"].notna().all() else None
    before, after = root_mean_square(own["before"]), root_mean_square(own["after"])
    return Overall(before, after, floor, unit, held_out, _freedom(tables, unit, held_out))
