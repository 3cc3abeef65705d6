"""What the page of a comparison is made of: runs with their tables, the numbers, and what was judged between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from truing.report.diagnosis.effect_units import handy_unit
from truing.report.numbers import printed, with_uncertainty
from truing.report.parameter_names import name_of, shown_in
from truing.report.tables import Tables, cell

if TYPE_CHECKING:
    import pandas as pd

_COMPLIANCE = {"m/N": (1e9, "nm/N"), "m/(N m)": (1e9, "nm/(N·m)"), "rad/N": (1e9, "nrad/N")}
_COMPLIANCE |= {"rad/(N m)": (1e9, "nrad/(N·m)")}


@dataclass(frozen=True)
class Compared:
    """A run as the page shows it: its label, folder, software version, and its tables by artifact name."""

    label: str
    folder: str
    version: str
    tables: Tables


@dataclass(frozen=True)
class Between:
    """From a run to the next: why some or all numbers were not judged, and whether too much changed to be named."""

    why: tuple[str, ...]
    rebuilt: bool


@dataclass(frozen=True)
class Comparison:
    """The runs in their order, compared.parquet as a frame, and what lies between each two neighbours."""

    runs: tuple[Compared, ...]
    numbers: pd.DataFrame
    between: tuple[Between, ...]

    def judged(self, step: int) -> pd.DataFrame:
        """The numbers of the run after a step (0 is from the first run to the second) that were judged."""
        own = self.numbers[self.numbers["place"] == step + 2]
        return own[own["z"].notna() | own["changed"]]

    def pair(self, step: int) -> str:
        """``first → second``."""
        return f"{self.runs[step].label} → {self.runs[step + 1].label}"


def called(row: Any) -> str:
    """A number as a sentence names it, with the effect or the matrix that it belongs to."""
    if row.group in ("compliance", "G_B"):
        return f"{row.group} {row.parameter}"
    leg = row.leg if row.leg is not None else float("nan")
    return (
        f"{name_of(row.parameter, leg)} of {cell(row.effect_of)}"
        if row.group == "effect"
        else name_of(row.parameter, leg)
    )


def unit_of(row: Any, size: float) -> tuple[float, str]:
    """Factor and unit in which a number of about this size is shown."""
    if row.group == "compliance":
        return _COMPLIANCE.get(row.unit, (1.0, row.unit))
    if row.group == "effect":
        factor, unit = handy_unit(row.parameter, row.unit, size)
        return factor, printed(unit)
    return shown_in(row.parameter, row.unit)


def told(row: Any) -> str:
    """A number with its sigma, in the unit that suits it."""
    factor, unit = unit_of(row, max(abs(row.value), row.sigma if row.sigma == row.sigma else 0.0))
    return with_uncertainty(factor * row.value, factor * row.sigma, unit)


def told_change(row: Any) -> str:
    """By how much a number changed: of what changed beyond chance, were the changed ones the only ones."""
    change, sigma = (
        (row.change, row.sigma_change) if row.change == row.change else (row.difference, row.sigma_difference)
    )
    factor, unit = unit_of(row, max(abs(change), sigma))
    if unit == "mm" and abs(factor * change) < 1.0:
        factor, unit = 1e3 * factor, "µm"
    return with_uncertainty(factor * change, factor * sigma, unit)
