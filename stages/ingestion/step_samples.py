"""Several samples of a load step: their mean is its reading."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stages.ingestion.gathered_columns import numbered, numbers, without
from truing.formats.gather import Gathered

_OF_A_STEP = ("run", "step", "channel")


def averaged(found: Gathered) -> Gathered:
    """One row per run, step and channel: the mean of every column of real numbers over the samples that have it."""
    import pyarrow as pa

    _, first, at = np.unique(numbered(found, *_OF_A_STEP), return_index=True, return_inverse=True)
    further = np.ones(len(at), dtype=bool)
    further[first] = False
    rows = without(found, further, "")
    table = rows.table
    for place, name in enumerate(table.column_names):
        if name in _OF_A_STEP or not pa.types.is_floating(table.schema.field(name).type):
            continue
        values = numbers(found, name)
        known = np.isfinite(values)
        count = np.bincount(at, known)
        total = np.bincount(at, np.where(known, values, 0.0))
        means = np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)
        table = table.set_column(place, name, pa.array(means[at[~further]], from_pandas=True))
    return replace(rows, table=table, left_out=found.left_out)
