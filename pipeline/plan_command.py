"""`truing plan`: choice of camera stations from a campaign's targets and camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pyarrow as pa
from numpy import isnan

from truing.estimation.bundle.camera import PARAMETERS
from truing.estimation.bundle.photograph_plan import PhotographPlan, PlannedTargets, PlanOptions, plan_photographs
from truing.formats.faultlog import FaultLog
from truing.formats.photographs import list_photographs
from truing.formats.source import CampaignFiles
from truing.pipeline.artifacts import table_of
from truing.pipeline.campaign_folder import CampaignFolder, run_folder_of
from truing.pipeline.console import RunConsole
from truing.pipeline.given_files import check_file, leave_tables, read_given
from truing.pipeline.problems import ExitCode
from truing.pipeline.run_campaign import usable_campaign
from truing.pipeline.run_owner import folder_next_to_run, note_owner
from truing.report.glossary_section import with_reference
from truing.report.plan_page import plan_head, plan_sections
from truing.report.rendering.render import render_page
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import CampaignFaults, Fault
from truing.stages.image_tables.prior_knowledge import cameras_table, read_cameras, read_image_targets, read_scale_bars
from truing.stages.ingestion.tables import read_survey
from truing.stages.photograph_planning.plan_tables import sentences, tables
from truing.stages.photograph_planning.planned_network import planned_network

_DEFAULT_FILE = "plan.csv"


@dataclass(frozen=True)
class PlanFiles:
    """Names in the call, each optional: camera, run that adjusted it, table of normals, output file."""

    camera: str | None = None
    run: Path | None = None
    normals: Path | None = None
    out: Path | None = None


def plan_campaign(path: Path, options: PlanOptions, files: PlanFiles, console: RunConsole) -> ExitCode:
    """Choose stations, predict the uncertainty of targets, and write tables and a page. Raises CampaignFaults."""
    campaign = usable_campaign(path)
    settings = campaign.validated()
    _check(settings.campaign.kind, options)
    check_file(files.out, reads=(files.normals,), campaign=campaign)
    folder = folder_next_to_run(campaign)
    normals = None if files.normals is None else read_given(files.normals, "a table of normals")
    known = _tables(campaign)
    cameras = known_cameras(campaign, known.pop("cameras_given", None), files.run)
    known |= {} if cameras.table is None else {"cameras_given": cameras.table}
    planned, targets, left_out = planned_network(settings, known, normals, files.camera, cameras.noise_px)
    left_out = (*left_out, *_not_modelled(targets))
    try:
        with console.during("plan") as progress:
            photograph_plan = plan_photographs(
                planned, targets, options, settings.reference_body, lambda done, of: progress(done, of, "stations")
            )
    except ValueError as why:
        raise CampaignFaults([Fault(str(campaign.file), f"targets that can be photographed: {why}")]) from None
    left_out = (*([_of_camera(cameras.description, photograph_plan)] if cameras.description else []), *left_out)
    for line in (*sentences(photograph_plan), *left_out):
        console.sentence(line)
    if files.out is None:
        note_owner(campaign, folder)
    file = folder / _DEFAULT_FILE if files.out is None else files.out
    planned_tables = tables(photograph_plan)
    for ending, table in planned_tables.items():
        for row in table.to_pylist():
            console.add_fact(ending.lstrip("-") or "stations", row)
    written = _leave(campaign.name, photograph_plan, planned_tables, left_out, file)
    console.written(f"tables and page: {', '.join(map(str, written))}", written)
    return ExitCode.DONE


def _of_camera(text: str, plan: PhotographPlan) -> str:
    distance, noise = plan.planned.interior[0], plan.planned.sigma_px
    return f"{text} Its principal distance is {distance:.1f} px, the noise of an image coordinate {noise:.3g} px."


def _not_modelled(targets: PlannedTargets) -> list[str]:
    """Sentence on obstructions that the plan ignores."""
    turned = int((~isnan(targets.layout.normals).any(axis=1)).sum())
    text = "The plan assumes that nothing blocks a ray, neither other objects nor the object itself"
    if turned == len(targets.name):
        return [f"{text}, except for targets that face away."]
    count = f"{turned} of {len(targets.name)} targets have" if turned else "no target has"
    return [f"{text}; {count} a normal; targets without one count as visible also from behind (--normals)."]


def _check(kind: str, options: PlanOptions) -> None:
    faults = []
    if kind != "photogrammetry":
        faults.append(Fault("campaign.toml", "photogrammetry", column="campaign.kind", value=kind))
    low, high = options.elevation_deg
    if not -90.0 <= low < high <= 90.0:
        faults.append(Fault("--elevation", "two angles from -90 to 90, the lower one first", value=f"{low:g},{high:g}"))
    nearest, farthest = options.nearest_mm, options.farthest_mm
    if nearest is not None and farthest is not None and nearest >= farthest:
        faults.append(Fault("--distance", "two distances, the shorter one first", value=f"{nearest:g},{farthest:g}"))
    if faults:
        raise CampaignFaults(faults)


def _tables(campaign: CampaignFolder) -> dict[str, pa.Table]:
    """Survey, and prior knowledge of cameras, scale bars and codes; raises CampaignFaults."""
    settings, log = campaign.validated(), FaultLog()
    source = CampaignFiles(campaign.folder, settings)
    targets = read_image_targets(source, tuple(board.label for board in settings.photographs.boards), log)
    codes = None if targets is None else targets.table
    found = {
        "survey": read_survey(source, settings, log),
        "cameras_given": read_cameras(source, settings, log),
        "scale_bars": read_scale_bars(source, codes, log),
        "image_targets": targets,
    }
    log.raise_faults()
    if found["survey"] is None:
        raise CampaignFaults([Fault("targets.csv", "the survey of the targets, or their planned places")])
    return {name: table.table for name, table in found.items() if table is not None}


def _leave(
    name: str, plan: PhotographPlan, tables: Mapping[str, pa.Table], left_out: tuple[str, ...], file: Path
) -> list[Path]:
    """Write the tables and the page; returns the files in order."""
    frames = {ending.lstrip("-") or "stations": table.to_pandas() for ending, table in tables.items()}
    points = 1e3 * plan.planned.layout.points
    for axis, column in zip("xyz", points.T, strict=True):
        frames["targets"][f"{axis}_mm"] = column
    camera = plan.planned.camera
    half = (0.5 * camera.width_px / plan.planned.interior[0], 0.5 * camera.height_px / plan.planned.interior[0])
    page = render_page(
        plan_head(name, (*sentences(plan), *left_out), plan.reaches, frames),
        with_reference(plan_sections(frames, plan.stations.R, half, plan.options.target_sigma_mm)),
    )
    return leave_tables(file, tables, page)


@dataclass(frozen=True)
class _KnownCameras:
    """Cameras with one row per parameter as in cameras_given; noise of an image coordinate by camera in px, if a run
    found it; and their source, in words."""

    table: pa.Table | None
    noise_px: Mapping[str, float] = field(default_factory=dict)
    description: str = ""


def known_cameras(campaign: CampaignFolder, cameras: pa.Table | None, run: Path | None) -> _KnownCameras:
    """Cameras of the named run, else of campaign.toml, else of the campaign's run, else of its photographs.

    Raises CampaignFaults if the named run has none.
    """
    if cameras is not None and run is None:
        return _KnownCameras(cameras)
    found = _adjusted(run or run_folder_of(campaign, None, several=False))
    if found is None and run is not None:
        expected = f"a run that adjusted photographs, with {ARTIFACTS['cameras'].file}"
        raise CampaignFaults([Fault("--run", expected, value=str(run))])
    return found or _of_pictures(campaign) or _KnownCameras(None)


def _adjusted(run: Path) -> _KnownCameras | None:
    """Cameras as a run adjusted them; parameters that it calibrated are free again."""
    cameras, rays = table_of(run, "cameras"), table_of(run, "image_residuals")
    if cameras is None or rays is None:
        return None
    used = rays.to_pandas().query("not rejected")
    noise = used.groupby("camera")[["sigma_x_px", "sigma_y_px"]].median().mean(axis=1)
    names = list(dict.fromkeys(cameras.column("camera").to_pylist()))
    what = f"camera {names[0]}" if len(names) == 1 else f"cameras {', '.join(names)}"
    return _KnownCameras(cameras, noise.to_dict(), f"With {what} as adjusted in {run.as_posix()}.")


def _of_pictures(campaign: CampaignFolder) -> _KnownCameras | None:
    """Cameras from the metadata of a campaign's photographs: format and principal distance."""
    settings, log = campaign.validated(), FaultLog()
    source = CampaignFiles(campaign.folder, settings)
    rows: dict[str, dict[str, object]] = {}
    for one in list_photographs(source, settings.photographs.sensor_width_mm, log).found:
        if one.head.principal_distance_px is not None:
            head = {"width_px": one.head.width_px, "height_px": one.head.height_px}
            rows.setdefault(one.camera, {**head, "focal_px": one.head.principal_distance_px, "free": PARAMETERS})
    if not rows:
        return None
    return _KnownCameras(
        cameras_table(rows), description=f"With {', '.join(rows)} from the photographs' metadata, not calibrated."
    )
