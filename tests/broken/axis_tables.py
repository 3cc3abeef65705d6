"""Faults of an axis' positioning runs, of which no accuracy may be stated."""

from __future__ import annotations

from collections.abc import Callable

from tests.broken.spoiling import Broken, Spoil, cell, cells, every, replaced, scaled, without
from truing.pipeline.problems import ExitCode

_TABLE = "positioning.csv"
_STEP_MM = 1e-4


def _positions(change: Callable[[float], float], rows: Callable[[dict[str, str]], bool] = every) -> Spoil:
    return cells(_TABLE, "position_mm", lambda text: f"{change(float(text)):.7f}", rows)


def _cycle(*numbers: str) -> Callable[[dict[str, str]], bool]:
    return lambda row: row["cycle"] in numbers


def _failing(name: str, spoil: Spoil, said: str) -> Broken:
    return Broken(f"axis-{name}", "axis", spoil, (said,), ExitCode.FAILED_CHECK, whole=True)


CASES = (
    _failing("in-metres", cells(_TABLE, "position_mm", scaled(1e-3), every), "positions-against-targets run X"),
    _failing("in-inches", cells(_TABLE, "position_mm", scaled(1 / 25.4), every), "positions-against-targets run X"),
    _failing("sign-turned", cells(_TABLE, "position_mm", scaled(-1.0), every), "positions-against-targets run X"),
    _failing("overflowed", _positions(lambda x: x + _STEP_MM * 2**16, _cycle("4", "5")), "encoder-overflow run X"),
    _failing("zeroed-anew", _positions(lambda x: x + 0.05, _cycle("3", "4", "5")), "position-jumps run X"),
    _failing("digit-mistyped", cell(_TABLE, 20, "position_mm", "210.1"), "position-errors run X"),
    _failing("frozen", _positions(lambda x: 10.0), "copied-approaches run X"),
    Broken("axis-one-side", "axis", without(_TABLE, lambda row: row["direction"] == "backward"), ("both sides",)),
    Broken("axis-approach-lost", "axis", without(_TABLE, lambda row: row["cycle"] == "3" and row["target_mm"] == "10"),
           ("2 approaches missing",)),
    Broken("axis-columns-exchanged", "axis", replaced(_TABLE, "target_mm,direction,cycle,position_mm",
                                                      "position_mm,direction,cycle,target_mm"),
           ("target_mm and position_mm exchanged",)),
)  # fmt: skip
