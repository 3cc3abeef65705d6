"""Published displacements under load, as printed: the table `published` of a loading campaign."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from truing.arrays import Array, TableRow
from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import PUBLISHED
from truing.formats.row_collection import CollectedRows, collect_rows
from truing.formats.source import CampaignFiles
from truing.schemas.faults import Fault
from truing.stages.common.rows import Rows
from truing.stages.common.table_arrays import check_unique_keys, numbers, texts, unit_factors
from truing.stages.ingestion.load_steps import UNITS_BY_AXIS
from truing.stages.ingestion.reading_table import UNITS

# Column of the file, its source, and the sign of its load.
_VALUES = (
    ("theoretical_maximum", "theory", 1.0),
    ("measured_positive", "measurement", 1.0),
    ("measured_negative", "measurement", -1.0),
)
_KEY = ("load_axis", "load", "channel")


def read_published(source: CampaignFiles, log: FaultLog) -> pa.Table | None:
    """The published values, one row each, um and arcsec; None where the campaign has none or a fault was noted."""
    rows = collect_rows(source, PUBLISHED, log)
    if rows is None:
        return None
    check_unique_keys(rows, log, *_KEY)
    names = [name for name, *_ in _VALUES if name in rows.table.column_names]
    if not names:
        expected = f"a column {' or '.join(name for name, *_ in _VALUES)}"
        log.add(Fault(rows.first_file, expected))
    load = numbers(rows, "load") * unit_factors(rows, "load", "load_axis", UNITS_BY_AXIS, log)
    rows.fault(log, ~(load > 0.0), "load", "the size of the load of these values, above 0, N or N m")
    _check_units(rows, log)
    if log:
        return None
    values = {name: _in_units(rows, name, log) for name in names}
    return None if log else _rows(rows, load, values).table()


def _check_units(collected: CollectedRows, log: FaultLog) -> None:
    """Note rows whose unit is not that of their channel."""
    if "unit" not in collected.table.column_names:
        return
    unit, channel = texts(collected, "unit"), texts(collected, "channel")
    for name, units_of_column in UNITS.items():
        wrong = (channel == name) & (unit != units_of_column) & (unit != "")
        collected.fault(log, np.asarray(wrong, dtype=bool), "unit", f"{units_of_column}, the unit of {name}")


def _in_units(collected: CollectedRows, name: str, log: FaultLog) -> Array:
    return numbers(collected, name) * unit_factors(collected, name, "channel", UNITS, log)


def _rows(collected: CollectedRows, load: Array, values: dict[str, Array]) -> Rows:
    axis, channel = texts(collected, "load_axis"), texts(collected, "channel")
    more: TableRow = {}
    if "figure" in collected.table.column_names:
        more["published_in"] = collected.table.column("figure").to_pylist()
    rows = Rows("published")
    for name, source, sign in _VALUES:
        known = np.flatnonzero(np.isfinite(values[name])) if name in values else np.zeros(0, int)
        for k in known:
            rows.add(
                load=axis[k],
                channel=channel[k],
                applied=sign * load[k],
                source=source,
                published=values[name][k],
                unit=UNITS[channel[k]],
                **{column: each[k] for column, each in more.items()},
            )
    return rows
