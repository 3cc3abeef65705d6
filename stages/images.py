"""Images: photographs become rays, or rays measured elsewhere are read; what is known of the network beforehand."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from schemas.artifacts import ARTIFACTS
from schemas.faults import Fault
from stages.declaration import Outcome, Progress, Stage
from truing.formats.source import OF_IMAGES, CampaignFiles

if TYPE_CHECKING:
    import pyarrow as pa

    from stages.ingestion.tables import SmallTable

DECLARATION = Stage(
    name="images",
    reads=(),
    leaves=(
        *("image_points", "photographs", "image_rejections"),
        *("image_targets?", "scale_bars?", "known_points?", "cameras_given?"),
    ),
    settings=("cameras", "noise.image_px", *(f"files.{table}" for table in OF_IMAGES)),
    summary="measures targets in photographs, or reads rays measured elsewhere",
)


def run(tables: Mapping[str, pa.Table], settings: Any, progress: Progress, source: CampaignFiles) -> Outcome:
    """Rays with covariance, and what is known of the network; raises CampaignFaults with all that is wrong."""
    from stages.image_tables.known_beforehand import (
        read_cameras,
        read_image_targets,
        read_known_points,
        read_scale_bars,
    )
    from stages.image_tables.measured_rays import read_rays
    from truing.formats.faultlog import FaultLog

    log = FaultLog()
    mapped = [table for table in OF_IMAGES if getattr(settings.files, table)]
    targets = read_image_targets(source, log)
    names = None if targets is None else targets.table
    small = {
        "image_targets": targets,
        "scale_bars": read_scale_bars(source, names, log),
        "known_points": read_known_points(source, names, log),
        "cameras_given": read_cameras(source, settings, log),
    }
    if source.entries("images") and source.entries("image_points"):
        expected = "either photographs (images) or rays measured elsewhere (image_points), not both"
        log.add(Fault("campaign.toml", expected, column=f"files.{[*mapped, 'images'][0]}"))
        log.throw()
    cameras = small["cameras_given"]
    rays = read_rays(source, settings, names, None if cameras is None else cameras.table, log)
    log.throw()
    assert rays is not None  # else there was a fault
    poses = rays.photographs.column("pose")
    artifacts = {"image_points": rays.image_points, "photographs": rays.photographs}
    artifacts["image_rejections"] = ARTIFACTS["image_rejections"].empty("int64" if _whole(poses) else "string")
    artifacts |= {name: table.table for name, table in small.items() if table is not None}
    images, points = len(rays.photographs), len(set(rays.image_points.column("point").to_pylist()) - {""})
    return Outcome(
        artifacts,
        read=f"{len(rays.image_points):,} rays of {images} images",
        left_out=_left_out(small, rays.left_out),
        figure=f"{points} points in {len(set(poses.to_pylist()))} poses",
    )


def _whole(poses: pa.ChunkedArray) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_int64(poses.type))


def _left_out(small: Mapping[str, SmallTable | None], rays: Mapping[tuple[str, str], int]) -> str:
    total: Counter[str] = Counter()
    for left_out in (rays, *(table.left_out for table in small.values() if table is not None)):
        for (_, reason), count in left_out.items():
            total[reason] += count
    return "; ".join(f"{count:,} rows: {reason}" for reason, count in total.most_common()) or "nothing"
