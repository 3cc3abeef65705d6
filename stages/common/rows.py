"""Rows of one artifact, collected column by column."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa

from truing.schemas.artifacts import ARTIFACTS


@dataclass
class Rows:
    """Rows of one artifact, collected column by column; missing columns of a row are empty."""

    artifact: str
    columns: dict[str, list[object]] = field(default_factory=dict)
    count: int = 0

    def add(self, **values: object) -> None:
        """Add one row, or one row per element of sequences of equal length."""
        length = max((len(v) for v in values.values() if isinstance(v, (list, np.ndarray))), default=1)
        for name in dict.fromkeys((*self.columns, *values)):  # an order of columns independent of hashes
            column = self.columns.setdefault(name, [None] * self.count)
            value = values.get(name)
            column.extend(list(value) if isinstance(value, (list, np.ndarray)) else [value] * length)
        self.count += length

    def extend(self, others: Rows) -> None:
        """Append the rows of another listing of the same artifact."""
        for k in range(others.count):
            self.add(**{name: values[k] for name, values in others.columns.items()})

    def table(self, identifier: str = "int64") -> pa.Table:
        """The rows as the artifact's table."""
        artifact = ARTIFACTS[self.artifact]
        present = tuple(name for name in self.columns if name not in artifact.columns)
        schema = artifact.arrow_schema(identifier, present)
        filled = {name: self.columns.get(name, [None] * self.count) for name in schema.names}
        return pa.table([pa.array(filled[f.name], f.type, from_pandas=True) for f in schema], schema=schema)
