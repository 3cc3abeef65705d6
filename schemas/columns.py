"""All columns by name, each defined once."""

from __future__ import annotations

from collections.abc import Iterable

from truing.schemas.calibration_columns import CALIBRATION_COLUMNS
from truing.schemas.column import Column
from truing.schemas.diagnosis_columns import DIAGNOSIS_COLUMNS
from truing.schemas.load_columns import LOAD_COLUMNS
from truing.schemas.measured_columns import MEASURED_COLUMNS
from truing.schemas.photograph_columns import PHOTOGRAPH_COLUMNS
from truing.schemas.quality_columns import QUALITY_COLUMNS


def by_name(columns: Iterable[Column]) -> dict[str, Column]:
    """Columns by name; raises ValueError for a name that is defined twice."""
    found: dict[str, Column] = {}
    for column in columns:
        if column.name in found:
            raise ValueError(
                f"the column {column.name} is defined twice: {found[column.name].meaning}; {column.meaning}"
            )
        found[column.name] = column
    return found


def find_column(name: str) -> Column | None:
    """Definition of a column by its name, families included, or None."""
    exact = COLUMNS.get(name)
    if exact is not None and not exact.family:
        return exact
    return next((column for column in COLUMNS.values() if column.family and column.matches(name)), None)


COLUMNS = by_name(
    (
        *MEASURED_COLUMNS,
        *LOAD_COLUMNS,
        *QUALITY_COLUMNS,
        *PHOTOGRAPH_COLUMNS,
        *DIAGNOSIS_COLUMNS,
        *CALIBRATION_COLUMNS,
    )
)
