"""Stage images: rays from photographs or files, and prior knowledge of the network."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from truing.formats.source import OF_IMAGES, CampaignFiles
from truing.report.numbers import count_text
from truing.stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign
    from truing.stages.image_tables.photographs import Each

DECLARATION = Stage(
    name="images",
    reads=(),
    leaves=(
        *("image_points", "photographs", "image_rejections"),
        *("image_targets?", "scale_bars?", "known_points?", "cameras_given?"),
    ),
    settings=(
        *("cameras", "noise.image_px", *(f"files.{table}" for table in OF_IMAGES)),
        *(f"photographs.{name}" for name in ("targets", "uncoded", "boards", "polarity", "smallest_px", "largest_px")),
        "photographs.sensor_width_mm",
    ),
    summary="measures targets in photographs, or reads rays measured elsewhere",
)


def run(
    tables: Mapping[str, pa.Table],
    settings: Campaign,
    progress: Progress,
    source: CampaignFiles,
    each: Each | None = None,
) -> Outcome:
    """Rays with covariance, and prior knowledge of the network; raises CampaignFaults with all faults.

    ``each`` measures photographs, several at a time; absent: one after the other, in this process.
    """
    from truing.formats.faultlog import FaultLog
    from truing.report.numbers import reasons
    from truing.stages.image_tables.measured_rays import read_rays
    from truing.stages.image_tables.photographs import read_photographs, refused_words
    from truing.stages.image_tables.prior_knowledge import read_known, regrouped

    log = FaultLog()
    small = read_known(source, settings, log)
    known = {name: table.table for name, table in small.items()}
    elsewhere = not source.entries("images")
    if elsewhere:
        rays = read_rays(source, settings, known, log)
    else:
        rays = read_photographs(source, settings, known.get("image_targets"), log, progress, each)
    log.raise_faults()
    assert rays is not None  # else there was a fault
    whose = regrouped({"image_points": rays.image_points, "photographs": rays.photographs}, settings.cameras, log)
    log.raise_faults()
    points = len(set(rays.image_points.column("point").to_pylist()) - {""})
    poses = len(set(rays.photographs.column("pose").to_pylist()))
    read = [f"{count_text(len(rays.image_points), 'ray')} of {count_text(len(rays.photographs), 'image')}"]
    if elsewhere and rays.without_sigma:
        read.append(f"{rays.without_sigma:,} of them without a standard deviation: [noise] image_px")
    if elsewhere and not {"scale_bars", "known_points", "image_targets"} & known.keys():
        read.append("nothing gives their scale")
    left_out = reasons("row", rays.left_out, *(table.left_out for table in small.values()))
    if len(rays.image_rejections):
        left_out.append(f"candidates for targets: {refused_words(rays.image_rejections)}")
    return Outcome(
        {**whose, "image_rejections": rays.image_rejections, **known},
        read="; ".join(read),
        left_out="; ".join(left_out) or "nothing",
        figure=f"{count_text(points, 'point')} in {count_text(poses, 'pose')}",
    )


def photographs_summary(settings: Campaign, source: CampaignFiles) -> str:
    """Summary of photographs and their tables, without measuring; raises CampaignFaults like ``run``."""
    from truing.stages.image_tables.photographs import opened

    return opened(source, settings)
