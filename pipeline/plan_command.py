"""`truing plan`: where to stand with a camera, from a campaign's targets and its camera alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.campaign_folder import CampaignFolder
from pipeline.given_table import ENDINGS, read_given, table_bytes
from pipeline.plan_cameras import known_cameras
from pipeline.problems import ExitCode
from pipeline.run_campaign import usable_campaign
from pipeline.run_owner import folder_beside_run, note_owner
from pipeline.voice import Voice
from pipeline.written_places import check_file
from schemas.faults import CampaignFaults, Fault

if TYPE_CHECKING:
    import pyarrow as pa

    from stages.photograph_plan import PhotographPlan, PlanWish, Targets

_DEFAULT_FILE = "plan.csv"


@dataclass(frozen=True)
class PlanFiles:
    """What the call names: the camera of several, the run that adjusted it, a table of normals, the file to write; each
    may be absent."""

    camera: str | None = None
    run: Path | None = None
    normals: Path | None = None
    out: Path | None = None


def plan_campaign(place: Path, wish: PlanWish, files: PlanFiles) -> ExitCode:
    """Choose stations, say how well the targets will be known, and leave tables and a page. Raises CampaignFaults."""
    from stages.photograph_layout import planned_network
    from stages.photograph_plan import plan_photographs
    from stages.photograph_plan_tables import sentences, tables

    campaign, voice = usable_campaign(place), Voice(quiet=False)
    settings = campaign.validated()
    _check(settings.campaign.kind, wish, files)
    folder = folder_beside_run(campaign)
    if files.out is not None:
        check_file(files.out, reads=(files.normals,), campaign=campaign)
    normals = None if files.normals is None else read_given(files.normals, "a table of normals")
    known = _tables(campaign)
    cameras = known_cameras(campaign, known.pop("cameras_given", None), files.run)
    known |= {} if cameras.table is None else {"cameras_given": cameras.table}
    planned, targets, left_out = planned_network(settings, known, normals, files.camera, cameras.noise_px)
    left_out = (*left_out, *_not_modelled(targets))
    try:
        with voice.during("plan") as progress:
            found = plan_photographs(
                planned, targets, wish, settings.reference_body, lambda done, of: progress(done, of, "stations")
            )
    except ValueError as why:
        raise CampaignFaults([Fault(str(campaign.file), f"targets that can be photographed: {why}")]) from None
    left_out = (*([_of_camera(cameras.said, found)] if cameras.said else []), *left_out)
    for line in (*sentences(found), *left_out):
        voice.say(line)
    if files.out is None:
        note_owner(campaign, folder)
    file = folder / _DEFAULT_FILE if files.out is None else files.out
    written = _leave(campaign.name, found, tables(found), left_out, file)
    voice.say(f"tables and page: {', '.join(map(str, written))}")
    return ExitCode.DONE


def _of_camera(said: str, plan: PhotographPlan) -> str:
    distance, noise = plan.planned.interior[0], plan.planned.sigma_px
    return f"{said} Its principal distance is {distance:.1f} px, the noise of an image coordinate {noise:.3g} px."


def _not_modelled(targets: Targets) -> list[str]:
    """What the plan takes to be seen that may not be."""
    from numpy import isnan

    turned = int((~isnan(targets.layout.normals).any(axis=1)).sum())
    said = "Nothing is taken to stand in the way of a ray, neither other things nor the object itself"
    if turned == len(targets.name):
        return [f"{said}, but for what faces away."]
    count = f"{turned} of {len(targets.name)} targets have" if turned else "no target has"
    return [f"{said}; {count} a normal, without which it counts as seen from behind, too (--normals)."]


def _check(kind: str, wish: PlanWish, files: PlanFiles) -> None:
    faults = []
    if kind != "photogrammetry":
        faults.append(Fault("campaign.toml", "photogrammetry", column="campaign.kind", value=kind))
    if files.out is not None and files.out.suffix not in ENDINGS:
        faults.append(Fault("--out", "a file that ends in .csv or .parquet", value=str(files.out)))
    low, high = wish.elevation_deg
    if not -90.0 <= low < high <= 90.0:
        faults.append(Fault("--elevation", "two angles from -90 to 90, the lower one first", value=f"{low:g},{high:g}"))
    nearest, farthest = wish.nearest_mm, wish.farthest_mm
    if nearest is not None and farthest is not None and nearest >= farthest:
        faults.append(Fault("--distance", "two distances, the shorter one first", value=f"{nearest:g},{farthest:g}"))
    if faults:
        raise CampaignFaults(faults)


def _tables(campaign: CampaignFolder) -> dict[str, pa.Table]:
    """The survey, and what is known of cameras, scale bars and codes; raises CampaignFaults."""
    from stages.image_tables.cameras_beforehand import read_cameras
    from stages.image_tables.known_beforehand import read_image_targets, read_scale_bars
    from stages.ingestion.tables import read_survey
    from truing.formats.faultlog import FaultLog
    from truing.formats.source import CampaignFiles

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
    log.throw()
    if found["survey"] is None:
        raise CampaignFaults([Fault("targets.csv", "the survey of the targets, or their planned places")])
    return {name: table.table for name, table in found.items() if table is not None}


def _leave(
    name: str, plan: PhotographPlan, tables: Mapping[str, pa.Table], left_out: tuple[str, ...], file: Path
) -> list[Path]:
    """Write the tables and the page; the files, in order."""
    from pipeline.problems import environment
    from pipeline.whole_file import write_whole
    from stages.photograph_plan_tables import sentences
    from truing.report.plan_page import plan_head, plan_sections
    from truing.report.rendering.render import render_page

    with environment(f"{file.parent} cannot be made"):
        file.parent.mkdir(parents=True, exist_ok=True)
    written = {file.with_name(f"{file.stem}{ending}{file.suffix}"): table for ending, table in tables.items()}
    for path, table in written.items():
        write_whole(path, table_bytes(table, file.suffix, quoting="needed"))
    frames = {ending.lstrip("-") or "stations": table.to_pandas() for ending, table in tables.items()}
    points = 1e3 * plan.planned.layout.points
    for axis, column in zip("xyz", points.T, strict=True):
        frames["targets"][f"{axis}_mm"] = column
    camera = plan.planned.camera
    half = (0.5 * camera.width_px / plan.planned.interior[0], 0.5 * camera.height_px / plan.planned.interior[0])
    page = render_page(
        plan_head(name, (*sentences(plan), *left_out), plan.reaches, frames),
        plan_sections(frames, plan.stations.R, half, plan.wish.wanted_mm),
    )
    write_whole(file.with_suffix(".html"), page.encode())
    return [*written, file.with_suffix(".html")]
