"""Input of a loading campaign: readings, signals and the given compliance, checked against each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa

from truing.arrays import Array, TableRow
from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS
from truing.formats.faultlog import FaultLog
from truing.formats.file_search import words_on_unread_files
from truing.formats.raw_tables import POSITIONING, WRENCH
from truing.formats.row_collection import CollectedRows, collect_rows
from truing.formats.source import CampaignFiles, RawFile
from truing.report.numbers import count_text
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import Fault, Unfit
from truing.stages.common.table_arrays import SmallTable, check_unique_keys, numbered, numbers, texts
from truing.stages.declaration import Outcome
from truing.stages.ingestion.corrected_readings import Corrections, positions_at_reference
from truing.stages.ingestion.joined_loads import words_on_join
from truing.stages.ingestion.matrix_lines import Line, numbers_of, read_lines
from truing.stages.ingestion.published_values import read_published
from truing.stages.ingestion.reading_table import ReadingTable, read_readings
from truing.stages.ingestion.signal_table import read_signals
from truing.stages.ingestion.tables import (
    all_left_out,
    as_artifact,
    check_any_fitted,
    exclusions,
    left_out_words,
    read_start,
)

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import SensorMechanism

_TYPED = 1e-3  # of the roots of the diagonal: rounding of typed matrices
_RIGID = 1e-8  # lowest eigenvalue of a compliance whose diagonal is 1
_FURTHEST = 1.0  # m and rad: larger than any sensor's deflection
_SINGULAR = 1e9  # condition of the legs' influence, lengths in m
TABLES = ("interferometer", "displacement", "signals", "quadrature", "positioning")
_DIRECTIONS = ("forward", "backward")
_FEWEST_CYCLES = 2
_MANY = 0.5  # of the rows: more different values are not repeated targets


def read_compliance(source: CampaignFiles, log: FaultLog) -> pa.Table | None:
    """Return the matrix of mechanism.compliance_file as a long table; None without the file."""
    file = source.compliance
    lines = None if file is None else read_lines(file, "compliance_file", log)
    if file is None or lines is None:
        return None
    matrix = _matrix(file, lines, log, source.is_outside(file))
    return None if matrix is None else _long(matrix)


def _matrix(file: RawFile, rows: list[Line], log: FaultLog, is_outside: bool) -> Array | None:
    """The numbers (6, 6); None where a fault was noted. A line of the six loads' names may head them."""
    if rows and [cell.casefold()[:2] for cell in rows[0][1]] == list(LOADS):
        rows = rows[1:]
    if len(rows) != 6:
        log.add(Fault(file.name, "six rows: dx dy dz rx ry rz", value=f"{len(rows)} rows"))
        return None
    matrix = numbers_of(file, rows, LOADS, "six numbers: fx fy fz mx my mz", log, is_outside)
    clean = bool(np.isfinite(matrix).all()) and _is_symmetric(file, matrix, [number for number, _ in rows], log)
    return matrix if clean else None


def _is_symmetric(file: RawFile, matrix: Array, rows: list[int], log: FaultLog) -> bool:
    """Return True if the matrix is symmetric; otherwise report the largest asymmetry."""
    size = np.sqrt(np.abs(np.diag(matrix)))
    size = np.where(size > 0.0, size, 1.0)
    asymmetry = np.abs(matrix - matrix.T) / np.outer(size, size)
    i, j = np.unravel_index(int(np.argmax(asymmetry)), (6, 6))
    if asymmetry[i, j] <= _TYPED:
        return True
    text = f"{matrix[j, i]:g}, as in row {rows[j]}, column {LOADS[i]}: a compliance is symmetric"
    log.add(Fault(file.name, text, row=rows[i], column=LOADS[j], value=f"{matrix[i, j]:g}"))
    return False


def _long(matrix: Array) -> pa.Table:
    columns = {
        "response": [response for response in CHANNELS for _ in LOADS],
        "load": list(LOADS) * 6,
        "coefficient": matrix.ravel(),
        "unit": [_unit(response, load) for response in CHANNELS for load in LOADS],
    }
    return pa.table(columns, schema=ARTIFACTS["given_compliance"].arrow_schema())


def _unit(response: str, load: str) -> str:
    return f"{'m' if response.startswith('d') else 'rad'}/{'N' if load.startswith('f') else '(N m)'}"


@dataclass(frozen=True)
class LoadingTables:
    """Tables of a loading campaign; None for an absent table."""

    readings: ReadingTable | None
    signals: SmallTable | None
    compliance: pa.Table | None
    positions: PositionTable | None = None
    published: pa.Table | None = None
    joined: pa.Table | None = None

    @property
    def artifacts(self) -> dict[str, pa.Table]:
        """The tables by the name of their artifact."""
        tables = {} if self.readings is None else {"readings": self.readings.table}
        if self.readings is not None and self.readings.channels is not None:
            tables["quadrature"] = self.readings.channels
        if self.corrections:
            schema = ARTIFACTS["reading_corrections"].arrow_schema()
            tables["reading_corrections"] = pa.Table.from_pylist(self.corrections, schema=schema)
        tables |= {} if self.signals is None else {"signals": self.signals.table}
        tables |= {} if self.joined is None else {"loads_joined": self.joined}
        tables |= {} if self.positions is None else {"positions": self.positions.table}
        tables |= {} if self.published is None else {"published": self.published}
        return tables | ({} if self.compliance is None else {"given_compliance": self.compliance})

    @property
    def corrections(self) -> list[TableRow]:
        """Corrections of readings and positions."""
        corrected = [table for table in (self.readings, self.positions) if table is not None]
        return [row for table in corrected for row in table.corrections.rows]

    @property
    def left_out(self) -> Mapping[tuple[str, str], int]:
        """Number of raw rows left out, by (file, reason)."""
        return all_left_out(self.readings, self.signals, self.positions)

    @property
    def read(self) -> str:
        """Description of the tables that were read."""
        parts = []
        if self.readings is not None:
            parts.append(f"{count_text(len(self.readings.table), 'reading')} of {_channels(self.readings.table)}")
        if self.signals is not None:
            names = [name for name in self.signals.table.column_names if name.endswith("_mv")]
            parts.append(f"{count_text(len(names), 'signal')} of {count_text(len(self.signals.table), 'load step')}")
            parts += [] if self.joined is None else [words_on_join(self.joined)]
        if self.positions is not None:
            parts.append(f"{count_text(len(self.positions.table), 'approach')} of an axis to its targets")
        if self.published is not None:
            parts.append(count_text(len(self.published), "published value"))
        return " and ".join(parts)

    @property
    def figure(self) -> str:
        """Description of the runs, and of results that an absent table excludes."""
        every = (self.readings, self.signals, self.positions)
        tables = [table.table for table in every if table is not None]
        runs = {run for table in tables for run in table.column("run").to_pylist()}
        text = count_text(len(runs), "run")
        if done := [row for row in self.corrections if row["largest"] is not None]:
            words = (f"{row['subject']} for {row['correction']} by {row['largest']:.2g} {row['unit']}" for row in done)
            text += f"; corrected at most: {', '.join(words)}"
        if self.readings is None:
            text += "; no readings: the platform's displacement is not evaluated"
        return text + ("; no signals: the sensor's calibration is not evaluated" if self.signals is None else "")


def _channels(table: pa.Table) -> str:
    return " ".join(dict.fromkeys(sorted(table.column("channel").to_pylist(), key=_channel_order)))


def _channel_order(channel: str) -> tuple[bool, str]:
    return channel.startswith("r"), channel


def ingest(settings: Campaign, source: CampaignFiles, log: FaultLog) -> Outcome:
    """Return the tables of a loading campaign; raises CampaignFaults with all faults at once."""
    loading, start = read_loading_tables(source, settings, log), read_start(source, settings, log)
    log.raise_faults()
    start_tables = {} if start is None else {"start": start}
    artifacts = {**loading.artifacts, **start_tables, "exclusions": exclusions(loading.left_out)}
    return Outcome(artifacts, loading.read, left_out_words(loading.left_out), loading.figure)


def read_loading_tables(source: CampaignFiles, settings: Campaign, log: FaultLog) -> LoadingTables:
    """Return all tables of a loading campaign; faults go into the log."""
    if not any(source.entries(name) for name in TABLES):
        expected = (
            "this file, displacement.csv or signals.csv (or .parquet), or [files.interferometer] in campaign.toml"
        )
        log.add(Fault("interferometer.csv", expected + words_on_unread_files(source.folder, source.names_in_entries)))
    readings = read_readings(source, settings, log)
    signals, joined = read_signals(source, settings, None if readings is None else readings.table, log)
    loaded = [small_table.table for small_table in (readings, signals) if small_table is not None]
    check_any_fitted(loaded, "interferometer.csv" if readings is not None else "signals.csv", "run", log)
    positions = read_positions(source, settings, log)
    compliance = read_compliance(source, log)
    if settings.mechanism.type == "6-upur":
        check_sensor(cast("SensorMechanism", settings.mechanism), compliance, log, loaded)
    return LoadingTables(readings, signals, compliance, positions, read_published(source, log), joined)


def check_sensor(
    section: SensorMechanism, compliance: pa.Table | None, log: FaultLog, loaded: Sequence[pa.Table] = ()
) -> None:
    """Check that elements fit the legs, and that the compliance is plausible."""
    from truing.simulation.bench.six_upur.elements import passive
    from truing.simulation.bench.six_upur.influence import influence_matrix
    from truing.stages.common.sensor_elements import elastic_parts, given_matrix, sensor_joints

    key = "elements" if section.elements else "legs"
    try:
        if np.linalg.cond(influence_matrix(sensor_joints(section))) > _SINGULAR:
            raise Unfit("legs", "legs that do not constrain the platform", "six legs that constrain it")
        elastic_parts(section)
        if compliance is not None:
            _check_compliance(passive(given_matrix(compliance), "compliance_file"), loaded)
    except Unfit as error:
        key = error.what if error.what in ("compliance_file", "legs") else key
        log.add(Fault("campaign.toml", error.expected, column=f"mechanism.{key}", value=error.found))
    except (ValueError, np.linalg.LinAlgError) as error:
        log.add(Fault("campaign.toml", str(error), column=f"mechanism.{key}"))


def _check_compliance(compliance: Array, loaded: Sequence[pa.Table]) -> None:
    """Raise Unfit for a compliance that is not positive, or that moves the platform by metres under the applied
    loads."""
    diagonal = np.diag(compliance)
    if without_stiffness := [WRENCH[k] for k in np.flatnonzero(diagonal <= 0.0)]:
        raise Unfit(
            "compliance_file",
            f"zero or negative compliance under {', '.join(without_stiffness)}",
            "positive diagonal entries",
        )
    size = np.sqrt(diagonal)
    lowest = float(np.linalg.eigvalsh(compliance / np.outer(size, size))[0])
    if abs(lowest) < _RIGID:
        raise Unfit("compliance_file", "a singular matrix", "an invertible compliance")
    for k, name in enumerate(WRENCH):
        columns = [table.column(name).to_pylist() for table in loaded if name in table.column_names]
        largest = max((abs(load) for column in columns for load in column if load), default=0.0)
        if diagonal[k] * largest > _FURTHEST:
            moved = f"{diagonal[k] * largest:.3g} {'m' if k < 3 else 'rad'} under {name} = {largest:g}"
            units = "m/N, m/(N m), rad/N and rad/(N m); is it the stiffness, or in mm?"
            raise Unfit("compliance_file", f"{moved}", f"a compliance in {units}")


@dataclass
class PositionTable(SmallTable):
    """Approaches, and the corrections made."""

    corrections: Corrections = field(default_factory=Corrections)


def read_positions(source: CampaignFiles, settings: Campaign, log: FaultLog) -> PositionTable | None:
    """Return the approaches ordered by run, target, direction and cycle; None if the campaign has none."""
    rows = collect_rows(source, POSITIONING, log, "run")
    if rows is None:
        return None
    check_unique_keys(rows, log, "run", "target_mm", "direction", "cycle")
    rows = _with_positions(rows, log)
    if not log:
        _check_complete(rows, log)
    if log:
        return None
    read = numbers(rows, "position_mm")
    rows, corrections = positions_at_reference(rows, settings.interferometer, log)
    if log:
        return None
    direction = np.array([_DIRECTIONS.index(name) for name in texts(rows, "direction")])
    table = rows.table.append_column("row_order", pa.array(np.arange(1, len(direction) + 1)))
    if corrections.rows:
        table = table.append_column("position_read_mm", pa.array(read))
    order = np.lexsort((numbers(rows, "cycle"), direction, numbers(rows, "target_mm"), numbered(rows, "run")))
    return PositionTable(as_artifact("positions", table.take(order)), dict(rows.left_out), corrections)


def _with_positions(collected: CollectedRows, log: FaultLog) -> CollectedRows:
    """Return approaches with positions, mm, computed from targets and deviations where a file gives these."""
    columns_given = [name for name in ("position_mm", "deviation_um") if name in collected.table.column_names]
    if len(columns_given) != 1:
        expected = "a column position_mm, or deviation_um (position minus target)" + (
            "; not both" if columns_given else ""
        )
        log.add(Fault(collected.first_file, expected, column="position_mm"))
        return collected
    if not log:
        collected.fault(
            log, np.isnan(numbers(collected, columns_given[0])), columns_given[0], "a number for every approach"
        )
    if columns_given == ["position_mm"]:
        return collected
    position = numbers(collected, "target_mm") + 1e-3 * numbers(collected, "deviation_um")
    table = collected.table.drop_columns(["deviation_um"]).append_column("position_mm", pa.array(position))
    return replace(collected, table=table)


def _check_complete(collected: CollectedRows, log: FaultLog) -> None:
    """Report runs in which not every target was approached from both sides in the same cycles, at least twice."""
    runs = texts(collected, "run")
    for run in dict.fromkeys(runs):
        rows_of_run = runs == run
        columns = (
            numbers(collected, "target_mm")[rows_of_run],
            texts(collected, "direction")[rows_of_run],
            numbers(collected, "cycle")[rows_of_run],
        )
        targets, directions, cycles = (set(column.tolist()) for column in columns)
        missing = len(targets) * len(cycles) * len(_DIRECTIONS) - int(rows_of_run.sum())
        if missing or directions != set(_DIRECTIONS) or len(cycles) < _FEWEST_CYCLES:
            text = (
                f"run {run}: {count_text(len(targets), 'target')}, {count_text(len(cycles), 'cycle')}, "
                f"{', '.join(sorted(directions))}"
            )
            text += f", {count_text(missing, 'approach')} missing" if missing else ""
            expected = f"every target approached from both sides in every cycle, {_FEWEST_CYCLES} cycles at least"
            if (
                len(targets)
                > _MANY * int(rows_of_run.sum())
                > _MANY * len(set(numbers(collected, "position_mm")[rows_of_run].tolist()))
            ):
                expected += "; are the columns target_mm and position_mm exchanged?"
            log.add(Fault(collected.first_file, expected, column="cycle", value=text))
