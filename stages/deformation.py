"""Deformation: what moves within a body that was taken for rigid, and the drive that it follows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, cast

from truing.report.numbers import count as counted
from truing.schemas.artifacts import ARTIFACTS
from truing.stages.common.why_not import NO_BODIES
from truing.stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import LeggedMechanism

DECLARATION = Stage(
    name="deformation",
    reads=(
        "observations?",
        "survey?",
        "configurations?",
        "poses?",
        "residuals?",
        "readings?",
        "given_compliance?",
        "displacement?",
        "reading_residuals?",
        "run_terms?",
        "positions?",
        "qa?",
        *("object_points?", "point_correlations?", "point_sensitivities?", "camera_correlations?"),
    ),
    leaves=(
        "deformation?",
        "deformation_models?",
        "deformation_errors",
        *("shift_covariances?", "shift_sensitivities?", "survey_covariances?"),
        "target_deformation?",
        "compliance?",
        "axis_curves?",
        "positioning?",
    ),
    settings=(
        "campaign.kind",
        "campaign.drives",
        "mechanism.type",
        "mechanism.legs",
        "mechanism.height_mm",
        "mechanism.elements",
        "mechanism.tolerance",
        "interferometer",
        "noise.load_n",
        "noise.load_nm",
    ),
    summary="deformation residuals, linear and matrix deformation models",
)


def run(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    """Fit the deformation models that the campaign's instrument and mechanism allow."""
    from truing.stages.common.belonging import withheld

    progress(0, 1, "deformation models")
    why = withheld(tables)
    if settings.campaign.kind == "interferometer":  # positions of an axis have nothing to do with loads
        found = _of_nothing(why, settings) if why else _of_loads(tables, settings)
        return _with_positioning(found, tables, settings)
    if why:
        return _of_nothing(why, settings)
    if settings.mechanism.type in NO_BODIES:
        return not_evaluated(NO_BODIES[settings.mechanism.type])
    if settings.mechanism.is_legged:
        return _of_legs(tables, settings)
    return _of_targets(tables, settings)


def _with_positioning(found: Outcome, tables: Mapping[str, pa.Table], settings: Campaign) -> Outcome:
    """What was made of loads, and what positioning runs of an axis say of it, but for runs that failed a check."""
    if "positions" not in tables or not tables["positions"].num_rows:
        return found
    from truing.stages.common.belonging import withheld_runs
    from truing.stages.responses.axis_positioning import positioning_rows, told

    positions = tables["positions"]
    withheld = withheld_runs(tables)
    rows = positioning_rows(positions, settings.interferometer, withheld).table(str(positions.schema.field("run").type))
    read, said = f"{counted(positions.num_rows, 'approach')} of an axis", told(rows, withheld)
    return replace(
        found,
        artifacts={**found.artifacts, "positioning": rows},
        read=read if found.read == "nothing" else f"{found.read}; {read}",
        figure=said if found.read == "nothing" else f"{found.figure}; {said}",
    )


def _of_legs(tables: Mapping[str, pa.Table], settings: Campaign) -> Outcome:
    from truing.stages.common.why_not import NO_POINTS_TO_DEFORM, why_no_deformation_of_legs
    from truing.stages.responses.attachment_deformation import attachment_deformation

    if "configurations" in tables and "observations" in tables and not tables["observations"].num_rows:
        return not_evaluated(NO_POINTS_TO_DEFORM)
    if why := why_no_deformation_of_legs(tables):
        return not_evaluated(why)
    return attachment_deformation(tables, _rest_readings_mm(settings))


def _rest_readings_mm(settings: Campaign) -> tuple[float, ...]:
    """Actuator readings of the reference configuration, leg by leg."""
    legs = cast("LeggedMechanism", settings.mechanism).legs
    return tuple(leg.rho0_mm for leg in legs)


def _of_targets(tables: Mapping[str, pa.Table], settings: Campaign) -> Outcome:
    from truing.stages.common.why_not import why_no_deformation_of_targets
    from truing.stages.responses.target_deformation import target_deformation

    drives = settings.campaign.drives
    if why := why_no_deformation_of_targets(drives, tables):
        return not_evaluated(why)
    if "observations" not in tables or not tables["observations"].num_rows:
        return not_evaluated("no targets, whose movement within their body could be seen")
    return target_deformation(tables, drives)


def _of_loads(tables: Mapping[str, pa.Table], settings: Campaign) -> Outcome:
    from truing.stages.common.why_not import why_no_deformation_of_loads
    from truing.stages.responses.load_deformation import load_deformation

    if why := why_no_deformation_of_loads(tables.get("readings")):
        return _of_nothing(why, settings)
    return load_deformation(tables, settings)


def _of_nothing(why: str, settings: Campaign) -> Outcome:
    """The outcome of a campaign of either kind whose data cannot be used."""
    if settings.campaign.kind != "interferometer":
        return not_evaluated(why)
    from truing.stages.responses.load_deformation import without_loads

    return Outcome.not_evaluated(without_loads(), why)


def not_evaluated(why: str) -> Outcome:
    """The outcome of a campaign that does not hold what this stage needs."""
    empty = {name: ARTIFACTS[name].empty() for name in ("deformation", "deformation_models", "deformation_errors")}
    return Outcome.not_evaluated(empty, why)
