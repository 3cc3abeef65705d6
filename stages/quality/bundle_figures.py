"""The figures of an adjustment of photographs as its checks look them up, and rows of its tables."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pyarrow as pa


class Figures:
    """The rows of bundle_statistics by figure and subject."""

    def __init__(self, table: pa.Table) -> None:
        rows = zip(*(table.column(name).to_pylist() for name in ("figure", "subject", "value")), strict=True)
        self.values: dict[str, dict[str, float]] = {}
        for figure, subject, value in rows:
            self.values.setdefault(figure, {})[subject] = value

    def told(self, figure: str) -> dict[str, float]:
        """Values by subject."""
        return self.values.get(figure, {})


def rows_of(table: pa.Table, column: str, value: object) -> pa.Table:
    """The rows in which a column has a value."""
    import pyarrow.compute as pc

    return table.filter(pc.equal(table.column(column), value))
