"""First rows of a raw file, read as `truing init` proposes."""

from __future__ import annotations

import glob
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from truing.formats import raw_tables
from truing.formats.evaluation import TableBatch
from truing.formats.faultlog import FaultLog
from truing.formats.guess import MappingKeys
from truing.formats.read import read_table
from truing.formats.source import CampaignFiles
from truing.schemas.campaign import read_campaign
from truing.schemas.columns import find_column
from truing.schemas.faults import CampaignFaults

_ROWS, _COLUMNS = 3, 12
_ROWS_OF_BODY, _BODIES = 2, 6
_SECONDS_OF_DATES = 1e8  # three years: of no campaign
_SHAPES = {
    shape.name: shape
    for shape in (
        *(
            raw_tables.POINTS,
            raw_tables.TARGETS,
            raw_tables.POSES,
            raw_tables.DISTANCES,
            raw_tables.SCANS,
            raw_tables.SURFACES,
        ),
        *(
            raw_tables.CONFIGURATIONS,
            raw_tables.DISPLACEMENT,
            raw_tables.INTERFEROMETER,
            raw_tables.SIGNALS,
            raw_tables.LOADS_APART,
        ),
        raw_tables.MEASURED_APART,
        *(
            raw_tables.QUADRATURE,
            raw_tables.POSITIONING,
            raw_tables.PUBLISHED,
            raw_tables.IMAGE_POINTS,
            raw_tables.SCALE_BARS,
            raw_tables.KNOWN_POINTS,
        ),
    )
}


@dataclass(frozen=True)
class Preview:
    """Columns with units, and first rows; or the fault because of which there are none."""

    columns: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    fault: str = ""


def preview(folder: Path, files: Sequence[Path], table: str, kind: str, mapping: MappingKeys) -> Preview | None:
    """First rows of each body of the first file, and the first row of the last file, by their mapping.

    kind: of the campaign. None for a table without such rows.
    """
    if table not in _SHAPES:
        return None
    shown: list[Preview] = []
    for number, file in enumerate(dict.fromkeys((files[0], files[-1]))):
        log = FaultLog()
        try:
            batch = first_rows(folder, file, table, kind, mapping, log)
        except CampaignFaults as error:
            return Preview(fault=str(error.faults[0]))
        if batch is None:
            none = f"{file.name}: no row with all columns of the table {table}"
            return Preview(fault=str(next(iter(log.faults()), none)))
        shown.append(_shown(batch, _rows_to_show(batch) if not number else [0]))
    is_like = all(one.columns == shown[0].columns for one in shown)
    rows = tuple(row for one in (shown if is_like else shown[:1]) for row in one.rows)
    return Preview(shown[0].columns, rows)


def first_rows(
    folder: Path, example: Path, table: str, kind: str, mapping: Mapping[str, object], log: FaultLog | None = None
) -> TableBatch | None:
    """First batch of a file's rows by its mapping; None without rows. Raises CampaignFaults for an invalid mapping."""
    return next((batch for batch in batches(folder, example, table, kind, mapping, log) if batch.rows), None)


def batches(
    folder: Path, example: Path, table: str, kind: str, mapping: Mapping[str, object], log: FaultLog | None = None
) -> Iterator[TableBatch]:
    """Yield the rows of a file by its mapping, batch by batch. Raises CampaignFaults for an invalid mapping."""
    entry = {**mapping, "path": glob.escape(example.relative_to(folder).as_posix())}
    campaign = read_campaign({"campaign": {"name": "preview", "kind": kind}, "files": {table: entry}})
    read = read_table(CampaignFiles(folder, campaign), _SHAPES[table], log or FaultLog())
    yield from (batch for _, batch in read)


def named_cells(
    folder: Path, path: Path, table: str, kind: str, mapping: Mapping[str, object], names: Sequence[str], most: int
) -> list[tuple[str, ...]] | None:
    """Return the cells of some columns of a file, row by row, empty where it lacks one; None if it cannot be read, or
    has more than ``most`` rows."""
    rows = list[tuple[str, ...]]()
    try:
        for batch in batches(folder, path, table, kind, mapping):
            texts = [
                map(str, batch.columns[name].to_pylist()) if name in batch.columns else [""] * batch.rows
                for name in names
            ]
            rows.extend(zip(*texts, strict=True))
            if len(rows) > most:
                return None
    except CampaignFaults:
        return None
    return rows


def _rows_to_show(batch: TableBatch) -> list[int]:
    """First rows of a batch; the first of each body where there are several."""
    if "body" not in batch.columns:
        return _rows_with_numbers(batch)
    rows: dict[object, list[int]] = {}
    for row, body in enumerate(batch.columns["body"].to_pylist()):
        rows.setdefault(body, []).append(row)
    each = _ROWS if len(rows) == 1 else _ROWS_OF_BODY
    return [row for own in list(rows.values())[:_BODIES] for row in own[:each]]


def _rows_with_numbers(batch: TableBatch) -> list[int]:
    """First rows of a batch, and the first rows in which columns that are zero there have another number."""
    rows = list(range(min(_ROWS, batch.rows)))
    for name in list(batch.columns)[:_COLUMNS]:
        values = batch.columns[name].to_pylist()
        if all(values[row] in (0, 0.0, None) for row in rows):
            rows += [next((row for row, value in enumerate(values) if value not in (0, 0.0, None)), 0)]
    return sorted(set(rows))


def _shown(batch: TableBatch, chosen: Sequence[int]) -> Preview:
    names = list(batch.columns)[:_COLUMNS]
    columns = [[batch.columns[name][row].as_py() for row in chosen] for name in names]
    if "time_s" in names:
        columns[names.index("time_s")] = _from_the_first(columns[names.index("time_s")])
    rows = tuple(tuple(map(_cell, row)) for row in zip(*columns, strict=True))
    return Preview(tuple(map(_with_unit, names)), rows)


def _from_the_first(times: list[float | None]) -> list[float | None]:
    """Times of dates, which count from the earliest; others as they are."""
    known = [time for time in times if time is not None]
    if not known or abs(known[0]) < _SECONDS_OF_DATES:
        return times
    return [None if time is None else round(time - min(known), 6) for time in times]


def _with_unit(name: str) -> str:
    """A column with its unit; most names end with it."""
    known = find_column(name)
    return name if known is None or not known.unit or known.unit == "1" or "_" in name else f"{name} [{known.unit}]"


def _cell(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.9g}" if isinstance(value, float) else str(value)
