"""Where a mapping contradicts the names in its file: a unit in brackets, an expanded uncertainty taken as one sigma."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from schemas.mapping import is_uncertainty
from truing.formats.header_units import expanded, unit_in_brackets
from truing.formats.units import UnknownUnit, conversion

if TYPE_CHECKING:
    from truing.formats.mapping import Plan


@dataclass(frozen=True)
class Misfit:
    """A mapping that does not fit its file: what was expected, and of which column."""

    expected: str
    column: str | None = None
    value: str | None = None


def told_otherwise(plan: Plan) -> Iterator[Misfit]:
    """Columns whose raw name says another unit than they are read in, or that they are no standard deviation."""
    for name, column in plan.columns.items():
        raw = plan.raw_name(name)
        if name in plan.preset or name in plan.unasked or raw == name:
            continue
        unit = unit_in_brackets(raw)
        if unit is not None and column.unit and not plan.is_given_unit(name) and _differs(unit, column.unit):
            yield Misfit(f'its unit, as {raw} is not in {column.unit}: units = {{ {name} = "{unit}" }}', column=name)
        said = expanded(raw) if is_uncertainty(name) else None
        if said is not None and plan.entry.value(name).coverage is None:
            cure = f"coverage = {said.coverage:g} where it is U = k sigma, coverage = 1 where it is one sigma"
            yield Misfit(f"one standard deviation, or the coverage factor of {raw} ({said.why}): {cure}", column=name)


def _differs(unit: str, wanted: str) -> bool:
    """Whether two units of one dimension are not the same."""
    try:
        return conversion(unit, wanted) != (1.0, 0.0)
    except UnknownUnit:
        return False
