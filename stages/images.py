"""Images: photographs become rays, or rays measured elsewhere are read; what is known of the network beforehand."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from truing.formats.source import OF_IMAGES, CampaignFiles
from truing.report.numbers import count as counted
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import Fault
from truing.stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.formats.faultlog import FaultLog
    from truing.stages.common.gathered import SmallTable
    from truing.stages.image_tables.measured_rays import MeasuredRays
    from truing.stages.image_tables.photographs import Each, PhotographTables

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
    settings: Any,
    progress: Progress,
    source: CampaignFiles,
    each: Each | None = None,
) -> Outcome:
    """Rays with covariance, and what is known of the network; raises CampaignFaults with all that is wrong.

    ``each`` measures photographs, several at a time; absent: one after the other, in this process.
    """
    from truing.formats.faultlog import FaultLog
    from truing.stages.image_tables.known_beforehand import regrouped

    log = FaultLog()
    small = _known_beforehand(source, settings, log)
    rays: MeasuredRays | PhotographTables | None
    if source.entries("images"):
        from truing.stages.image_tables.photographs import read_photographs

        rays = read_photographs(source, settings, _names(small), log, progress, each)
    else:
        rays = _measured_elsewhere(source, settings, small, log)
    log.throw()
    assert rays is not None  # else there was a fault
    artifacts = {"image_points": rays.image_points, "photographs": rays.photographs}
    artifacts = regrouped(artifacts, settings.cameras, log) | {"image_rejections": _rejections(rays)}
    log.throw()
    artifacts |= {name: table.table for name, table in small.items() if table is not None}
    points = len(set(rays.image_points.column("point").to_pylist()) - {""})
    poses = len(set(rays.photographs.column("pose").to_pylist()))
    read = f"{counted(len(rays.image_points), 'ray')} of {counted(len(rays.photographs), 'image')}"
    return Outcome(
        artifacts,
        read="; ".join((read, *_lacking(rays, small))),
        left_out=_left_out(small, rays.left_out, artifacts["image_rejections"]),
        figure=f"{counted(points, 'point')} in {counted(poses, 'pose')}",
    )


def _lacking(rays: MeasuredRays | PhotographTables, small: dict[str, SmallTable | None]) -> list[str]:
    """What files of rays measured elsewhere do not say."""
    without_sigma = getattr(rays, "without_sigma", None)
    if without_sigma is None:
        return []
    said = []
    if without_sigma:
        said.append(f"{without_sigma:,} of them without a standard deviation: [noise] image_px")
    if not any(small.get(name) for name in ("scale_bars", "known_points", "image_targets")):
        said.append("nothing tells their scale")
    return said


def look(settings: Any, source: CampaignFiles) -> str:
    """What photographs and the tables beside them hold, without measuring; raises CampaignFaults as ``run`` does."""
    from truing.formats.faultlog import FaultLog
    from truing.stages.image_tables.photographs import open_all

    log = FaultLog()
    _known_beforehand(source, settings, log)
    photographs = open_all(source, settings, log)
    log.throw()
    found = photographs.found
    poses, cameras = ({getattr(one, name) for one in found} for name in ("pose", "camera"))
    said = f"{counted(len(found), 'photograph')} of {counted(len(poses), 'pose')} by {counted(len(cameras), 'camera')}"
    counts = Counter({reason: 0 for _, reason in photographs.left_out})
    for (_, reason), count in photographs.left_out.items():
        counts[reason] += count
    words = [f"{counted(count, 'file')}: {reason}" for reason, count in counts.most_common()]
    return said + (f"; left out {'; '.join(words)}" if words else "")


def _known_beforehand(source: CampaignFiles, settings: Any, log: FaultLog) -> dict[str, SmallTable | None]:
    from truing.stages.image_tables.known_beforehand import (
        read_cameras,
        read_image_targets,
        read_known_points,
        read_scale_bars,
    )

    mapped = [table for table in OF_IMAGES if getattr(settings.files, table)]
    if source.entries("images") and source.entries("image_points"):
        expected = "either photographs (images) or rays measured elsewhere (image_points), not both"
        log.add(Fault("campaign.toml", expected, column=f"files.{[*mapped, 'images'][0]}"))
        log.throw()
    targets = read_image_targets(source, tuple(board.label for board in settings.photographs.boards), log)
    names = None if targets is None else targets.table
    return {
        "image_targets": targets,
        "scale_bars": read_scale_bars(source, names, log),
        "known_points": read_known_points(source, names, log),
        "cameras_given": read_cameras(source, settings, log),
    }


def _names(small: Mapping[str, SmallTable | None]) -> pa.Table | None:
    targets = small["image_targets"]
    return None if targets is None else targets.table


def _measured_elsewhere(
    source: CampaignFiles, settings: Any, small: Mapping[str, SmallTable | None], log: FaultLog
) -> MeasuredRays | None:
    from truing.stages.image_tables.measured_rays import read_rays

    cameras = small["cameras_given"]
    return read_rays(source, settings, _names(small), None if cameras is None else cameras.table, log)


def _rejections(rays: MeasuredRays | PhotographTables) -> pa.Table:
    """What was refused as a target; of rays measured elsewhere nothing is known of that."""
    known: pa.Table | None = getattr(rays, "image_rejections", None)
    if known is not None:
        return known
    return ARTIFACTS["image_rejections"].empty("int64" if _whole(rays.photographs.column("pose")) else "string")


def _whole(poses: pa.ChunkedArray) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_int64(poses.type))


def _left_out(small: Mapping[str, SmallTable | None], rays: Mapping[tuple[str, str], int], rejections: pa.Table) -> str:
    """Rows that were left out and candidates for targets that were refused, with the reasons."""
    total: Counter[str] = Counter()
    for left_out in (rays, *(table.left_out for table in small.values() if table is not None)):
        for (_, reason), count in left_out.items():
            total[reason] += count
    words = [f"{counted(count, 'row')}: {reason}" for reason, count in total.most_common()]
    if len(rejections):
        from truing.stages.image_tables.photographs import refused_words

        words.append(f"candidates for targets: {refused_words(rejections)}")
    return "; ".join(words) or "nothing"
