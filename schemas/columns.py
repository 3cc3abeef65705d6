"""Every column of every artifact, defined once."""

from __future__ import annotations

from truing.schemas.column import Column
from truing.schemas.columns_of_measurements import (
    CAMPAIGN_LIFE,
    CONFIGURATIONS,
    DEFORMATION,
    IDENTITY,
    LOADS,
    POINTS,
    POSES,
    QUALITY,
    REPEATS,
    RESIDUALS,
)
from truing.schemas.columns_of_photographs import PHOTOGRAPHS
from truing.schemas.columns_of_results import (
    CALIBRATION,
    COMPARED,
    DIAGNOSIS,
    EXTENSION,
    READING_ERRORS,
    REQUIREMENTS,
    SENSOR,
    UNCERTAINTY,
)

COLUMNS: dict[str, Column] = {
    column.name: column
    for group in (
        IDENTITY,
        CAMPAIGN_LIFE,
        REPEATS,
        POINTS,
        PHOTOGRAPHS,
        CONFIGURATIONS,
        POSES,
        RESIDUALS,
        DEFORMATION,
        LOADS,
        QUALITY,
        DIAGNOSIS,
        EXTENSION,
        COMPARED,
        READING_ERRORS,
        CALIBRATION,
        SENSOR,
        REQUIREMENTS,
        UNCERTAINTY,
    )
    for column in group
}


def find_column(name: str) -> Column | None:
    """The definition that covers a column's name, families included, or None."""
    exact = COLUMNS.get(name)
    if exact is not None and not exact.family:
        return exact
    return next((column for column in COLUMNS.values() if column.family and column.matches(name)), None)
