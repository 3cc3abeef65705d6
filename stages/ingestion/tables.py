"""Input of the small tables of a campaign of points, and of the model of an earlier campaign."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from truing.arrays import Array, Mask
from truing.formats.faultlog import FaultLog
from truing.formats.point_index import NameNumbers
from truing.formats.raw_tables import CONFIGURATIONS, COORDINATE_SIGMAS, COORDINATES, TARGETS, WRENCH, RawTable
from truing.formats.read import read_table
from truing.formats.row_collection import CollectedRows, collect_rows
from truing.formats.source import CampaignFiles
from truing.report.numbers import count_text
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.column import LEAST_SIGMA_MM, MOST_SIGMA_MM
from truing.schemas.columns import find_column
from truing.schemas.faults import Fault
from truing.schemas.near_names import did_you_mean
from truing.schemas.settings_text import Document, parsed_toml, read_settings_text
from truing.stages.common.table_arrays import SmallTable, check_unique_keys, numbers, with_filled_column, without_rows

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import Leg, LeggedMechanism

POSES = tuple(RawTable(table, ("pose",), partial=True) for table in ("points", "poses", "scans"))
"""Points, measured poses and scans of which only the pose is looked at."""
_COLUMN = "mechanism.model"
_WRITTEN = "a model.toml that a run has written"
# What the earlier run wrote of itself; the copy has a provenance of its own.
_PROVENANCE = re.compile(r"^\[provenance\].*?(?=^\[|\Z)", re.MULTILINE | re.DOTALL)
_ELASTIC = "six legs with flexure_length_mm, flexure and leg_tube: only the stiffness model includes a load"
# On a chain a target without a place is an unknown.
_TARGETS_OF_CHAINS = replace(
    TARGETS, required=("body", "target"), optional=(*TARGETS.optional, *COORDINATES), may_be_empty=COORDINATES
)
FITTED, REFERENCE = "calibration", "reference"


def legs_of(settings: Campaign) -> tuple[Leg, ...]:
    """Return the legs of a mechanism with an actuator reading per pose; none for other mechanisms."""
    return cast("LeggedMechanism", settings.mechanism).legs if settings.mechanism.is_legged else ()


def read_configurations(
    source: CampaignFiles, settings: Campaign, log: FaultLog, adjusted: pa.Table | None = None
) -> SmallTable:
    """Return one row per pose; without a table, poses in order of appearance, which a mechanism does not allow.

    ``adjusted``: points from photographs, instead of those in files.
    """
    rows = collect_rows(source, CONFIGURATIONS, log, "pose")
    if rows is None:
        if legs_of(settings) and not source.entries("configurations"):
            log.add(Fault("configurations.csv", "this file, or [files.configurations] in campaign.toml"))
        for drive in () if source.entries("configurations") else settings.campaign.drives:
            expected = "a column of configurations; there is no configurations.csv, and no [files.configurations]"
            log.add(Fault("campaign.toml", expected, column="campaign.drives", value=drive))
        return SmallTable(_in_order_of_appearance(source, adjusted))
    check_unique_keys(rows, log, "pose")
    check_times(rows, log, names_matter=bool(legs_of(settings)))
    _check_repeats(rows, log)
    _check_readings(rows, log, settings)
    _check_drives(rows, log, settings.campaign.drives)
    _check_loads(rows, log, settings)
    table = as_artifact("configurations", with_role_and_time(rows.table))
    return SmallTable(table, dict(rows.left_out), file=rows.first_file)


def _check_loads(collected: CollectedRows, log: FaultLog, settings: Campaign) -> None:
    """Faults: rows without a load in the columns of external loads, and loads declared for legs without a stiffness
    model.
    """
    if settings.mechanism.is_legged and cast("LeggedMechanism", settings.mechanism).is_elastic:
        for name in WRENCH:
            if name in collected.table.column_names:
                expected = "a load in every row; 0 where there is none"
                collected.fault(log, ~np.isfinite(numbers(collected, name)), name, expected)
    elif any((*settings.load.force_n, *settings.load.torque_nm)):
        log.add(Fault("campaign.toml", _ELASTIC, column="load"))


def with_role_and_time(table: pa.Table) -> pa.Table:
    """The role calibration and the order of the rows as times, where a campaign gives neither."""
    if "role" not in table.column_names:
        table = table.append_column("role", pa.array(["calibration"] * len(table), pa.string()))
    if "time_s" not in table.column_names:
        table = table.append_column("time_s", pa.array(np.arange(len(table), dtype=float)))
    return table


def _in_order_of_appearance(source: CampaignFiles, adjusted: pa.Table | None) -> pa.Table:
    if adjusted is not None:
        return as_artifact("configurations", with_role_and_time(pa.table({"pose": adjusted.column("pose").unique()})))
    poses, as_text = _poses_of_points(source, as_text=False)
    if as_text:
        poses, _ = _poses_of_points(source, as_text=True)
    kind = pa.string() if as_text else pa.int64()
    return as_artifact("configurations", with_role_and_time(pa.table({"pose": pa.array(poses, kind)})))


def _poses_of_points(source: CampaignFiles, *, as_text: bool) -> tuple[list[object], bool]:
    """Return poses in order of appearance, and whether any is text; faults are reported when the points are read."""
    poses: NameNumbers[object] = NameNumbers()
    any_text = False
    for shape in POSES:
        for _, batch in read_table(source, shape, FaultLog(), poses_as_text=as_text):
            column = batch.columns["pose"]
            any_text |= bool(pa.types.is_dictionary(column.type))
            for pose in column.unique().to_pylist():
                poses.number(pose)
    return poses.values, any_text


def check_times(collected: CollectedRows, log: FaultLog, *, names_matter: bool) -> None:
    """Report rows with the time of an earlier row, or, if names matter, a name that is nearly time_s.

    Without times, poses count as taken in the order of their rows.
    """
    if "time_s" in collected.table.column_names:
        collected.fault(log, _repeated(numbers(collected, "time_s")), "time_s", "a time of its own for every row")
    elif names_matter and (meant := _mistyped_column("time_s", collected)):
        log.add(Fault(collected.first_file, f"a column time_s; it orders the poses{meant}", column="time_s"))


def _check_repeats(collected: CollectedRows, log: FaultLog) -> None:
    """Check that a repeated pose refers to another pose of the table."""
    names = collected.table.column_names
    if "repeat_of" not in names or "pose" not in names:
        return
    poses = [str(pose) for pose in collected.table.column("pose").to_pylist()]
    repeated_poses = collected.table.column("repeat_of").to_pylist()
    known = set(poses)
    unknown = np.array([bool(repeated) and repeated not in known for repeated in repeated_poses], dtype=bool)
    collected.fault(log, unknown, "repeat_of", "a pose of this table, or nothing")
    is_repeat = np.array([repeated == pose for pose, repeated in zip(poses, repeated_poses, strict=True)], dtype=bool)
    collected.fault(log, is_repeat, "repeat_of", "another pose than this one, or nothing")


def _repeated(values: Array) -> Mask:
    _, first = np.unique(values, return_index=True)
    again = ~np.isnan(values)
    again[first] = False
    return again


def _check_readings(collected: CollectedRows, log: FaultLog, settings: Campaign) -> None:
    legs = legs_of(settings)
    if not legs:
        return
    file = collected.first_file
    for leg in range(1, len(legs) + 1):
        name = f"rho{leg}_mm"
        if name not in collected.table.column_names:
            text = f"a column {name}, the reading of leg {leg}{_mistyped_column(name, collected)}"
            log.add(Fault(file, text, column=name))


def _mistyped_column(name: str, collected: CollectedRows) -> str:
    """Suggestion of a column that is none of the format, for one that is missing."""
    return did_you_mean(
        name, (column_name for column_name in collected.table.column_names if find_column(column_name) is None)
    )


def _check_drives(collected: CollectedRows, log: FaultLog, drives: tuple[str, ...]) -> None:
    names = collected.table.column_names
    for drive in drives:
        if drive not in names:
            hint = did_you_mean(drive, names) or f"; there are {', '.join(names)}"
            log.add(Fault("campaign.toml", f"a column of configurations{hint}", column="campaign.drives", value=drive))


def read_survey(source: CampaignFiles, settings: Campaign, log: FaultLog) -> SmallTable | None:
    """The reference survey; None where the campaign has none."""
    is_chain = settings.mechanism.type == "chain"
    rows = collect_rows(source, _TARGETS_OF_CHAINS if is_chain else TARGETS, log)
    if rows is None or not set(COORDINATES) <= set(rows.table.column_names):
        return None
    if is_chain:
        gaps = np.asarray(np.isnan(np.column_stack([numbers(rows, name) for name in COORDINATES])).any(1))
        if gaps.all():
            return None
        rows = without_rows(rows, gaps, "no place is given: it is unknown")
    check_unique_keys(rows, log, "body", "target")
    check_legs(rows, log, len(legs_of(settings)))
    surveyed = set(rows.table.column("body").to_pylist()) if "body" in rows.table.column_names else set()
    # A body whose surface or pose is measured needs no targets; whether others are there is seen with the points.
    scanned = source.entries("scans") or source.entries("poses")
    needed = ("platform",) if settings.is_frame_fixed else ("base", "platform")
    for body in needed if legs_of(settings) and not scanned else ():
        if body not in surveyed:
            log.add(Fault(rows.first_file, f"targets of body {body}", column="body"))
    table = rows.table
    for name in COORDINATE_SIGMAS:
        if name in table.column_names:
            sigma = numbers(rows, name)
            tiny = (sigma > 0.0) & (sigma < LEAST_SIGMA_MM)
            rows.fault(log, tiny | (sigma > MOST_SIGMA_MM), name, f"0, or {LEAST_SIGMA_MM:g} to {MOST_SIGMA_MM:g} mm")
        table = with_filled_column(table, name, settings.noise.point_mm, pa.float64())
    if "leg" not in table.column_names:
        table = table.append_column("leg", pa.nulls(len(table), pa.int64()))
    return SmallTable(as_artifact("survey", table), dict(rows.left_out), file=rows.first_file)


def check_survey_noise(survey: SmallTable, log: FaultLog) -> None:
    """Report surveyed targets without a standard deviation; not if their cell was already faulty."""
    empty = [survey.table.column(f"sigma_{axis}_mm").null_count for axis in "xyz"]
    if any(count and (not log or count == len(survey.table)) for count in empty):
        log.add_missing("noise.point_mm", "a standard deviation of surveyed targets", survey.file)


def check_legs(collected: CollectedRows, log: FaultLog, legs: int) -> None:
    """Report leg numbers that do not exist, or that a body without attachments has."""
    if "leg" not in collected.table.column_names or not legs:
        return
    leg = numbers(collected, "leg")
    collected.fault(log, leg > legs, "leg", f"a leg from 1 to {legs}, or nothing")
    elsewhere = np.array([body != "platform" for body in collected.table.column("body").to_pylist()], dtype=bool)
    collected.fault(log, elsewhere & ~np.isnan(leg), "leg", "nothing: only targets of the platform sit at attachments")


def since_first(table: pa.Table) -> pa.Table:
    """Return times, written as dates, relative to the earliest."""
    times = table.column("time_s")
    return table.set_column(table.column_names.index("time_s"), "time_s", pc.subtract(times, pc.min(times)))


def as_artifact(name: str, table: pa.Table) -> pa.Table:
    """Return a table with the artifact's columns first, in its types; its faults are reported elsewhere."""
    artifact = ARTIFACTS[name]
    absent = [column for column in artifact.columns if column not in table.column_names]
    for column in absent:
        table = table.append_column(column, pa.nulls(len(table), artifact.arrow_schema().field(column).type))
    names = [*artifact.columns, *(column for column in table.column_names if column not in artifact.columns)]
    text = any(key in names and pa.types.is_string(table.schema.field(key).type) for key in ("pose", "run"))
    schema = artifact.arrow_schema("string" if text else "int64", tuple(names))
    return table.select(names).cast(pa.schema([field.with_nullable(True) for field in schema]))


def read_start(source: CampaignFiles, settings: Campaign, log: FaultLog) -> str | None:
    """The earlier model as text; None where the campaign starts from none, or from a faulty one."""
    if getattr(settings.mechanism, "model", None) is None or source.prior_model is None:
        return None
    try:
        text = read_settings_text(source.prior_model.path)
        wrong = _departure(parsed_toml(text), settings.mechanism)
    except OSError:
        wrong = "a file that can be read: the model.toml of an earlier campaign"
    except (ValueError, RecursionError) as error:  # no text, no TOML, or numbers without end in it
        wrong = _WRITTEN if source.is_outside(source.prior_model) else f"{_WRITTEN} ({error})"
    if wrong:
        log.add(Fault("campaign.toml", wrong, column=_COLUMN, value=source.prior_model.name))
        return None
    return _PROVENANCE.sub("", text).rstrip("\n") + "\n"


def _departure(document: Document, mechanism: Any) -> str:
    """Return the expectation that a parsed model violates; empty if it is a model of this mechanism."""
    about, legs = document.get("model"), document.get("legs")
    if not isinstance(about, dict) or "covariance" not in document:
        return _WRITTEN
    of_sensor = about.get("mechanism") == "6-upur"
    if not (isinstance(document.get("compliance"), dict) if of_sensor else isinstance(legs, list)):
        return _WRITTEN
    if about.get("mechanism") != mechanism.type:
        return f"a model of a {mechanism.type}, not of a {about.get('mechanism')}"
    if isinstance(legs, list) and len(legs) != len(mechanism.legs):
        return f"a model of {len(mechanism.legs)} legs, not of {len(legs)}"
    return ""


def check_any_fitted(tables: Sequence[pa.Table], file: str, what: str, log: FaultLog) -> None:
    """Report a table whose rows are all references; ``what``: pose or run.

    Role verification alone tests an earlier model, and a short campaign may fit to its reference poses.
    """
    roles: Counter[str] = Counter()
    for table in tables:
        if "role" in table.column_names:
            roles.update(filter(None, table.column("role").to_pylist()))
        elif len(table):
            return
    if set(roles) == {REFERENCE}:
        expected = f"at least one {what} of role {FITTED}: without one there is nothing to fit to"
        log.add(Fault(file, expected, column="role", value=f"{', '.join(roles)} alone"))


class _WithOmissions(Protocol):
    """Table read with some rows left out, by (file or subject, reason)."""

    @property
    def left_out(self) -> Mapping[tuple[str, str], int]: ...


def all_left_out(*parts: _WithOmissions | None) -> Counter[tuple[str, str]]:
    """Return the number of rows left out of all parts, by (subject, reason)."""
    total: Counter[tuple[str, str]] = Counter()
    for part in parts:
        total.update({} if part is None else part.left_out)
    return total


def exclusions(left_out: Mapping[tuple[str, str], int], by_geometry: Container[tuple[str, str]] = ()) -> pa.Table:
    """Return the artifact exclusions: rows left out by (subject, reason), and those that the survey's geometry
    excluded."""
    by = ("[files] of campaign.toml", "the geometry of the survey")
    rows = [
        {"stage": "ingest", "subject": key[0], "reason": key[1], "rows": number, "by": by[key in by_geometry]}
        for key, number in left_out.items()
    ]
    return pa.Table.from_pylist(rows, schema=ARTIFACTS["exclusions"].arrow_schema())


def left_out_words(left_out: Mapping[tuple[str, str], int]) -> str:
    """Return in words the number of rows left out by reason, most frequent first."""
    by_reason: Counter[str] = Counter()
    for (_, reason), number in left_out.items():
        by_reason[reason] += number
    return (
        "; ".join(f"{count_text(number, 'row')}: {reason}" for reason, number in by_reason.most_common()) or "nothing"
    )
