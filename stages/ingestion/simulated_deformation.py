"""The deformation that the user's own simulation predicts: K, its entries one by one, or a table of shifts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa

from truing.arrays import Array
from truing.estimation.matrix_comparison import slopes_of_shifts
from truing.formats.faultlog import FaultLog
from truing.formats.source import CampaignFiles, RawFile
from truing.report.numbers import count_text
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import Fault
from truing.stages.ingestion.matrix_lines import Line, number_of, numbers_of, read_lines

_ENTRIES = ("leg", "column", "coefficient")
_SIGMA, _SIGMA_UM = "sigma", "sigma_um"
_LARGEST = 1.0  # m per m: an attachment that shifts farther than its actuator moves
_UM_PER_MM = 1e-3


def read_simulated_deformation(source: CampaignFiles, legs: int, log: FaultLog) -> pa.Table | None:
    """The simulated K of mechanism.deformation_file as a long table; None where there is none."""
    file = source.deformation
    lines = None if file is None else read_lines(file, "deformation_file", log)
    if file is None or lines is None:
        return None
    deformation = _FileOfDeformation(file, legs, log, source.is_outside(file)).read(lines)
    return None if deformation is None else _long(*deformation)


class _FileOfDeformation:
    """One file, with where its faults go; the first line decides its form."""

    def __init__(self, file: RawFile, legs: int, log: FaultLog, is_outside: bool) -> None:
        self.file, self.legs, self.log, self.is_outside = file, legs, log, is_outside
        self.drives = tuple(f"delta_rho{i + 1}_mm" for i in range(legs))
        self.shifts = tuple(f"delta_bz{i + 1}_um" for i in range(legs))

    def read(self, lines: list[Line]) -> tuple[Array, Array] | None:
        """Entries (L, L) and their standard deviations (L, L); None where a fault was noted."""
        names = [name.casefold() for name in lines[0][1]] if lines else []
        if set(names) & set(_ENTRIES):
            entries = self._entries(names, lines[1:])
        elif set(names) & {*self.drives, *self.shifts}:
            entries = self._matrix_of_shifts(names, lines[1:])
        else:
            headed = bool(names) and all(np.isnan(number_of(name)) for name in names)
            entries = self._matrix(lines[1:] if headed else lines)
        return None if entries is None or not self._is_plausible(*entries) else entries

    def _matrix(self, rows: list[Line]) -> tuple[Array, Array] | None:
        if len(rows) != self.legs:
            expected = (
                f"{self.legs} rows of K, one per attachment, or a header line: {', '.join(_ENTRIES)}, {_SIGMA}; or "
                f"{self.drives[0]} .. {self.drives[-1]}, {self.shifts[0]} .. {self.shifts[-1]}"
            )
            self._fault(expected, value=count_text(len(rows), "row"))
            return None
        columns = [f"rho{i + 1}" for i in range(self.legs)]
        numbers = self._numbers(rows, columns)
        return None if numbers is None else (numbers, np.zeros_like(numbers))

    def _entries(self, names: list[str], rows: list[Line]) -> tuple[Array, Array] | None:
        table = self._table(names, rows, (*_ENTRIES, *((_SIGMA,) if _SIGMA in names else ())))
        if table is None:
            return None
        entries, sigma = np.full((self.legs, self.legs), np.nan), np.zeros((self.legs, self.legs))
        for (row, _), values in zip(rows, table, strict=True):
            index = tuple(int(value) - 1 for value in values[:2])
            for name, value in zip(_ENTRIES, values[:2], strict=False):
                if value not in range(1, self.legs + 1):
                    self._fault(f"a whole number from 1 to {self.legs}", row, name, f"{value:g}")
                    return None
            if np.isfinite(entries[index]):
                self._fault("each entry once", row, value=f"leg {index[0] + 1}, column {index[1] + 1} again")
                return None
            entries[index] = values[2]
            sigma[index] = values[3] if len(values) > 3 else 0.0
        if missing := np.argwhere(np.isnan(entries)).tolist():
            where = f"leg {missing[0][0] + 1}, column {missing[0][1] + 1}"
            self._fault(f"all {self.legs**2} entries", value=f"{len(missing)} missing, such as {where}")
            return None
        return entries, sigma

    def _matrix_of_shifts(self, names: list[str], rows: list[Line]) -> tuple[Array, Array] | None:
        optional = (_SIGMA_UM,) if _SIGMA_UM in names else ()
        table = self._table(names, rows, (*self.drives, *self.shifts, *optional))
        if table is None:
            return None
        moved, shifted = table[:, : self.legs], table[:, self.legs : 2 * self.legs]
        rank = int(np.linalg.matrix_rank(moved)) if len(moved) else 0
        if rank < self.legs:
            expected = f"displacements that move every actuator independently, in {self.legs} rows or more"
            self._fault(expected, value=f"{count_text(len(rows), 'row')} that determine {rank} of {self.legs}")
            return None
        noise = table[:, -1] * _UM_PER_MM if optional else None
        if noise is not None and (noise <= 0.0).any():
            row = int(np.argmax(noise <= 0.0))
            self._fault("a positive standard deviation", rows[row][0], _SIGMA_UM, f"{table[row, -1]:g}")
            return None
        return slopes_of_shifts(moved, shifted * _UM_PER_MM, noise)

    def _table(self, names: list[str], rows: list[Line], wanted: Sequence[str]) -> Array | None:
        """The wanted columns (N, C); None where a fault was noted."""
        if sorted(names) != sorted(wanted):
            lacking = [name for name in wanted if name not in names]
            foreign = [name for name in names if name not in wanted or names.count(name) > 1]
            faults = [f"no {', '.join(lacking)}"] if lacking else []
            if foreign:
                faults.append(
                    count_text(len(foreign), "column") if self.is_outside else ", ".join(dict.fromkeys(foreign))
                )
            self._fault(f"the columns {', '.join(wanted)}, each once", value="; ".join(faults)[:200])
            return None
        table = self._numbers(rows, names)
        return None if table is None else table[:, [names.index(name) for name in wanted]]

    def _numbers(self, rows: list[Line], columns: Sequence[str]) -> Array | None:
        expected = f"{len(columns)} numbers: {' '.join(columns)}"
        numbers = numbers_of(self.file, rows, columns, expected, self.log, self.is_outside)
        return numbers if np.isfinite(numbers).all() else None

    def _is_plausible(self, entries: Array, sigma: Array) -> bool:
        if (sigma < 0.0).any():
            self._fault("standard deviations of zero or more", column=_SIGMA, value=f"{sigma.min():g}")
        leg, column = np.unravel_index(int(np.argmax(np.abs(entries))), entries.shape)
        if abs(entries[leg, column]) > _LARGEST:
            expected = "entries below 1 (m per m), because attachments shift less than their actuators move"
            value = f"K{leg + 1}{column + 1} = {entries[leg, column]:g}; is it in um per mm? Divide it by 1000"
            self._fault(expected, value=value)
        return not (sigma < 0.0).any() and bool(np.abs(entries).max() <= _LARGEST)

    def _fault(
        self, expected: str, row: int | None = None, column: str | None = None, value: str | None = None
    ) -> None:
        self.log.add(Fault(self.file.name, expected, row=row, column=column, value=value))


def _long(entries: Array, sigma: Array) -> pa.Table:
    leg, column = (index.ravel() + 1 for index in np.indices(entries.shape))
    columns = {
        "leg": leg,
        "column": column,
        "coefficient": entries.ravel(),
        "sigma": sigma.ravel(),
        "unit": ["1"] * entries.size,
    }
    return pa.table(columns, schema=ARTIFACTS["given_deformation"].arrow_schema())
