"""Chosen targets of an axis and their detectable effects, in tables and words."""

from __future__ import annotations

from dataclasses import dataclass

import pyarrow as pa
from numpy.typing import NDArray

from truing.calibration.axis_design import ChosenTargets
from truing.report.numbers import count_text, printed, sign
from truing.report.power_page import size_rows
from truing.stages.configurations.chosen import DesignOptions

_CYCLES = 5  # of ISO 230-2


@dataclass(frozen=True)
class AxisDesignTables:
    """The campaign's own rows, measured or planned, and rows to keep."""

    own: pa.Table | None = None
    extend: pa.Table | None = None
    extend_file: str = "--extend"


@dataclass(frozen=True)
class AxisDesign:
    """Chosen targets (P,) in ``unit``, visited in ``cycles`` within ``travel``, and their quality.

    ``step`` and ``own_step`` are the steps of a lattice on which the targets or the campaign's own commands lie;
    ``even_step`` that of as many targets in equal steps. ``sizes`` and ``own_sizes`` are the effects that theory
    expects to be found, as in `truing power`.
    """

    options: DesignOptions
    unit: str
    table: pa.Table
    cycles: int
    travel: tuple[float, float]
    targets: NDArray
    even_step: float
    chosen: ChosenTargets
    kept: int
    step: float | None
    sizes: pa.Table | None
    own_rows: int
    own_step: float | None
    own_sizes: pa.Table | None


def words_of_axis(design: AxisDesign) -> list[str]:
    """Output lines of a design of an axis."""
    return [*_chosen(design), *_aliases(design), *_visits(design), *_shown(design)]


def _chosen(design: AxisDesign) -> list[str]:
    chosen, (low, high) = design.chosen, design.travel
    kept = f" next to {count_text(design.kept, 'row')} that are kept" if design.kept else ""
    rows = sum(role == "calibration" for role in design.table.column("role").to_pylist())
    unit = sign(design.unit)
    by = f"by {design.options.method}{kept}"
    visits = f"each from both sides in {count_text(design.cycles, 'cycle')}: {count_text(rows, 'reading')} with turns"
    periods = ", which differ in the period of a periodic error" if chosen.models > 1 else ""
    return [
        f"{count_text(len(design.targets), 'target')} within {low:g} to {high:g} {unit}, one in each of as many equal "
        f"parts, {by}; {visits}",
        f"targets ({unit}): {', '.join(f'{target:g}' for target in design.targets)}",
        f"D-efficiency {_percent(chosen.efficiency)} of the best of any targets (equivalence theorem over "
        f"{count_text(chosen.models, 'model')} of {count_text(chosen.unknowns, 'unknown')}{periods}; "
        f"as many targets in equal steps have {_percent(chosen.even)})",
    ]


def _aliases(design: AxisDesign) -> list[str]:
    unit = sign(design.unit)
    lines = []
    if design.step is not None:
        lines.append(f"the targets lie at multiples of {design.step:.4g} {unit}: {_same(design.step, unit)}")
    else:
        lines.append(
            f"targets in equal steps of {design.even_step:.4g} {unit} would show no periodic error of that period or a "
            "whole fraction of it, because it is the same at all of them; these targets are unevenly spaced"
        )
    if design.own_step is not None:
        own_commands = f"the campaign's own commands lie at multiples of {design.own_step:.4g} {unit}"
        lines.append(f"{own_commands}: {_same(design.own_step, unit)}")
    return lines


def _same(step: float, unit: str) -> str:
    """The periodic errors that targets at multiples of a step cannot resolve, in words."""
    return (
        f"a periodic error of period {step:.4g} {unit}, or of a whole fraction of it, is the same at all of them, and "
        f"any other short period looks like a longer one"
    )


def _visits(design: AxisDesign) -> list[str]:
    lines = ["rows at the ends of the travel are turns, so that every target is approached from a known side"]
    if design.cycles < _CYCLES:
        needed = _CYCLES * (2 * len(design.targets) + 2)
        lines.append(
            f"ISO 230-2 asks for {_CYCLES} cycles: {needed} readings of as many targets (--poses {needed} --cycles "
            f"{_CYCLES})"
        )
    return lines


def _shown(design: AxisDesign) -> list[str]:
    lines = _sizes(f"the chosen {count_text(design.table.num_rows, 'row')}", design.sizes)
    return lines + (_sizes(f"the campaign's own {count_text(design.own_rows, 'row')}", design.own_sizes))


def _sizes(whose: str, sizes: pa.Table | None) -> list[str]:
    """Return the detectable sizes of one set of rows, and the effects that no row shows."""
    if sizes is None:
        return []
    frame = sizes.to_pandas()
    rows = [(cause, concerns, size) for cause, concerns, size, *_ in size_rows(frame)]
    first: dict[str, str] = {}
    for cause, _, size in rows:
        first.setdefault(cause, size)
    return [f"{whose} show with 80 % probability, by theory:", *(f"  {cause}: {size}" for cause, size in first.items())]


def _percent(share: float) -> str:
    return printed(f"{100 * share:.2f} %")
