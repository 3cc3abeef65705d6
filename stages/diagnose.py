"""Diagnosis: what the simulation gets wrong, why, and the extended model that gets it right."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING

from truing.report.numbers import count as counted
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.axis_mechanism import COLUMNS_OF_AXES, NOISE_OF_COMMANDS, NOISE_OF_ENCODERS
from truing.stages.common.registered import registered
from truing.stages.common.words import gross_errors
from truing.stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.inference.selection import Diagnosis, Settings
    from truing.schemas.campaign import Campaign
    from truing.simulation.cause import Cause
    from truing.stages.diagnosis.mechanism_points import Gathered
    from truing.stages.diagnosis.ray_findings import RayFindings
    from truing.stages.diagnosis.shown import Channels

DECLARATION = Stage(
    name="diagnose",
    reads=(
        "observations?",
        "survey?",
        "configurations?",
        "poses?",
        "residuals?",
        "start?",
        "readings?",
        "signals?",
        "given_compliance?",
        "qa?",
        "ray_statistics?",
        "ray_information?",
        "ray_effects?",
        "point_correlations?",
        "object_points?",
        "scale_bars?",
    ),
    leaves=(
        "diagnosis",
        "model?",
        "detectable?",
        "pulls?",
        "pull_sums?",
        "prediction?",
        "reading_errors?",
        "axis_errors?",
        "next_poses?",
        "next_loads?",
        "changes?",
        "cause_uncertainty?",
        "diagnosis_left_out?",
    ),
    settings=(
        "campaign.name",
        "campaign.kind",
        "mechanism.type",
        "mechanism.legs",
        "mechanism.tolerance",
        "mechanism.reference_temperature_c",
        "mechanism.actuator_pitch_mm",
        "mechanism.height_mm",
        "mechanism.elements",
        *COLUMNS_OF_AXES,
        *NOISE_OF_COMMANDS,
        *NOISE_OF_ENCODERS,
        "loading",
        "interferometer",
        "signals",
        "campaign.drives",
        "bodies",
        "workspace",
        "noise.point_mm",
        "noise.actuator_mm",
        "noise.signal_mv",
        "noise.load_n",
        "noise.load_nm",
        "diagnosis",
        "exclude",
        "keep",
    ),
    summary="what the simulation gets wrong: causes, their sizes, the extended model",
)

# What assembles the data of a mechanism that is neither of legs nor a sensor on its bench, by its type.
_OF_TYPES = {"axis": "truing.stages.diagnosis.axis_points"}

# Simulated residual vectors, and as many sign-flipped ones, that the search is held against.
DRAWS = 400


def run(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    """Search the catalogue for what makes the campaign depart from its simulation."""
    import numpy as np

    from truing.stages.common.belonging import withheld
    from truing.stages.diagnosis.ray_findings import corrected, with_shared_errors

    if why := withheld(tables):
        return _not_evaluated(why)
    rays = _rays(tables, settings, progress)
    try:
        gathered = gathered_of(tables if rays is None else corrected(tables, rays), settings)
    except ValueError as why:
        return _not_evaluated(str(why)) if rays is None else _of_rays_alone(rays, str(why), settings)
    try:
        if rays is not None:
            gathered = with_shared_errors(gathered, tables, rays)
        return _diagnose(gathered, rays, settings, progress)
    except np.linalg.LinAlgError:
        return _not_evaluated("the fit left what the legs can reach: geometry, survey or readings are far from right")


def _rays(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> RayFindings | None:
    """What rays tell by themselves; None where points do not come from photographs of several poses."""
    from truing.stages.diagnosis.ray_findings import ray_findings
    from truing.stages.diagnosis.ray_points import has_rays

    return ray_findings(tables, settings, rule_of(settings), progress) if has_rays(tables) else None


def gathered_of(tables: Mapping[str, pa.Table], settings: Campaign) -> Gathered:
    """What is compared; raises ValueError, saying why, where the campaign does not hold it."""
    from truing.stages.common.why_not import NO_POINTS_TO_DIAGNOSE

    if "observations" in tables and not tables["observations"].num_rows:
        raise ValueError(NO_POINTS_TO_DIAGNOSE)
    if (own := registered(_OF_TYPES, settings)) is not None:
        gathered: Gathered = own.gather(tables, settings)
        return gathered
    if settings.mechanism.is_legged:
        return _of_mechanism(tables, settings)
    if settings.campaign.kind == "interferometer":
        from truing.stages.diagnosis.reading_points import gather_readings

        return _started(gather_readings(tables, settings), tables, settings)
    from truing.stages.diagnosis.body_points import gather_bodies

    return gather_bodies(tables, settings)


def _of_mechanism(tables: Mapping[str, pa.Table], settings: Campaign) -> Gathered:
    from truing.stages.common.why_not import why_no_diagnosis_of_mechanism
    from truing.stages.diagnosis.mechanism_points import gather

    if why := why_no_diagnosis_of_mechanism(settings.mechanism, settings.noise.point_mm, tables):
        raise ValueError(why)
    gathered = gather(tables, settings)
    if unreached := _unreached(gathered):
        raise ValueError(unreached)
    return _started(gathered, tables, settings)


def _started(gathered: Gathered, tables: Mapping[str, pa.Table], settings: Campaign) -> Gathered:
    """What is compared, with what the model tells that the campaign starts from."""
    if "start" not in tables:
        return gathered
    from truing.stages.diagnosis.earlier_campaign import started

    return started(gathered, str(tables["start"]), settings.diagnosis.seed)


def _unreached(gathered: Gathered) -> str:
    """Why the nominal mechanism cannot be held against the readings; empty where it can."""
    from truing.simulation.mechanisms.legs.kinematics import reaches

    readings = gathered.calibration.conditions.readings
    count = int((~reaches(gathered.model.nominal, readings)).sum())
    if not count:
        return ""
    return (
        f"the legs of [mechanism] cannot meet the platform at the readings of {count} of "
        f"{counted(len(readings), 'pose')}"
    )


def _diagnose(gathered: Gathered, rays: RayFindings | None, settings: Campaign, progress: Progress) -> Outcome:
    from truing.stages.diagnosis.artifacts import artifacts_of
    from truing.stages.diagnosis.ray_rows import with_rays

    rule = rule_of(settings, of_points=rays is not None)
    diagnosis = decided(gathered, settings, progress)
    progress(0, 1, "what could have stayed hidden, and what to measure next")
    artifacts = artifacts_of(diagnosis, gathered, rule, settings)
    read, left_out = _read(gathered), _left_out(gathered, len(diagnosis.screened))
    if rays is not None:
        artifacts = with_rays(artifacts, rays, rule_of(settings))
        read = f"{read}; rays of {counted(len(rays.gathered.calibration.conditions.poses), 'pose')}"
        left_out = "; ".join(filter(None, (left_out if left_out != "nothing" else "", rays.left_out))) or "nothing"
    return Outcome(
        artifacts,
        read=read,
        left_out=left_out,
        figure=_figure(artifacts["diagnosis"], diagnosis, gathered.shown),
    )


def _of_rays_alone(rays: RayFindings, why: str, settings: Campaign) -> Outcome:
    """What rays tell where points cannot be held against anything."""
    from truing.stages.diagnosis.ray_rows import with_rays

    artifacts = with_rays({"diagnosis": ARTIFACTS["diagnosis"].empty()}, rays, rule_of(settings))
    return Outcome(
        artifacts,
        read=f"rays of {counted(len(rays.gathered.calibration.conditions.poses), 'pose')}",
        left_out=rays.left_out or "nothing",
        figure=f"{_found(artifacts['diagnosis'])} in rays; points not evaluated: {why}",
    )


def rule_of(settings: Campaign, *, of_points: bool = False) -> Settings:
    """How sure a finding must be in a campaign; of its points alone, where rays are judged as well."""
    from truing.inference.selection import Settings
    from truing.stages.diagnosis.ray_findings import SHARE_OF_RAYS

    share = 1.0 - SHARE_OF_RAYS if of_points else 1.0
    return Settings(share * settings.diagnosis.false_alarm, DRAWS, settings.diagnosis.seed)


def kinds_of(settings: Campaign, *, photographed: bool = False) -> Mapping[str, Cause]:
    """The causes that a campaign's instrument and mechanism know, by id."""
    from truing.simulation.catalogue import (
        OF_TYPES,
        catalogue,
        catalogue_of_bodies,
        catalogue_of_readings,
        of_photographed_points,
    )

    if settings.mechanism.type in OF_TYPES:
        return OF_TYPES[settings.mechanism.type]()
    if settings.campaign.kind == "interferometer":
        return catalogue_of_readings()
    own = catalogue() if settings.mechanism.is_legged else catalogue_of_bodies()
    return own | of_photographed_points() if photographed else own


def decided(gathered: Gathered, settings: Campaign, progress: Progress) -> Diagnosis:
    """All that the search over the catalogue decides."""
    from truing.inference.selection import Acceptance
    from truing.simulation.mechanisms.recording import RecordedModel

    photographed = isinstance(gathered.model, RecordedModel) and gathered.model.photographed is not None
    search = Acceptance(
        gathered.model,
        gathered.calibration,
        gathered.held_out,
        rule_of(settings, of_points=photographed),
        lambda what: progress(0, 1, what),
        gathered.given,
    )
    return search.run(list(kinds_of(settings, photographed=photographed).values()))


def _read(gathered: Gathered) -> str:
    held = 0 if gathered.held_out is None else len(gathered.held_out.conditions.readings)
    seen = int(gathered.calibration.measured.seen.sum())
    what, where = ("point", "pose") if gathered.shown is None else ("reading", gathered.shown.epoch)
    used = counted(len(gathered.calibration.conditions.readings), where)
    return f"{counted(seen, what)} of {used}, {counted(held, where)} held out"


def _left_out(gathered: Gathered, gross: int) -> str:
    said = [gathered.left_out] if gathered.left_out else []
    what = "point" if gathered.shown is None else "reading"
    return "; ".join([*said, gross_errors(gross, what)] if gross else said) or "nothing"


def _figure(table: pa.Table, diagnosis: Diagnosis, channels: Channels | None) -> str:
    from truing.report.numbers import two_decimals
    from truing.stages.diagnosis.shown import POINTS

    final = diagnosis.final
    shown = POINTS if channels is None else channels.whole(final.error)
    rms, floor = shown.rms(final.error) or 0.0, shown.floor(final.floor)
    left = f"{two_decimals(rms)} {shown.unit} rms, noise alone leaves {two_decimals(floor)}"
    if not any(verdict == "found" for verdict in table.column("verdict").to_pylist()):
        return f"nothing found: {left}"
    before = shown.rms(diagnosis.plain.error) or 0.0
    return f"{_found(table)}: {two_decimals(before)} -> {left}"


def _found(table: pa.Table) -> str:
    """What was found, in words."""
    found = [row for row in table.to_pylist() if row["verdict"] == "found"]
    # What is found of the noise has no name of its own among the causes.
    names = [
        "noise not as declared" if "noise_ratio" in json.loads(row["parameters"]) else row["cause"] for row in found
    ]
    return f"found {', '.join(dict.fromkeys(names))}" if names else "nothing found"


def _not_evaluated(why: str) -> Outcome:
    return Outcome.not_evaluated({"diagnosis": ARTIFACTS["diagnosis"].empty()}, why)
