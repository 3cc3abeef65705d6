"""Evaluation of a mapping plan on a batch: reshaping, columns in the table's units, omitted rows and faults."""

from __future__ import annotations

import calendar
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from truing.arrays import Array, Mask
from truing.formats import sexagesimal
from truing.formats.dictionaries import (
    as_dictionary,
    codes,
    compacted,
    constant,
    integers,
    renamed,
    strings,
    with_values,
)
from truing.formats.faultlog import CellFaults, Records
from truing.formats.mapping import MappingPlan
from truing.formats.numbers import Notation
from truing.formats.origins import Constant, Joined, PatternGroup, RawColumn, RowNumber, Spread, joined_by
from truing.formats.patterns import bounded
from truing.formats.raw import RawBatch
from truing.formats.raw_tables import COORDINATES
from truing.schemas.column import LARGEST, Column
from truing.schemas.mapping import RawValue
from truing.schemas.near_names import mistyped_name

_NUMBER_IN_CELL = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf)", re.IGNORECASE)
_EXACT = 2**53  # float64 holds integers exactly up to here
_ANYTHING = ".+"  # `select` of a column that must not be empty


def converted_numbers(values: pa.Array, meant: RawValue) -> pa.Array:
    """Return numbers (N,) of a raw column converted as the mapping says, in its unit; null stays null."""
    if meant.is_plain:
        return values
    plain = np.array(values.cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=float)
    gone = np.asarray(values.is_null())
    with np.errstate(over="ignore", invalid="ignore"):  # non-finite results become faults
        plain = plain * meant.scale + meant.offset
        if meant.modulo is not None:
            lowest = meant.lowest or 0.0
            turned = np.mod(plain - lowest, meant.modulo)
            plain = np.where(turned < meant.modulo, turned, 0.0) + lowest  # just below 0 rounds to a whole period
    return pa.array(plain / (meant.coverage or 1.0), mask=gone)


def spread_arrays(plan: MappingPlan, batch: RawBatch) -> RawBatch:
    """Return a batch with one column for each number of cells that hold several."""
    if not plan.entry.arrays or not batch.rows:
        return batch
    columns, faults = dict(batch.columns), list(batch.faults)
    is_valid = np.ones(batch.rows, dtype=bool)
    for name, first, names in plan.arrays():
        position = plan.all_names.index(name)
        if position not in columns:
            continue
        cells = columns[position].cast("string")
        numbers_of_cell = [_NUMBER_IN_CELL.findall(cell or "") for cell in cells.to_pylist()]
        wrong = np.array([len(numbers) != len(names) for numbers in numbers_of_cell], dtype=bool)
        faults.append(CellFaults.where(wrong, batch.records, cells, name, f"{len(names)} numbers in the cell"))
        is_valid &= ~wrong
        for offset in range(len(names)):
            columns[first + offset] = strings(
                [numbers[offset] if len(numbers) > offset else "" for numbers in numbers_of_cell]
            )
    if not is_valid.all():
        columns = {key: values.filter(is_valid) for key, values in columns.items()}
    return RawBatch(columns, batch.records[is_valid], tuple(faults))


def widen(plan: MappingPlan, batch: RawBatch) -> RawBatch:
    """Return a batch with one row per target, if its records hold several targets side by side."""
    groups = plan.wide
    if not groups:
        return batch
    count = len(groups)
    repeated = pa.array(np.repeat(np.arange(batch.rows), count))
    of_groups = {position for group in groups for position in group.positions}
    columns = {key: values.take(repeated) for key, values in batch.columns.items() if key not in of_groups}
    for index, name in enumerate(plan.wide_columns):
        columns[name] = _interleaved([batch.columns[group.positions[index]] for group in groups])
    for label in groups[0].labels:
        named = pa.array(np.tile(np.arange(count, dtype=np.int32), batch.rows))
        columns[label] = pa.DictionaryArray.from_arrays(named, strings([group.labels[label] for group in groups]))
    records = np.repeat(batch.records, count)
    if plan.entry.wide_values is None:
        return RawBatch(columns, records, batch.faults)
    has_value = _given(columns[plan.entry.wide_values])
    values_given = {key: values.filter(pa.array(has_value)) for key, values in columns.items()}
    return RawBatch(values_given, records[has_value], batch.faults)


def _given(values: pa.Array) -> Mask:
    """Return the mask of cells with content."""
    texts = values.cast("string").to_pylist()
    return np.array([bool(text and text.strip()) for text in texts], bool)


def _interleaved(columns: list[pa.Array]) -> pa.Array:
    """Return the values of several columns, interleaved row by row."""
    rows, count = len(columns[0]), len(columns)
    order = np.arange(rows * count).reshape(count, rows).T.ravel()
    return pa.concat_arrays(columns).take(order)


@dataclass(frozen=True)
class TableBatch:
    """Rows of a table: columns by name in the units of their names, and the record of each row.

    ``faulty``: by column, rows with a reported faulty cell; columns without any are absent.
    """

    columns: dict[str, pa.Array]
    records: Records
    faults: tuple[CellFaults, ...] = ()
    left_out: Counter[str] = field(default_factory=Counter)
    faulty: dict[str, Mask] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.records)


def coordinates(batch: TableBatch) -> Array:
    """Return the points (N, 3) of a batch, mm."""
    return np.column_stack([np.asarray(batch.columns[name], dtype=float) for name in COORDINATES])


def evaluate(plan: MappingPlan, batch: RawBatch) -> TableBatch:
    """Return the table rows from a batch of raw records."""
    batch = widen(plan, spread_arrays(plan, batch))
    selection = _Work(plan, batch)
    chosen = selection.selected()
    work = _Work(plan, _filtered(batch, chosen))
    wanted = {name: column for name, column in plan.columns.items() if work.is_of_use(name)}
    work.faults += [fault for name in plan.columns if name not in wanted for fault in work.mistyped(name)]
    columns = {name: work.column(name, column) for name, column in wanted.items()}
    records, keep, faulty = work.batch.records, work.present(), work.reported
    if not keep.all():
        columns = {name: values.filter(keep) for name, values in columns.items()}
        records, faulty = records[keep], {name: determined[keep] for name, determined in faulty.items()}
    return TableBatch(columns, records, (*batch.faults, *work.faults), selection.left_out + work.left_out, faulty)


def _is_blank(texts: pa.Array) -> Mask:
    """Return the mask of cells without content."""
    return np.array(pc.equal(pc.utf8_trim_whitespace(texts.fill_null("")), ""))


def _filtered(batch: RawBatch, keep: Mask) -> RawBatch:
    """Return the rows to keep; dictionaries lose unused names."""
    if keep.all():
        return batch
    columns = {key: compacted(values.filter(keep)) for key, values in batch.columns.items()}
    return RawBatch(columns, batch.records[keep])


def _seconds(text: str, time_format: str) -> float | None:
    """Return seconds since 1970 in UTC, or as in UTC if the time has no zone; None if it does not match the format."""
    try:
        moment = datetime.strptime(text, time_format)
    except ValueError:
        return None
    return calendar.timegm(moment.utctimetuple()) + 1e-6 * moment.microsecond


@dataclass
class _Work:
    plan: MappingPlan
    batch: RawBatch
    faults: list[CellFaults] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)
    missing: list[Mask] = field(default_factory=list)
    broken: list[Mask] = field(default_factory=list)
    reported: dict[str, Mask] = field(default_factory=dict)

    @cached_property
    def notation(self) -> Notation:
        """Notation of the file's numbers."""
        entry = self.plan.entry
        return Notation(entry.decimal, entry.thousands, frozenset(entry.missing))

    @cached_property
    def _markers(self) -> list[float]:
        """Numbers that mean missing."""
        is_nan = any(text.casefold() == "nan" for text in self.notation.missing)
        return [*self.notation.missing_numbers, *([np.nan] if is_nan else [])]

    def column(self, name: str, column: Column) -> pa.Array:
        """Return one column of the table, in its type and unit."""
        if column.kind == "identifier":
            return self._identifiers(name)
        if column.kind == "text":
            return self._names(name, column)
        if name == "time_s" and self.plan.entry.time_format is not None:
            return self._times(name)
        values = self._scaled(name, column)
        return self._integers(name, values) if column.kind == "integer" else values

    def is_of_use(self, name: str) -> bool:
        """Return False for a column that was not requested and mostly holds no numbers."""
        if name not in self.plan.unnamed_covariates or self.plan.is_sexagesimal(name):
            return True
        values, bad = self.notation.parse(self._raw(name).cast("string"))
        return int(np.count_nonzero(bad)) <= len(values) - values.null_count

    def mistyped(self, name: str) -> Iterator[CellFaults]:
        """Yield the fault of an unasked column of text, if a known column lacks and has nearly its name."""
        missing = [known for known in self.plan.shape.known(()) if known not in self.plan.columns]
        if (near := mistyped_name(name, missing)) is not None:
            expected = f"numbers, in a column of your own; did you mean {near}? Else name it in ignore"
            filled = np.asarray(self._raw(name).is_valid())
            yield CellFaults.where(filled, self.batch.records, self._raw(name), name, expected)

    # -- text ---------------------------------------------------------------------------------------------

    def texts(self, name: str) -> pa.DictionaryArray:
        """Return a column as renamed text; rows that do not match a regular expression are omitted."""
        dictionary = self._texts(name)
        renames = self.plan.entry.rename.get(name)
        if renames is None:
            return dictionary
        patterns = [(bounded(pattern, f"rename.{name}"), text) for pattern, text in renames.items()]
        return with_values(dictionary, [renamed(text, patterns) for text in dictionary.dictionary.to_pylist()])

    def _texts(self, name: str) -> pa.DictionaryArray:
        origin = self.plan.origin(name)
        if isinstance(origin, Constant):
            return constant(str(origin.value), self.batch.rows)
        if isinstance(origin, RowNumber):
            return as_dictionary(strings(origin.of(self.batch.records).tolist()))
        if isinstance(origin, Joined):
            return self._joined_dictionary(origin)
        if isinstance(origin, PatternGroup):
            return self._group(origin)
        return as_dictionary(self._unnamed(name))

    def _raw(self, name: str) -> pa.Array:
        return self.texts(name) if name in self.plan.entry.rename else self._unnamed(name)

    def _unnamed(self, name: str) -> pa.Array:
        """Return a column as recorded in the file, or as constructed."""
        origin = self.plan.origin(name)
        if isinstance(origin, Spread):
            return self.batch.columns[origin.name]
        if isinstance(origin, RawColumn):
            return self.batch.columns[origin.position]
        if isinstance(origin, Constant) and isinstance(origin.value, float):  # a number of campaign.toml, not the file
            return pa.array(np.full(self.batch.rows, origin.value))
        return self.texts(name)

    def _joined_dictionary(self, origin: Joined) -> pa.DictionaryArray:
        parts = [self.texts(column).cast("string").to_pylist() for column in origin.columns]
        joined = [joined_by(origin.template, row) for row in zip(*parts, strict=True)]
        return as_dictionary(strings(joined))

    def _group(self, origin: PatternGroup) -> pa.DictionaryArray:
        texts = self._to_split(origin.column)
        matches = [origin.pattern.fullmatch(text or "") for text in texts.dictionary.to_pylist()]
        return with_values(texts, [(match[origin.name] or "") if match else "" for match in matches])

    def _to_split(self, name: str) -> pa.DictionaryArray:
        """Return a column before its split, which may define the column anew."""
        origin = self.plan.origin(name, within=name)
        if isinstance(origin, RawColumn):
            return as_dictionary(self.batch.columns[origin.position])
        return self.texts(name)

    def _names(self, name: str, column: Column) -> pa.DictionaryArray:
        texts = self.texts(name)
        values = texts.dictionary.to_pylist()
        if not column.nullable and name != "target":
            self._checked(np.array([bool(v) for v in values], dtype=bool), texts, name, f"a {name} in every row")
        if column.choices:
            known = np.array([not v or v in column.choices for v in values], dtype=bool)
            self._checked(known, texts, name, f"one of {', '.join(column.choices)}")
        return texts

    def _checked(self, is_valid: Mask, texts: pa.DictionaryArray, name: str, expected: str) -> None:
        wrong = ~is_valid[codes(texts)]
        if wrong.any():
            self._fault(wrong, texts, name, expected)

    def _identifiers(self, name: str) -> pa.Array:
        origin, shift = self.plan.origin(name), self.plan.entry.offset.get(name, 0)
        if isinstance(origin, RowNumber) and not self.plan.poses_as_text and name not in self.plan.entry.rename:
            return pa.array(origin.of(self.batch.records) + shift)
        raw = self._raw(name) if isinstance(origin, RawColumn) else None
        if raw is not None and pa.types.is_int64(raw.type) and name not in self.plan.entry.rename:
            return raw if not shift else pa.array(np.asarray(raw) + shift)
        return self._text_identifiers(name, shift)

    def _text_identifiers(self, name: str, shift: int) -> pa.Array:
        texts = self.texts(name)
        self._checked(np.asarray(pc.not_equal(texts.dictionary, "")), texts, name, f"a {name} in every row")
        numbers = pc.add(integers(texts.dictionary), shift)
        if shift:
            is_number = np.asarray(numbers.is_valid())
            self._checked(is_number, texts, name, "a whole number, as an offset is to be added")
        if self.plan.poses_as_text or numbers.null_count:
            shifted = numbers.cast(pa.string()) if shift else texts.dictionary
            return pa.DictionaryArray.from_arrays(texts.indices, shifted)
        return numbers.take(texts.indices)

    # -- numbers ------------------------------------------------------------------------------------------

    def _scaled(self, name: str, column: Column) -> pa.Array:
        raw = self._numbers(name, column)
        for position, sign in self.plan.added(name):
            addend = self._number_at(position, name)
            raw = pc.add(raw, addend) if sign > 0.0 else pc.subtract(raw, addend)
        values = converted_numbers(raw, self.plan.entry.value(name))
        factor, offset = self.plan.scale(name)
        shift = self.plan.entry.offset.get(name, 0)
        if (factor, offset, shift) != (1.0, 0.0, 0):
            values = pc.add(pc.multiply(pc.add(values, float(shift)), factor), offset)
        plain = np.asarray(values.fill_null(0.0) if values.null_count else values)
        finite = np.isfinite(plain)
        if not finite.all():
            self._checked_range(~finite, values, name, "a finite number")
            self.broken.append(~finite)
        immense = np.abs(plain) > LARGEST
        if immense.any():
            self._checked_range(immense & finite, values, name, f"at most {LARGEST:g} either way")
            self.broken.append(immense)
        if column.minimum is not None:
            self._checked_range(
                plain < column.minimum, values, name, f"at least {column.minimum:g} {column.unit}".rstrip()
            )
        if column.maximum is not None:
            self._checked_range(
                plain > column.maximum, values, name, f"at most {column.maximum:g} {column.unit}".rstrip()
            )
        return values if pa.types.is_float64(values.type) else values.cast(pa.float64())

    def _checked_range(self, wrong: Mask, values: pa.Array, name: str, expected: str) -> None:
        if values.null_count:
            wrong = wrong & np.asarray(values.is_valid())
        if wrong.any():
            self._fault(wrong, values, name, expected)

    def _numbers(self, name: str, column: Column) -> pa.Array:
        origin = self.plan.origin(name)
        if isinstance(origin, RowNumber):
            return pa.array(origin.of(self.batch.records).astype(float))
        raw = self._raw(name)
        is_number = pa.types.is_floating(raw.type) or pa.types.is_integer(raw.type)
        is_number = is_number and not self.plan.is_sexagesimal(name)
        if is_number and pa.types.is_float64(raw.type) and not raw.null_count and not self._markers:
            return raw
        if is_number:
            values, blank = raw.cast(pa.float64()), np.array(raw.is_null())
            broken = np.zeros(len(raw), dtype=bool)
        else:
            values, blank, broken = self._parsed(name, raw)
        values = self._without_missing(values)
        if name in COORDINATES and not column.nullable:
            blank &= "" not in self.notation.missing
            self.missing.append(np.asarray(values.is_null()))
            self.broken.append(blank | broken)
            self._check_present(blank, name, "a number; an empty cell has to be declared by missing")
        elif not column.nullable:
            self._check_present(np.asarray(values.is_null()) & ~broken, name, "a number in every row")
        return values

    def _number_at(self, position: int, name: str) -> pa.Array:
        """Return the numbers of a raw column that are added to those of the column ``name``."""
        raw = self.batch.columns[position]
        values = raw if pa.types.is_floating(raw.type) else self._parsed(name, raw)[0]
        return self._without_missing(values.cast(pa.float64()))

    def _parsed(self, name: str, raw: pa.Array) -> tuple[pa.Array, Mask, Mask]:
        """Return numbers, the mask of empty cells, and the mask of other content."""
        texts = raw.cast(pa.string())
        if self.plan.is_sexagesimal(name):
            absent = pc.is_in(
                pc.utf8_trim_whitespace(texts), value_set=pa.array(sorted(self.notation.missing), pa.string())
            )
            values, bad = sexagesimal.parsed_angles(pc.if_else(absent, pa.scalar(None, pa.string()), texts))
            self._fault(bad, texts, name, sexagesimal.EXPECTED)
            return values, _is_blank(texts), bad
        values, bad = self.notation.parse(texts)
        if bad.any():
            first = texts[int(np.flatnonzero(bad)[0])].as_py()
            expected = self.notation.advice(first)
            is_date = name == "time_s" and expected == "a number" and first[:1].isdigit()
            more = "; a time written as a date is read by time_format, such as %Y-%m-%d %H:%M:%S" if is_date else ""
            self._fault(bad, texts, name, expected + more)
        return values, _is_blank(texts), bad

    def _check_present(self, wrong: Mask, name: str, expected: str) -> None:
        if wrong.any():
            self._fault(wrong, None, name, expected, "")

    def _without_missing(self, values: pa.Array) -> pa.Array:
        if not self._markers:
            return values
        plain = np.asarray(values.fill_null(np.nan) if values.null_count else values)
        is_missing = np.logical_or.reduce([np.isnan(plain) if np.isnan(m) else plain == m for m in self._markers])
        return pa.array(plain, mask=is_missing | np.asarray(values.is_null()))

    def _integers(self, name: str, values: pa.Array) -> pa.Array:
        plain = np.asarray(values.fill_null(0.0))
        self._checked_range(plain != np.round(plain), values, name, "a whole number")
        self._checked_range(np.abs(plain) > _EXACT, values, name, f"at most {_EXACT} either way")
        # Larger or non-finite values are already reported.
        rounded = np.where(np.abs(plain) <= _EXACT, np.round(plain), 0.0)
        return pa.array(rounded.astype(np.int64), mask=np.asarray(values.is_null()))

    def _times(self, name: str) -> pa.Array:
        texts = self.texts(name)
        seconds = [_seconds(text, self.plan.entry.time_format or "") for text in texts.dictionary.to_pylist()]
        is_valid = np.array([second is not None for second in seconds], dtype=bool)
        self._checked(is_valid, texts, name, f"a time written as {self.plan.entry.time_format}")
        return pa.array(np.array([np.nan if s is None else s for s in seconds], dtype=float)[codes(texts)])

    # -- rows ---------------------------------------------------------------------------------------------

    def selected(self) -> Mask:
        """Return the mask of requested rows: selected, and matching the regular expressions."""
        keep = np.ones(self.batch.rows, dtype=bool)
        if not self.batch.rows:
            return keep
        entry = self.plan.entry
        columns = [(name, sentence, f"split.{name}", self._to_split(name)) for name, sentence in entry.split.items()]
        columns += [(name, sentence, f"select.{name}", self.texts(name)) for name, sentence in entry.select.items()]
        for name, sentence, key, texts in columns:
            pattern = bounded(sentence, key)
            fits = [pattern.fullmatch(text or "") is not None for text in texts.dictionary.to_pylist()]
            unselected = keep & ~np.array(fits, dtype=bool)[codes(texts)]
            self._leave_out(unselected, f"no {name}" if sentence == _ANYTHING else f"{name} is not like {sentence}")
            keep &= ~unselected
        return keep

    def present(self) -> Mask:
        """Return the mask of points without missing coordinates, single or as a triple."""
        everything = np.ones(self.batch.rows, dtype=bool)
        if not self.plan.shape.has_coordinates or not all(name in self.plan.columns for name in COORDINATES):
            return everything
        gone = [*self.missing]
        for triple in self.notation.missing_triples:
            raw = [self._raw_numbers(name) for name in COORDINATES]
            gone.append(np.logical_and.reduce([values == value for values, value in zip(raw, triple, strict=True)]))
        is_whole = ~np.logical_or.reduce(self.broken) if self.broken else everything
        if not gone:
            return is_whole
        there = ~np.logical_or.reduce(gone)
        sentence = ", ".join(repr(text) for text in self.plan.entry.missing)
        self._leave_out(is_whole & ~there, f"a coordinate means missing ({sentence})")
        return is_whole & there

    def _raw_numbers(self, name: str) -> Array:
        raw = self._raw(name)
        if not (pa.types.is_floating(raw.type) or pa.types.is_integer(raw.type)):
            raw, _ = self.notation.parse(raw.cast(pa.string()))
        return np.asarray(raw.cast(pa.float64()).fill_null(np.nan))

    def _leave_out(self, mask: Mask, reason: str) -> None:
        if count := int(np.count_nonzero(mask)):
            self.left_out[reason] += count

    def _fault(self, wrong: Mask, values: pa.Array | None, name: str, expected: str, value: str | None = None) -> None:
        wrong = wrong & ~self.reported.get(name, np.zeros(len(wrong), dtype=bool))  # one fault per cell: the first
        if not wrong.any():
            return
        self.reported[name] = self.reported.get(name, wrong) | wrong
        faults_of_cells = CellFaults.where(wrong, self.batch.records, values, self.plan.raw_name(name), expected)
        if value is not None:
            faults_of_cells = faults_of_cells.changed(lambda row, _: (row, value))
        self.faults.append(faults_of_cells)
