"""Photographs of a campaign: listed, opened and measured in parallel processes, and their tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from truing.formats.faultlog import FaultLog
from truing.formats.image_files import read_grey
from truing.formats.photographs import Photograph, PhotographFiles, list_photographs
from truing.formats.raw import Unusable
from truing.formats.source import CampaignFiles
from truing.report.numbers import count_text, reasons
from truing.schemas.faults import Fault
from truing.schemas.photographs import FAMILIES, MARKERS, RINGS, USUAL
from truing.stages.declaration import Progress
from truing.stages.image_tables.measured_rays import RayTables, artifact_table
from truing.stages.image_tables.point_names import survey_names
from truing.stages.image_tables.prior_knowledge import read_known

if TYPE_CHECKING:
    from truing.estimation.image_targets.photograph_targets import PhotographTargets, TargetPlan
    from truing.schemas.campaign import Campaign
    from truing.schemas.photographs import Photographs

# Below this number of pixels, starting a process takes longer than measuring them.
_WORTH_PROCESSES = 30_000_000
_TURNED = "its file says that it is {}; its pixels are used unchanged"


@dataclass(frozen=True)
class Piece:
    """One photograph to measure, and the targets to find."""

    photograph: Photograph
    plan: TargetPlan

    def __str__(self) -> str:
        return self.photograph.file.name


def opened(source: CampaignFiles, settings: Campaign) -> str:
    """Photographs and their tables, each opened completely, in words; raises CampaignFaults."""
    log = FaultLog()
    read_known(source, settings, log)
    photographs = open_all(source, settings, log)
    log.raise_faults()
    photos = photographs.found
    poses, cameras = ({getattr(photo, name) for photo in photos} for name in ("pose", "camera"))
    text = f"{count_text(len(photos), 'photograph')} of {count_text(len(poses), 'pose')}"
    text += f" by {count_text(len(cameras), 'camera')}"
    left_out = reasons("file", photographs.left_out)
    return text + (f"; left out {'; '.join(left_out)}" if left_out else "")


def open_all(source: CampaignFiles, settings: Campaign, log: FaultLog) -> PhotographFiles:
    """The photographs, each opened completely; faults go into ``log``."""
    photographs = list_photographs(source, settings.photographs.sensor_width_mm, log)
    for photo in photographs.found:
        try:
            read_grey(photo.file.path, photo.head)
        except Unusable as error:
            log.add(Fault(photo.file.name, error.expected, value=error.value))
    return photographs


def measure(piece: Piece) -> PhotographTargets | Unusable:
    """Measure the targets of one photograph; an unreadable file gives its fault, never an exception."""
    import cv2

    from truing.estimation.image_targets.photograph_targets import measure_targets

    cv2.setNumThreads(1)  # there is a process for every core
    try:
        grey = read_grey(piece.photograph.file.path, piece.photograph.head)
    except Unusable as error:
        return error
    return measure_targets(np.ascontiguousarray(grey), piece.plan)


Each = Callable[
    [Callable[[Piece], "PhotographTargets | Unusable"], Sequence[Piece], Callable[[int], None]],
    Iterator["PhotographTargets | Unusable"],
]
"""Apply a function to every piece in parallel, report the number done, and yield the results in order."""


def read_photographs(
    source: CampaignFiles,
    settings: Campaign,
    targets: pa.Table | None,
    log: FaultLog,
    progress: Progress,
    each: Each | None,
) -> RayTables | None:
    """Measure all photographs; None, with a fault in ``log``, if one cannot be read or there is none.

    Names of codes become those of the table image_targets (``targets``).
    """
    photographs = list_photographs(source, settings.photographs.sensor_width_mm, log)
    if log:
        open_all(source, settings, log)  # further faults are reported together with it
    if log or not photographs.found:
        return None
    plan = target_plan(settings.photographs, targets)
    measured = []
    for photograph, measured_photo in zip(photographs.found, _measured(photographs, plan, progress, each), strict=True):
        if isinstance(measured_photo, Unusable):
            log.add(Fault(photograph.file.name, measured_photo.expected, value=measured_photo.value))
        else:
            measured.append(measured_photo)
    if log:
        return None
    return RayTables(
        _image_points(photographs, measured, targets),
        _photographs(photographs, measured),
        _rejections(photographs, measured),
        photographs.left_out,
    )


def target_plan(wanted: Photographs, targets: pa.Table | None) -> TargetPlan:
    """Return the code families to search for: those declared, otherwise those of image_targets, otherwise the usual
    ones; none next to boards, whose markers are also codes."""
    from truing.estimation.image_targets.boards import BoardPlan
    from truing.estimation.image_targets.photograph_targets import TargetPlan

    families: tuple[str, ...] = () if wanted.boards else USUAL
    if wanted.targets is not None:
        families = tuple(dict.fromkeys(wanted.targets))
    elif targets is not None:
        named = set(targets.column("family").to_pylist())
        families = tuple(family for family in FAMILIES if family in named)
    boards = tuple(
        BoardPlan(b.label, b.kind, b.columns, b.rows, b.family, b.first_code, b.marker_share, b.legacy)
        for b in wanted.boards
    )
    return TargetPlan(
        rings=tuple(family for family in families if family in RINGS),
        uncoded=bool(families) or not boards if wanted.uncoded is None else wanted.uncoded,
        markers=tuple(family for family in families if family in MARKERS),
        boards=boards,
        polarity=wanted.polarity,
        smallest_px=wanted.smallest_px,
        largest_px=wanted.largest_px,
    )


def _measured(
    photographs: PhotographFiles, plan: TargetPlan, progress: Progress, each: Each | None
) -> Iterator[PhotographTargets | Unusable]:
    pieces = [Piece(photograph, plan) for photograph in photographs.found]
    pixels = sum(photo.head.width_px * photo.head.height_px for photo in photographs.found)
    if each is not None and len(pieces) > 1 and pixels > _WORTH_PROCESSES:
        yield from each(measure, pieces, lambda done: progress(done, len(pieces), "photographs"))
        return
    for done, piece in enumerate(pieces):
        progress(done, len(pieces), str(piece))
        yield measure(piece)


def _photograph_columns(photographs: PhotographFiles, counts: Sequence[int]) -> dict[str, list[Any]]:
    """The columns pose, image and camera for a number of rows of each photograph."""
    rows = [photo for photo, count in zip(photographs.found, counts, strict=True) for _ in range(count)]
    poses = [int(photo.pose) if photographs.poses_are_numbers else photo.pose for photo in rows]
    return {"pose": poses, "image": [photo.image for photo in rows], "camera": [photo.camera for photo in rows]}


def _image_points(
    photographs: PhotographFiles, measured: Sequence[PhotographTargets], targets: pa.Table | None
) -> pa.Table:
    names, kinds, xy, cov, ellipse, contrast = (
        np.concatenate([getattr(value, name) for value in measured])
        for name in ("names", "kinds", "xy_px", "cov_px2", "ellipse", "contrast")
    )
    columns = {
        **_photograph_columns(photographs, [len(value.names) for value in measured]),
        **dict(zip(("point", "body", "target"), survey_names(names, targets), strict=True)),
        "kind": kinds,
        "x_px": xy[:, 0],
        "y_px": xy[:, 1],
        "cov_xx_px2": cov[:, 0, 0],
        "cov_xy_px2": cov[:, 0, 1],
        "cov_yy_px2": cov[:, 1, 1],
        **dict(zip(("semi_major_px", "semi_minor_px", "axis_angle_rad"), ellipse.T, strict=True)),
        "contrast": contrast,
    }
    return _table("image_points", columns, photographs)


def _photographs(photographs: PhotographFiles, measured: Sequence[PhotographTargets]) -> pa.Table:
    heads = [photo.head for photo in photographs.found]
    of_heads = ("width_px", "height_px", "principal_distance_px", "principal_distance_from", "taken_at")
    columns = {
        **_photograph_columns(photographs, [1] * len(measured)),
        "file": [photo.file.name for photo in photographs.found],
        **{name: [getattr(head, name) for head in heads] for name in of_heads},
        "grey_bits": [head.bits for head in heads],
        "targets_measured": [len(value.names) for value in measured],
        "image_remark": [_TURNED.format(head.turned) if head.turned else None for head in heads],
    }
    return _table("photographs", columns, photographs)


def _rejections(photographs: PhotographFiles, measured: Sequence[PhotographTargets]) -> pa.Table:
    whose = _photograph_columns(photographs, [len(value.rejected) for value in measured])
    rows = [(kind, reason, count) for value in measured for (kind, reason), count in sorted(value.rejected.items())]
    columns = {name: whose[name] for name in ("pose", "image")}
    columns |= {name: [row[k] for row in rows] for k, name in enumerate(("kind", "reason", "rows"))}
    return _table("image_rejections", columns, photographs)


def _table(name: str, columns: Mapping[str, object], photographs: PhotographFiles) -> pa.Table:
    return artifact_table(name, columns, "int64" if photographs.poses_are_numbers else "string")


def refused_words(rejections: pa.Table) -> str:
    """Rejected candidates of the photographs, most frequent first, in one line; empty for none."""
    total: Counter[str] = Counter()
    for row in rejections.to_pylist():
        total[f"{row['kind']}: {row['reason']}"] += row["rows"]
    return "; ".join(f"{count:,} {reason}" for reason, count in total.most_common(5))
