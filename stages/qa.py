"""Stage qa: quality checks of the measurements, before any conclusion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from itertools import chain
from typing import TYPE_CHECKING

from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.mechanism import COLUMNS_OF_AXES, NOISE_OF_COMMANDS, NOISE_OF_ENCODERS
from truing.stages.declaration import Outcome, Progress, Stage, registered

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.artifact import StoredTable
    from truing.schemas.campaign import Campaign
    from truing.stages.quality.check import Check, CheckResults
    from truing.stages.quality.pose_sample import PoseSample

DECLARATION = Stage(
    name="qa",
    reads=(
        *("joints?", "measured_poses?", "distances?"),
        *("observations?", "survey?", "configurations?", "readings?", "signals?", "loads_joined?"),
        *("given_compliance?", "quadrature?"),
        *("positions?", "reading_corrections?", "relabelled?", "resurveys?", "photographs?", "object_points?"),
        *("image_orientations?", "image_residuals?", "scale_bar_lengths?", "known_point_errors?", "image_cameras?"),
        *("bundle_statistics?", "ray_statistics?", "ray_information?"),
    ),
    leaves=("qa", "likely_names?", "belonging?"),
    settings=(
        *("campaign.kind", "campaign.drives", "measurement.frame", "mechanism.type", "mechanism.legs"),
        *(
            "mechanism.height_mm",
            "mechanism.tolerance",
            "mechanism.elements",
            "mechanism.dh",
            "mechanism.platform",
            "mechanism.base",
            *COLUMNS_OF_AXES,
            *NOISE_OF_COMMANDS,
            *NOISE_OF_ENCODERS,
        ),
        *("loading", "interferometer", "signals.range_mv", "signals.zero_mv", "signals.sensitivity_mv_per_n"),
        "signals.average_samples",
        *("bodies", "noise.actuator_mm", "noise.signal_mv", "noise.load_n", "noise.load_nm", "qa", "accept"),
        *("exclude", "keep", "mechanism.reference_temperature_c", "mechanism.payload_kg"),
        "mechanism.payload_com_mm",
        "poses.euler",
    ),
    summary="completeness, noise, geometry, outliers, labels, moved targets, drift; of loads: units, signs, exchanges",
    streams=("observations",),
)

# What checks the data of a mechanism that is neither of legs nor a sensor on its bench, by its type.
_OF_TYPES = {"axis": "truing.stages.quality.axis_checks", "chain": "truing.stages.quality.chain_checks"}


def run(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    """Every check with its value, limit, verdict and sentence; accepted verdicts keep their row and stop to gate."""
    from truing.report.numbers import count_text
    from truing.stages.common.belonging import belonging_table
    from truing.stages.quality.check import FAIL, WARN, checks_installed
    from truing.stages.quality.manual_exclusions import with_acceptances

    tables, sample = _examined(tables, settings)
    checked = _checked(tables, settings, sample)
    if checked.why_not:
        return Outcome.not_evaluated({"qa": _table([])}, checked.why_not)
    rows = with_acceptances(chain(checked.checks, checks_installed(tables, settings)), settings.accept, progress)
    failed = tuple(f"{row.check} {row.subject}".strip() for row in rows if row.verdict == FAIL and not row.accepted)
    warned, accepted = (
        sum(row.verdict == WARN and not row.accepted for row in rows),
        sum(bool(r.accepted) for r in rows),
    )
    who = {(row.check, row.subject): row.accepted for row in rows}
    belonging = belonging_table(
        checked.relations, [who.get((relation.relation, relation.subject)) for relation in checked.relations]
    )
    figure = f"{count_text(len(rows), 'check')}, {len(failed)} failed, {warned} warn, {accepted} accepted"
    artifacts = {"qa": _table(rows), "belonging": belonging, **checked.suggested}
    return Outcome(artifacts, checked.read, "nothing", figure, failed)


def _examined(
    tables: Mapping[str, pa.Table | StoredTable], settings: Campaign
) -> tuple[Mapping[str, pa.Table], PoseSample | None]:
    """Return the tables with the points to examine, and which these are, if there are points of bodies."""
    from truing.schemas.artifact import full_table

    points = tables.get("observations")
    if points is None or registered(_OF_TYPES, settings) is not None:
        return {name: full_table(table) for name, table in tables.items()}, None
    from truing.stages.quality.pose_sample import pose_sample

    other_tables = {name: full_table(table) for name, table in tables.items() if name != "observations"}
    sample = pose_sample(points, other_tables.get("configurations"))
    return {**other_tables, "observations": sample.points}, sample


def _checked(tables: Mapping[str, pa.Table], settings: Campaign, sample: PoseSample | None) -> CheckResults:
    if (checks_of_type := registered(_OF_TYPES, settings)) is not None:
        check_results: CheckResults = checks_of_type.checks(tables, settings)
        return check_results
    from truing.stages.quality import loading_checks, point_checks

    if settings.campaign.kind == "interferometer":
        return loading_checks.checks(tables, settings)
    return point_checks.checks(tables, settings, sample)


def _table(checks: list[Check]) -> pa.Table:
    import pyarrow as pa

    return pa.Table.from_pylist(list(map(asdict, checks)), schema=ARTIFACTS["qa"].arrow_schema(present=("accepted",)))
