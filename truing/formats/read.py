"""Reading of a campaign table from all its raw files by their mappings, with all faults collected."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from truing.formats.compression import DAMAGED, Refused, open_plain, plain_path
from truing.formats.delimited import read_delimited, separator_of
from truing.formats.evaluation import TableBatch, evaluate
from truing.formats.faultlog import FaultLog, discreet_cells, shareable_value
from truing.formats.mapping import MappingPlan
from truing.formats.origins import RowCount, is_side_by_side
from truing.formats.patterns import TooSlow
from truing.formats.presets import added_format, format_of, with_preset
from truing.formats.raw import Kind, RawBatch, Unusable, Wanted
from truing.formats.raw_tables import RawTable
from truing.formats.source import CampaignFiles, RawFile
from truing.formats.text import EndlessLine, Lines, OpenQuotation, line_numbers, record_blocks, skip_lines, utf8_chunks
from truing.schemas.faults import Fault
from truing.schemas.mapping import FileMapping

if TYPE_CHECKING:
    from truing.formats.cloud_files import CloudLayout
    from truing.formats.colmap import Estimate

_POINTS = ("points", "targets", "resurveys")
OF_PHOTOGRAPHS: dict[str, tuple[str, ...]] = {
    "colmap": ("image_points", "cameras", *_POINTS),
    "photomodeler": ("image_points", "cameras", *_POINTS),
    "metashape xml": ("image_points", "cameras"),
    "phc": ("image_points",),
    "ior": ("cameras",),
    "scale": ("scale_bars",),
    "gsi": _POINTS,
}
T = TypeVar("T")
_MOST_COLUMNS = 30_000  # each is compared with the known names
CLOUDS = ("ply", "pcd")
_TEXT = frozenset({"delimited", "vstars", "aicon", "metashape", "tracker", "xyz", "trc"})


def read_of_photographs(
    file_format: str, raw: RawFile, path: Path, wanted: Wanted, table: str, estimate: Estimate | None
) -> Iterator[RawBatch]:
    """Yield the rows of ``table`` in a file, which is decompressed at ``path``; raises Unusable if it holds none."""
    tables = OF_PHOTOGRAPHS[file_format]
    if table not in tables:
        raise Unusable(f"a file of {table}: such a file is read as {' or '.join(tables)}")
    if file_format == "colmap":
        from truing.formats.colmap import read_colmap

        return read_colmap(path, wanted, table, raw.path, estimate)
    if file_format == "photomodeler":
        from truing.formats.photomodeler import read_photomodeler

        return read_photomodeler(path, wanted, table)
    if file_format == "metashape xml":
        from truing.formats.metashape_xml import read_metashape_xml

        return read_metashape_xml(path, wanted, table)
    if file_format == "gsi":
        from truing.formats.leica_gsi import read_gsi

        return read_gsi(path, wanted)
    from truing.formats.aicon import read_ior, read_phc, read_scale

    if file_format == "phc":
        return read_phc(raw, path, wanted)
    return read_ior(path, wanted) if file_format == "ior" else read_scale(path, wanted)


@dataclass(frozen=True)
class FileRows:
    """One raw file of a table, which can locate its records."""

    raw: RawFile
    entry: FileMapping
    format: str
    rows_per_record: int = 1

    def locate(self, records: Sequence[int]) -> list[int]:
        """Return the lines of a text file, or the rows from 1 of a binary table, at which records (ascending) begin.

        Fewer than requested if the file has changed since it was read.
        """
        records = [record * self.rows_per_record for record in records]
        try:
            if self.format == "xlsx":
                return self._rows_of_sheet(records)
            return self._lines_of(records) if self._is_text() else [record + 1 for record in records]
        except (*DAMAGED, UnicodeError, OpenQuotation, EndlessLine, Unusable, TooSlow, OSError):
            return []

    def _is_text(self) -> bool:
        return _is_separated(self.format) or (self.format in CLOUDS and self._layout.form == "ascii")

    @cached_property
    def _layout(self) -> CloudLayout:
        from truing.formats.point_cloud import cloud_layout

        with plain_path(self.raw) as path:
            return cloud_layout(path, self.format)

    def _lines_of(self, records: Sequence[int]) -> list[int]:
        entry = self._delimited()
        with open_plain(self.raw.path) as stream:
            first = next(record_blocks(utf8_chunks(stream, entry.encoding), entry.quote.encode()), b"")
        lines = Lines.of(entry, separator_of(entry, skip_lines(first, entry.skip_lines)))
        with open_plain(self.raw.path) as stream:
            return line_numbers(stream, entry, lines, entry.header is not False, records)

    def _rows_of_sheet(self, records: Sequence[int]) -> list[int]:
        from truing.formats.workbook import rows_of_records

        with plain_path(self.raw) as path:
            return rows_of_records(path, self.entry, records)

    def _delimited(self) -> FileMapping:
        if self.format in CLOUDS:
            from truing.formats.point_cloud import cloud_as_delimited

            return cloud_as_delimited(self._layout, self.entry)
        if self.format != "trc":
            return self.entry
        from truing.formats.motion_capture import trc_as_delimited

        with open_plain(self.raw.path) as stream:
            return trc_as_delimited(stream, self.entry)


def read_table(
    source: CampaignFiles, shape: RawTable, log: FaultLog, *, poses_as_text: bool = False
) -> Iterator[tuple[FileRows, TableBatch]]:
    """Yield the rows of a table, batch by batch, in the order of the mapping's entries and files.

    Columns have the contract's names and units; ``pose`` is int64 in batches with only integer poses, else text
    (always, with ``poses_as_text``). Faults are added to ``log``.
    """
    entries = source.entries(shape.name)
    if not source.is_mapped(shape.name) and len(entries) > 1:
        log.add(Fault(entries[1].paths[0], f"either this file or {entries[0].paths[0]}, not both"))
    reading = _TableReading(source, shape, log, poses_as_text)
    for entry in entries:
        for raw in _files(source, shape, entry, log):
            if _is_of_sheets(raw, entry):
                for mapping in _split_by_sheet(raw, entry, log):
                    yield from _read_file(raw, mapping, reading, is_of_sheets=True)
            else:
                yield from _read_file(raw, entry, reading)


def prefetched(items: Iterator[T]) -> Iterator[T]:
    """Yield the same items, with the next one prepared in a thread while the last one is used."""
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(next, items, None)
        while (item := coming.result()) is not None:
            coming = pool.submit(next, items, None)
            yield item


def _files(source: CampaignFiles, shape: RawTable, entry: FileMapping, log: FaultLog) -> Iterator[RawFile]:
    for pattern in entry.paths:
        matching_files = source.resolve(pattern)
        if not matching_files and not source.is_mapped(shape.name):
            log.add(Fault(pattern, "a regular file: no folder, no pipe or device, and no link that leads nowhere"))
        elif not matching_files:
            expected = source.why_nothing(pattern)
            log.add(Fault("campaign.toml", expected, column=f"files.{shape.name}.path", value=pattern))
        yield from matching_files


def _is_of_sheets(raw: RawFile, entry: FileMapping) -> bool:
    """True if an entry reads several sheets of a workbook; no name of a sheet holds an asterisk."""
    return isinstance(entry.sheet, str) and "*" in entry.sheet and format_of(raw, entry) == "xlsx"


def _split_by_sheet(raw: RawFile, entry: FileMapping, log: FaultLog) -> Iterator[FileMapping]:
    """Yield the mapping for each sheet that its glob names."""
    from truing.formats.workbook import sheets_like

    try:
        with plain_path(raw) as path:
            sheets = sheets_like(path, str(entry.sheet))
    except Unusable as error:
        log.add(Fault(raw.name, error.expected, error.row, error.column, error.value))
        return
    except (*DAMAGED, OSError) as error:
        log.add(_damage(raw.name, error, entry))
        return
    yield from (entry.model_copy(update={"sheet": name}) for name in sheets)


@dataclass(frozen=True)
class _TableReading:
    """A table that is read: the campaign's files, its columns, where faults go, and whether poses are texts."""

    source: CampaignFiles
    shape: RawTable
    log: FaultLog
    poses_as_text: bool


def _read_file(
    raw: RawFile, entry: FileMapping, reading: _TableReading, *, is_of_sheets: bool = False
) -> Iterator[tuple[FileRows, TableBatch]]:
    source, shape, log = reading.source, reading.shape, reading.log
    file_format = format_of(raw, entry)
    completed, preset = with_preset(entry, file_format, shape.name)
    side_by_side = (completed.rows_per_pose or 1) if is_side_by_side(completed, shape.name) else 1
    rows = FileRows(_with_sheet(raw, completed, file_format), completed, file_format, side_by_side)
    file_name, raw = rows.raw.name if is_of_sheets else raw.name, rows.raw
    outside = source.is_outside(raw)
    plans: list[MappingPlan] = []

    def wanted(names: tuple[str, ...], unit: str | None) -> Mapping[int, Kind] | None:
        if len(names) > _MOST_COLUMNS:
            log.add(Fault(raw.name, f"at most {_MOST_COLUMNS} columns", value=f"{len(names)} columns"))
            return None
        converged = completed if unit is None or completed.unit else completed.model_copy(update={"unit": unit})
        if file_format == "trc":
            converged = rows._delimited()
        plan = MappingPlan(converged, shape, file_name, names, preset, reading.poses_as_text, outside)
        misfits = plan.check()
        for misfit in misfits:
            log.add(Fault(raw.name, misfit.expected, column=misfit.column, value=misfit.value))
        plans.append(plan)
        return None if misfits else plan.kinds

    try:
        counted = RowCount(completed, side_by_side)
        for batch in counted.through(_raw_batches(rows, counted.hint(wanted), shape.name, source.estimate)):
            evaluated = evaluate(plans[0], batch)
            for faults in evaluated.faults:
                log.cells(raw.name, discreet_cells(faults) if outside else faults, rows.locate)
            yield rows, evaluated
    except Unusable as error:
        value = shareable_value(error.value) if outside else error.value
        log.add(Fault(raw.name, error.expected, error.row, error.column, value))
    except TooSlow as error:
        key, value = f"files.{shape.name}.{error.key}", shareable_value(error.text) if outside else error.text
        log.add(Fault("campaign.toml", error.expected, column=key, value=value))
    except (*DAMAGED, UnicodeError, OpenQuotation, EndlessLine, OSError) as error:
        log.add(_damage(raw.name, error, completed))


def _with_sheet(raw: RawFile, entry: FileMapping, file_format: str) -> RawFile:
    """Return the file under a name that includes the sheet that is read, if it has sheets."""
    if file_format != "xlsx":
        return raw
    from truing.formats.workbook import sheet_name

    try:
        with plain_path(raw) as path:
            return RawFile(f"{raw.name}, sheet {sheet_name(path, entry)}", raw.path)
    except (Unusable, *DAMAGED, OSError):
        return raw  # reported when it is read


def _is_separated(file_format: str) -> bool:
    """True if the reader of separated text reads a format."""
    added = None if file_format in _TEXT else added_format(file_format)
    return file_format in _TEXT or (added is not None and added.is_text)


def _raw_batches(rows: FileRows, wanted: Wanted, table: str, estimate: Estimate | None) -> Iterator[RawBatch]:
    if _is_separated(rows.format):
        with open_plain(rows.raw.path) as stream:
            yield from read_delimited(stream, rows._delimited(), wanted)
        return
    with plain_path(rows.raw) as path:
        if rows.format == "parquet":
            from truing.formats.parquet import read_parquet

            yield from read_parquet(path, wanted)
        elif rows.format == "xlsx":
            from truing.formats.workbook import read_workbook

            yield from read_workbook(path, wanted, rows.entry)
        elif rows.format == "mat":
            from truing.formats.matlab import read_matlab

            yield from read_matlab(path, wanted, rows.entry)
        elif rows.format == "c3d":
            from truing.formats.motion_capture import read_c3d

            yield from read_c3d(path, wanted)
        elif rows.format == "inspection":
            from truing.formats.inspection import read_inspection

            yield from read_inspection(path, wanted, rows.entry)
        elif rows.format == "fanuc":
            from truing.formats.fanuc import read_fanuc

            yield from read_fanuc(path, wanted, rows.entry)
        elif rows.format == "rtl":
            from truing.formats.renishaw import read_rtl

            yield from read_rtl(path, wanted, rows.entry)
        elif rows.format in OF_PHOTOGRAPHS:
            yield from read_of_photographs(rows.format, rows.raw, path, wanted, table, estimate)
        elif (added := added_format(rows.format)) is not None:
            yield from added.read(path, wanted)
        else:
            from truing.formats.point_cloud import read_point_cloud

            yield from read_point_cloud(path, rows.format, rows.entry, wanted)


def _damage(file: str, error: Exception, entry: FileMapping) -> Fault:
    if isinstance(error, Refused):
        return Fault(file, error.expected, value=error.found)
    if isinstance(error, UnicodeError):
        bad_bytes = str(error.object[error.start])[:8] if isinstance(error, UnicodeDecodeError) else None
        return Fault(file, f"text in {entry.encoding}; another encoding may fit", value=bad_bytes)
    if isinstance(error, EndlessLine):
        return Fault(file, f"lines of at most {error.longest >> 20} MB")
    if isinstance(error, OpenQuotation):
        return Fault(
            file,
            f'a closing quotation mark for every {entry.quote}; where they are marks like any other set quote = ""',
        )
    if isinstance(error, DAMAGED):
        return Fault(
            file, "an undamaged compressed file; this one ends early or is damaged", value=str(error)[:80] or None
        )
    return Fault(file, "a file that can be read", value=str(error)[:120])
