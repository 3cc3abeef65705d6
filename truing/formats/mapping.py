"""Mapping of a raw file's columns to those of a table by [files.<table>], prepared once per file."""

from __future__ import annotations

import difflib
import re
import string
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

from truing.formats import sexagesimal
from truing.formats.numbers import is_plain_number
from truing.formats.origins import (
    Constant,
    Joined,
    Origin,
    PatternGroup,
    RawColumn,
    RowNumber,
    Spread,
    is_side_by_side,
    made_of,
    template_fields,
)
from truing.formats.patterns import bounded
from truing.formats.raw import Kind
from truing.formats.raw_tables import COORDINATES, LOADS_APART, MEASURED_APART, RawTable
from truing.formats.units import (
    UnknownUnit,
    conversion,
    expanded,
    is_like_a_unit,
    known_unit,
    unit_in_brackets,
    unread_unit,
)
from truing.schemas.column import Column
from truing.schemas.mapping import FileMapping, is_uncertainty

# Often given by the file's name, or by the order of its rows.
_OFTEN_IMPLICIT = {"pose", "body", "target", "run", "step", "channel"}


@dataclass(frozen=True)
class Misfit:
    """A mapping that does not fit its file: expectation and column."""

    expected: str
    column: str | None = None
    value: str | None = None


@dataclass(frozen=True)
class WideGroup:
    """One target or other column of a wide row: values of the template's names, and positions of its numbers."""

    labels: dict[str, str]
    positions: tuple[int, ...]


@dataclass(frozen=True)
class MappingPlan:
    """A mapping prepared for one file with columns ``names``: the origin of each column of the table."""

    entry: FileMapping
    shape: RawTable
    file_name: str
    names: tuple[str, ...]
    preset: frozenset[str] = frozenset()
    poses_as_text: bool = False
    is_discreet: bool = False  # the file's own names must not be shown
    misfits: list[Misfit] = field(default_factory=list)

    @cached_property
    def all_names(self) -> tuple[str, ...]:
        """Columns of the file, followed by those split from cells with several numbers."""
        return (*self.names, *(name for names in self.entry.arrays.values() for name in names))

    @cached_property
    def from_name(self) -> dict[str, str]:
        """Columns given by the file's name."""
        pattern = self.entry.from_name
        if pattern is None:
            return {}
        name = self.file_name if "/" in pattern else self.file_name.rsplit("/", 1)[-1]
        compiled = bounded(pattern, "from_name")
        match = compiled.search(name)
        if match is None:
            self.misfits.append(Misfit(f"a name that matches {pattern}", value=name))
            return dict.fromkeys(compiled.groupindex, "")
        return {group: text or "" for group, text in match.groupdict().items()}

    @cached_property
    def numbered(self) -> dict[str, RowNumber]:
        """Columns that count the rows of a file, or groups of them."""
        entry = self.entry
        per = dict(entry.rows_per_group)
        if entry.rows_per_pose is not None and "pose" not in entry.columns:
            per["pose"] = 1 if is_side_by_side(entry, self.shape.name) else entry.rows_per_pose
        smallest = min(per.values(), default=1)
        anew = smallest if smallest > 1 else None
        row_numbers = {name: RowNumber(first, 1, anew) for name, first in entry.number_rows.items() if name not in per}
        return row_numbers | {name: RowNumber(entry.number_rows.get(name, 1), count) for name, count in per.items()}

    @cached_property
    def groups(self) -> dict[str, PatternGroup]:
        """Columns extracted from another column by a regular expression."""
        patterns = {name: bounded(pattern, f"split.{name}") for name, pattern in self.entry.split.items()}
        return {name: PatternGroup(column, p, name) for column, p in patterns.items() for name in p.groupindex}

    @cached_property
    def wide(self) -> tuple[WideGroup, ...]:
        """Targets of a wide row, in the order of their columns."""
        if self.entry.wide is None:
            return ()
        pattern = bounded(names_of_template(self.entry.wide), "wide")
        if self.entry.wide_values is not None:
            meant = {self.entry.reference(column) for column in self.entry.columns}  # has a meaning of its own
            matches = (
                (match, index)
                for index, name in enumerate(self.all_names)
                if not meant & {name, index + 1} and (match := pattern.fullmatch(name))
            )
            return tuple(WideGroup(match.groupdict(), (index,)) for match, index in matches)
        indices_of_targets: dict[tuple[tuple[str, str], ...], dict[str, int]] = {}
        for position, name in enumerate(self.all_names):
            if match := pattern.fullmatch(name):
                labels = match.groupdict()
                axis = labels.pop("axis").lower()
                indices_of_targets.setdefault(tuple(sorted(labels.items())), {})[axis] = position
        return tuple(
            WideGroup(dict(labels), (axes["x"], axes["y"], axes["z"]))
            for labels, axes in indices_of_targets.items()
            if len(axes) == 3
        )

    @cached_property
    def spread(self) -> frozenset[str]:
        """Columns that come from conversion of wide rows to long ones."""
        return frozenset((*self.wide[0].labels, *self.wide_columns)) if self.wide else frozenset()

    @property
    def wide_columns(self) -> tuple[str, ...]:
        """Columns of the table that the numbers of wide rows become."""
        return COORDINATES if self.entry.wide_values is None else (self.entry.wide_values,)

    def origin(self, name: str, within: str = "") -> Origin | None:
        """Return the origin of a column; None without one. ``within`` its own split, the raw column."""
        entry = self.entry
        if name in entry.constants:
            return Constant(entry.constants[name])
        if name in self.from_name:
            return Constant(self.from_name[name])
        if name in self.groups and within != name:
            return self.groups[name]
        if name in self.numbered:
            return self.numbered[name]
        if name in entry.join:
            return Joined(entry.join[name], template_fields(entry.join[name]))
        if name in self.spread:
            return Spread(name)
        reference = entry.reference(name)
        if isinstance(reference, str) and reference != name and self._is_constructed(reference):
            return self.origin(reference)
        return self._raw(reference)

    def _is_constructed(self, name: str) -> bool:
        entry = self.entry
        made = (entry.constants, self.from_name, self.groups, self.numbered, entry.join, self.spread)
        return any(name in names for names in made)

    def _raw(self, reference: str | int) -> RawColumn | None:
        if isinstance(reference, int):
            return RawColumn(reference - 1) if 1 <= reference <= len(self.all_names) else None
        if reference in self.all_names:
            return RawColumn(self.all_names.index(reference))
        folded = [name.casefold().strip("# \t") for name in self.all_names]
        same = reference.casefold().strip("# \t")
        return RawColumn(folded.index(same)) if folded.count(same) == 1 else None

    @cached_property
    def columns(self) -> dict[str, Column]:
        """The table's columns that this file gives, with their definitions."""
        given_names = [name for name in self.shape.known(self._nameable) if self.origin(name) is not None]
        return {
            name: column
            for name in (*given_names, *self._covariate_names(given_names))
            if (column := self.shape.column(name))
        }

    @cached_property
    def _nameable(self) -> tuple[str, ...]:
        entry = self.entry
        made = (*entry.columns, *entry.constants, *self.from_name, *self.groups, *self.numbered, *entry.join)
        return tuple(dict.fromkeys((*made, *self.all_names)))

    @cached_property
    def _helpers(self) -> frozenset[str]:
        """Names of the mapping that only others refer to."""
        entry = self.entry
        joined = (field for template in entry.join.values() for field in template_fields(template))
        return frozenset((*entry.split, *entry.select, *entry.rename, *entry.arrays, *joined))

    @cached_property
    def unnamed_covariates(self) -> frozenset[str]:
        """Covariates that the mapping does not name: included if they are numbers."""
        entry = self.entry
        arrays = [name for names in entry.arrays.values() for name in names]
        asked = {*entry.columns, *entry.constants, *self.from_name, *self.groups, *self.numbered, *entry.join}
        carried = set(self.columns) - set(self.shape.known(self._nameable))
        return frozenset(carried - asked - set(arrays))

    def _covariate_names(self, given_names: list[str]) -> Iterator[str]:
        """Yield the covariates: columns of the mapping beyond the contract, and the file's other columns."""
        if not self.shape.covariates:
            return
        passed_over = bounded(self.entry.ignore or r"(?!)", "ignore")
        used = {origin.position for name in given_names if isinstance(origin := self.origin(name), RawColumn)}
        helpers = {group.column for group in self.groups.values()} | set(self.entry.arrays)
        for name in self._nameable:
            origin = self.origin(name)
            is_ignored = passed_over.fullmatch(name) and name not in self.entry.columns  # x_mm may be that of a slide x
            if name in given_names or name in helpers or not name or origin is None or is_ignored:
                continue
            if isinstance(origin, RawColumn):
                # A column without a name, known by its position alone, is no quantity that an effect may depend on.
                is_nameless = name == str(origin.position + 1) and name not in self.entry.columns
                if origin.position in used or is_nameless:
                    continue
                used.add(origin.position)
            yield name

    @cached_property
    def kinds(self) -> dict[int, Kind]:
        """Raw columns to read, with their kinds."""
        kinds: dict[int, Kind] = {}
        for position in (position for group in self.wide for position in group.positions):
            cell = self._array_position(position)
            kinds[cell] = "number" if cell == position else "text"
        for name, column in self.columns.items():
            self._require_columns(name, self._kind(name, column), kinds, ())
        for position in (index for name in self.columns for index, _ in self.added(name)):
            kinds.setdefault(position, "number")
        for name in (*self.entry.select, *self.entry.split):  # they select the rows to read
            self._require_columns(name, "text", kinds, ())
        return kinds

    def _kind(self, name: str, column: Column) -> Kind:
        if name in self.entry.split or name in self.unnamed_covariates:
            return "text"
        if column.kind == "identifier":
            return "text" if self.poses_as_text else "identifier"
        is_time = name == "time_s" and self.entry.time_format is not None
        if column.kind != "real" or is_time:
            return "text"
        return "seconds" if column.unit == "s" else "number"

    def added(self, name: str) -> Iterator[tuple[int, float]]:
        """Yield positions of the raw columns whose numbers are added to a column, with their signs."""
        for reference, sign in self.entry.value(name).others:
            if (origin := self._raw(reference)) is not None:
                yield origin.position, sign

    def _require_columns(self, name: str, kind: Kind, kinds: dict[int, Kind], within: tuple[str, ...]) -> None:
        if name in within:
            self.misfits.append(Misfit("a column that is not made of itself", column=name))
            return
        origin = self.origin(name)
        if isinstance(origin, PatternGroup) and origin.column == name:
            origin = self.origin(name, within=name)
        if isinstance(origin, RawColumn):
            position = self._array_position(origin.position)
            as_text = name in self.entry.rename or position != origin.position or kinds.get(position, kind) != kind
            kinds[position] = "text" if as_text else kind
        for column in made_of(origin):
            if self.origin(column) is None:
                self.misfits.append(self._missing_column(column))
            self._require_columns(column, "text", kinds, (*within, name))

    def _array_position(self, position: int) -> int:
        """Return the position to read for a column: that of the cell with several numbers, if it is in one."""
        if position < len(self.names):
            return position
        return next(
            (
                cell.position
                for column, first, names in self.arrays()
                if first <= position < first + len(names)
                if (cell := self._raw(column)) is not None
            ),
            position,
        )

    def arrays(self) -> Iterator[tuple[str, int, tuple[str, ...]]]:
        """Yield raw columns with several numbers in a cell: name, position, and names of the numbers."""
        first = len(self.names)
        for column, names in self.entry.arrays.items():
            yield column, first, names
            first += len(names)

    def check(self) -> list[Misfit]:
        """Return all mismatches between mapping and file."""
        wanted = [name for name in self.shape.required if name not in self.columns]
        misfits = [self._missing_column(name) for name in wanted]
        asked = (*self.entry.columns, *self.entry.select, *self.entry.rename, *self.entry.offset, *self.entry.arrays)
        for name in dict.fromkeys(asked):
            if name not in wanted and name not in self.preset and self.origin(name) is None:
                misfits.append(self._missing_column(name))
        misfits += [
            Misfit("a raw column of the file, to be added", column=name, value=str(reference))
            for name in self.columns
            for reference, _ in self.entry.value(name).others
            if self._raw(reference) is None
        ]
        misfits += [m for name in self._nameable if (m := self._unknown(name)) is not None]
        misfits += self._named_twice()
        misfits += [m for name in self.columns if (m := self._unit_misfit(name)) is not None]
        if not self.shape.partial:
            misfits += [self._missing_column(name) for name in self.entry.units if name not in self.columns]
            misfits += self._unit_of_nothing()
            misfits += _contradicted_columns(self)
        if self.entry.channels:
            misfits.append(Misfit("channels in [files.interferometer] alone", value=", ".join(self.entry.channels)))
        misfits += self._misfit_of_join()
        if self.entry.wide is not None and not self.wide:
            misfits.append(
                Misfit(
                    f"columns named like {self.entry.wide}",
                    value=None if self.is_discreet else ", ".join(self.names)[:80],
                )
            )
        _ = self.kinds
        return [*misfits, *self.misfits]

    def _misfit_of_join(self) -> Iterator[Misfit]:
        """Yield a way to join rows that this table does not have."""
        keys = {LOADS_APART.name: "step", MEASURED_APART.name: "pose"}
        way, key = self.entry.joined_by, keys.get(self.shape.name)
        if way is not None and key is None:
            yield Misfit("joined_by in [files.loads] and [files.measured] alone", value=way)
        elif way in keys.values() and way != key:
            yield Misfit(f'joined_by = "rows", "{key}" or "time"', value=way)

    def _named_twice(self) -> Iterator[Misfit]:
        """Yield table columns whose raw name occurs more than once in the header; only a position distinguishes
        them."""
        for name in self.columns:
            reference = self.entry.reference(name)
            if (
                name in self.unnamed_covariates
                or not isinstance(reference, str)
                or not isinstance(self.origin(name), RawColumn)
            ):
                continue
            if (count := self.names.count(reference)) > 1:
                yield Misfit(
                    f"one column {reference}, or its position in columns", column=name, value=f"{count} of them"
                )

    def _unit_of_nothing(self) -> list[Misfit]:
        if self.entry.unit is None or self.shape.has_coordinates:
            return []
        return [Misfit("units of single columns, units = { ... }; unit is that of points", value=self.entry.unit)]

    def _missing_column(self, name: str) -> Misfit:
        reference = self.entry.reference(name)
        if isinstance(reference, int):
            return Misfit(f"at least {reference} columns", column=name, value=str(len(self.names)))
        known = [name for name in self.all_names if name]
        is_defined = self._defines(reference)  # then y_mm is no mistyped x_mm
        free = [other for other in known if not (is_defined and self._defines(other))]
        close = difflib.get_close_matches(reference, free, n=1, cutoff=0.75 if reference in _OFTEN_IMPLICIT else 0.5)
        there = f"{len(known)}, not shown as the file lies outside the campaign's folder"
        hint = f"there are {there if self.is_discreet else ', '.join(known) or 'none'}"
        if close and not self.is_discreet:
            hint = f"did you mean {close[0]}?"
        is_matlab = self.entry.format == "mat" or self.file_name.casefold().endswith(".mat")
        if is_matlab and known and all(map(is_plain_number, known)):
            hint = f"but its {len(known)} columns have no names: give names, or columns by position"
        elif self.entry.header is not False and 2 * sum(map(is_plain_number, known)) > len(known):
            hint = (
                "but the first line holds numbers: set header = false and give columns by position, or name the format"
            )
        elif self.entry.comment is None and self.names[0].startswith("#"):
            hint = 'but the first line begins with #: set comment = "#" if it holds no names, or name the format'
        elif reference in _OFTEN_IMPLICIT and not close:
            hint += "; from_name, number_rows or constants may give what no column holds"
        text = f"a column {reference}" if reference == name else f"a column {reference} (it is to be {name})"
        return Misfit(f"{text}; {hint[:300]}", column=name)

    def _defines(self, name: str) -> bool:
        """Return True if the table has a column of this name with a meaning of its own, unlike a covariate."""
        return self.shape.column(name) is not None and not self.shape.is_covariate(name)

    def _unknown(self, name: str) -> Misfit | None:
        """Return a misfit for a column with a name similar to a missing column of the table."""
        entry = self.entry
        if self.shape.column(name) is not None or (name in self.names and entry.columns) or not name:
            return None
        known = (*self.shape.required, *self.shape.optional)
        is_useless = name in entry.columns and not self.shape.partial and name not in self._helpers
        absent = known if is_useless else [other for other in known if other not in self.columns]
        close = difflib.get_close_matches(name, absent, n=1, cutoff=0.8)
        return Misfit(f"a known column; did you mean {close[0]}?", column=name) if close else None

    def _unit_misfit(self, name: str) -> Misfit | None:
        try:
            self.scale(name)
        except UnknownUnit as error:
            return Misfit(str(error), column=name, value=self._unit_of(name))
        return None

    def _unit_of(self, name: str) -> str | None:
        column = self.columns[name]
        unit = self.entry.units.get(name, self.entry.value(name).unit)
        if unit is not None:
            return unit
        return self.entry.unit if column.unit == "mm" and self.shape.has_coordinates else None

    def is_given_unit(self, name: str) -> bool:
        """True if the mapping gives the unit of a column, or the scale of its numbers."""
        return self._unit_of(name) is not None or not self.entry.value(name).is_plain

    def is_sexagesimal(self, name: str) -> bool:
        """True if cells of a column hold degrees, minutes and seconds."""
        return self._unit_of(name) == sexagesimal.UNIT

    def scale(self, name: str) -> tuple[float, float]:
        """Return factor and offset from the raw numbers of a column to its unit; raises UnknownUnit."""
        unit = self._unit_of(name)
        return (1.0, 0.0) if unit is None else conversion(unit, self.columns[name].unit or unit)

    def raw_name(self, name: str) -> str:
        """Return the name of a column in messages about the file: its raw name, or its position."""
        origin = self.origin(name)
        if isinstance(origin, RawColumn):
            return self.all_names[origin.position] or str(origin.position + 1)
        return name


def names_of_template(template: str) -> str:
    """Return the regular expression for names of a template; the axis is one letter."""
    parts = []
    for text, name, _, _ in string.Formatter().parse(template):
        parts.append(re.escape(text))
        if name is not None:
            parts.append("(?P<axis>[xyzXYZ])" if name == "axis" else f"(?P<{name}>.+)")
    return "".join(parts)


def _contradicted_columns(plan: MappingPlan) -> Iterator[Misfit]:
    """Yield columns whose raw name gives another unit than the mapping, or another kind of uncertainty."""
    for name, column in plan.columns.items():
        raw = plan.raw_name(name)
        if name in plan.preset or name in plan.unnamed_covariates or raw == name:
            continue
        words = unread_unit(raw, column) if column.unit and not plan.is_given_unit(name) else None
        is_unit = words is not None and (is_like_a_unit(words) or raw.endswith("]"))
        if is_unit and not (name.endswith("_mv") and known_unit(words or "")):  # a sensor may show newtons
            cure = f'units = {{ {name} = "{column.unit}" }}, or what it is'
            yield Misfit(f"its unit, as {words} of {raw} is not known as a unit of this quantity: {cure}", column=name)
        unit = unit_in_brackets(raw)
        if unit is not None and column.unit and not plan.is_given_unit(name) and _units_differ(unit, column.unit):
            yield Misfit(f'its unit, as {raw} is not in {column.unit}: units = {{ {name} = "{unit}" }}', column=name)
        text = expanded(raw) if is_uncertainty(name) else None
        if text is not None and plan.entry.value(name).coverage is None:
            cure = f"coverage = {text.coverage:g} where it is U = k sigma, coverage = 1 where it is one sigma"
            yield Misfit(f"one standard deviation, or the coverage factor of {raw} ({text.why}): {cure}", column=name)


def _units_differ(unit: str, wanted: str) -> bool:
    """True if two units of one dimension differ."""
    try:
        return conversion(unit, wanted) != (1.0, 0.0)
    except UnknownUnit:
        return False
