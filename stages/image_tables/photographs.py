"""All photographs of a campaign: listed, opened and measured, in processes of their own, and the tables made of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from truing.formats.faultlog import FaultLog
from truing.formats.image_files import read_grey
from truing.formats.photographs import Photograph, Photographs, list_photographs
from truing.formats.raw import Unusable
from truing.formats.source import CampaignFiles
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import Fault
from truing.schemas.photographs import FAMILIES, MARKERS, RINGS, USUAL
from truing.stages.declaration import Progress
from truing.stages.image_tables.point_names import own_names

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.estimation.image_targets.boards import BoardCorners, BoardPlan
    from truing.estimation.image_targets.circles import ImageTargets
    from truing.estimation.image_targets.image_noise import ImageNoise
    from truing.estimation.image_targets.square_markers import MarkerCorners
    from truing.schemas.photographs import Photographs as PhotographSettings


# Below so many pixels a process of its own takes longer to begin than to measure them.
_WORTH_PROCESSES = 30_000_000
Array = NDArray[np.float64]


@dataclass(frozen=True)
class PhotographTables:
    """The tables image_points, photographs and image_rejections, and what was left out, by (file, reason)."""

    image_points: pa.Table
    photographs: pa.Table
    image_rejections: pa.Table
    left_out: Mapping[tuple[str, str], int]


def open_all(source: CampaignFiles, settings: Any, log: FaultLog) -> Photographs:
    """The photographs, each opened whole; what is wrong with any goes into ``log``."""
    photographs = list_photographs(source, settings.photographs.sensor_width_mm, log)
    for one in photographs.found:
        try:
            read_grey(one.file.path, one.head)
        except Unusable as error:
            log.add(Fault(one.file.name, error.expected, value=error.value))
    return photographs


def read_photographs(
    source: CampaignFiles,
    settings: Any,
    targets: pa.Table | None,
    log: FaultLog,
    progress: Progress,
    each: Each | None = None,
) -> PhotographTables | None:
    """Measure all photographs; None where one cannot be read, or none is there: ``log`` tells then.

    Names of codes become those of the table image_targets (``targets``).
    """
    photographs = list_photographs(source, settings.photographs.sensor_width_mm, log)
    if log:
        open_all(source, settings, log)  # what is wrong further down is told with it
    if log or not photographs.found:
        return None
    plan = target_plan(settings.photographs, families_of(settings, targets))
    pieces = [Piece(photograph, plan) for photograph in photographs.found]
    measured = list(_measured(pieces, progress, each))
    for piece, one in zip(pieces, measured, strict=True):
        if one.fault is not None:
            log.add(Fault(str(piece), one.fault.expected, value=one.fault.value))
    if log:
        return None
    identifier = "int64" if photographs.poses_are_numbers else "string"
    return PhotographTables(
        _image_points(photographs, measured, targets, identifier),
        _photographs(photographs, measured, identifier),
        _rejections(photographs, measured, identifier),
        photographs.left_out,
    )


def families_of(settings: Any, targets: pa.Table | None) -> tuple[str, ...]:
    """The families of codes to look for: as declared, else those of the table image_targets, else the usual ones; none
    beside boards, whose markers are codes, too."""
    declared = settings.photographs.targets
    if declared is not None:
        return tuple(dict.fromkeys(declared))
    if targets is None:
        return () if settings.photographs.boards else USUAL
    named = set(targets.column("family").to_pylist())
    return tuple(family for family in FAMILIES if family in named)


def _measured(pieces: Sequence[Piece], progress: Progress, each: Each | None) -> Iterator[Measured]:
    pixels = sum(piece.photograph.head.width_px * piece.photograph.head.height_px for piece in pieces)
    if each is not None and len(pieces) > 1 and pixels > _WORTH_PROCESSES:
        yield from each(measure, pieces, lambda done: progress(done, len(pieces), "photographs"))
        return
    for done, piece in enumerate(pieces):
        progress(done, len(pieces), str(piece))
        yield measure(piece)


def _poses(photographs: Photographs, identifier: str, counts: Sequence[int]) -> list[Any]:
    own: list[Any] = [one.pose if identifier == "string" else int(one.pose) for one in photographs.found]
    return [pose for pose, count in zip(own, counts, strict=True) for _ in range(count)]


def _image_points(
    photographs: Photographs, measured: Sequence[Measured], targets: pa.Table | None, identifier: str
) -> pa.Table:
    counts = [len(one.names) for one in measured]
    names = np.array([name for one in measured for name in one.names], dtype=object)
    point, body, target = own_names(names, targets)
    cov = np.concatenate([one.cov_px2 for one in measured])
    xy, ellipse = (np.concatenate([getattr(one, name) for one in measured]) for name in ("xy_px", "ellipse"))
    columns = {
        "pose": _poses(photographs, identifier, counts),
        **{name: _repeated(photographs.found, name, counts) for name in ("image", "camera")},
        "point": point,
        "body": body,
        "target": target,
        "kind": [kind for one in measured for kind in one.kinds],
        "x_px": xy[:, 0],
        "y_px": xy[:, 1],
        "cov_xx_px2": cov[:, 0, 0],
        "cov_xy_px2": cov[:, 0, 1],
        "cov_yy_px2": cov[:, 1, 1],
        **dict(zip(("semi_major_px", "semi_minor_px", "axis_angle_rad"), ellipse.T, strict=True)),
        "contrast": np.concatenate([one.contrast for one in measured]),
    }
    return _table("image_points", columns, identifier)


def _repeated(found: Sequence[Photograph], name: str, counts: Sequence[int]) -> list[str]:
    return [getattr(one, name) for one, count in zip(found, counts, strict=True) for _ in range(count)]


def _photographs(photographs: Photographs, measured: Sequence[Measured], identifier: str) -> pa.Table:
    ones = [1] * len(measured)
    heads = [one.head for one in photographs.found]
    columns = {
        "pose": _poses(photographs, identifier, ones),
        **{name: _repeated(photographs.found, name, ones) for name in ("image", "camera")},
        "file": [one.file.name for one in photographs.found],
        **{name: [getattr(head, name) for head in heads] for name in ("width_px", "height_px")},
        **{
            name: [getattr(head, name) for head in heads]
            for name in ("principal_distance_px", "principal_distance_from", "taken_at")
        },
        "grey_bits": [head.bits for head in heads],
        "targets_measured": [len(one.names) for one in measured],
        "image_remark": [_remark(head.turned) for head in heads],
    }
    return _table("photographs", columns, identifier)


def _remark(turned: str) -> str | None:
    return f"its file says that it is {turned}; its pixels are taken as they stand" if turned else None


def _rejections(photographs: Photographs, measured: Sequence[Measured], identifier: str) -> pa.Table:
    rows = [
        (one, kind, reason, count)
        for one, result in zip(photographs.found, measured, strict=True)
        for (kind, reason), count in sorted(result.rejected.items())
    ]
    columns = {
        "pose": [one.pose if identifier == "string" else int(one.pose) for one, *_ in rows],
        "image": [one.image for one, *_ in rows],
        **{name: [row[k] for row in rows] for k, name in ((1, "kind"), (2, "reason"), (3, "rows"))},
    }
    return _table("image_rejections", columns, identifier)


def _table(name: str, columns: Mapping[str, Any], identifier: str) -> pa.Table:
    import pyarrow as pa

    schema = ARTIFACTS[name].arrow_schema(identifier, tuple(columns))
    # Arrow takes NaN for a number; here it means that there is none.
    made = [pa.array(columns[field.name], field.type, from_pandas=True) for field in schema]
    return pa.table(made, schema=pa.schema([field.with_nullable(True) for field in schema]))


def refused_words(rejections: pa.Table) -> str:
    """What was refused in the photographs, most frequent first, in one line; empty where nothing was."""
    total: Counter[str] = Counter()
    for row in rejections.to_pylist():
        total[f"{row['kind']}: {row['reason']}"] += row["rows"]
    return "; ".join(f"{count:,} {reason}" for reason, count in total.most_common(5))


@dataclass(frozen=True)
class TargetPlan:
    """What is looked for in every photograph."""

    rings: tuple[str, ...]
    uncoded: bool
    markers: tuple[str, ...]
    boards: tuple[BoardPlan, ...]
    polarity: str
    smallest_px: float
    largest_px: float


@dataclass(frozen=True)
class Piece:
    """One photograph to measure, and what to look for."""

    photograph: Photograph
    plan: TargetPlan

    def __str__(self) -> str:
        return self.photograph.file.name


@dataclass
class Measured:
    """Image points of one photograph: names (empty: uncoded), kinds, xy_px (N, 2), cov_px2 (N, 2, 2), ellipse (N, 3) of
    circles (semi-axes in px, direction in rad; NaN of others), contrast (N,) over the noise; how many candidates were
    refused, by kind and reason; what is wrong with the file, where it cannot be read."""

    names: list[str] = field(default_factory=list)
    kinds: list[str] = field(default_factory=list)
    xy_px: Array = field(default_factory=lambda: np.empty((0, 2)))
    cov_px2: Array = field(default_factory=lambda: np.empty((0, 2, 2)))
    ellipse: Array = field(default_factory=lambda: np.empty((0, 3)))
    contrast: Array = field(default_factory=lambda: np.empty(0))
    rejected: Counter[tuple[str, str]] = field(default_factory=Counter)
    fault: Unusable | None = None


Each = Callable[[Callable[[Piece], Measured], Sequence[Piece], Callable[[int], None]], Iterator[Measured]]
"""Does a work on every piece, in whatever processes, tells how many are done, and yields results in their order."""


def target_plan(settings: PhotographSettings, families: tuple[str, ...]) -> TargetPlan:
    """What [photographs] asks for, of these families of codes."""
    from truing.estimation.image_targets.boards import BoardPlan

    boards = tuple(
        BoardPlan(b.label, b.kind, b.columns, b.rows, b.family, b.first_code, b.marker_share, b.legacy)
        for b in settings.boards
    )
    return TargetPlan(
        rings=tuple(family for family in families if family in RINGS),
        uncoded=bool(families) or not boards if settings.uncoded is None else settings.uncoded,
        markers=tuple(family for family in families if family in MARKERS),
        boards=boards,
        polarity=settings.polarity,
        smallest_px=settings.smallest_px,
        largest_px=settings.largest_px,
    )


def measure(piece: Piece) -> Measured:
    """The targets of one photograph; a file that cannot be read is a fault in what it leaves, never an exception."""
    import cv2

    from truing.estimation.image_targets.image_noise import estimate_noise

    cv2.setNumThreads(1)  # there is a process for every core
    found = Measured()
    try:
        grey = np.ascontiguousarray(read_grey(piece.photograph.file.path, piece.photograph.head))
    except Unusable as error:
        found.fault = error
        return found
    plan, noise = piece.plan, estimate_noise(grey)
    if plan.rings or plan.uncoded:
        from truing.estimation.image_targets.circles import CirclePlan, measure_circles
        from truing.estimation.image_targets.ring_codes import family_of_rings

        codes = tuple(map(family_of_rings, plan.rings))
        wanted = CirclePlan(codes, plan.uncoded, plan.polarity, plan.smallest_px, plan.largest_px)  # type: ignore[arg-type]
        _add_circles(found, measure_circles(grey, wanted, noise))
    if plan.markers:
        from truing.estimation.image_targets.square_markers import measure_markers

        _add_markers(found, measure_markers(grey, plan.markers, noise), plan.markers, noise)
    for board in plan.boards:
        from truing.estimation.image_targets.boards import measure_board

        _add_board(found, measure_board(grey, board, noise), board, noise)
    _drop_repeated(found)
    return found


def _add(found: Measured, names: list[str], kinds: list[str], xy: Array, cov: Array, contrast: Array) -> None:
    found.names += names
    found.kinds += kinds
    found.xy_px = np.concatenate([found.xy_px, xy])
    found.cov_px2 = np.concatenate([found.cov_px2, cov])
    found.contrast = np.concatenate([found.contrast, contrast])
    none = np.full((len(found.xy_px) - len(found.ellipse), 3), np.nan)
    found.ellipse = np.concatenate([found.ellipse, none])


def _add_circles(found: Measured, seen: ImageTargets) -> None:
    contrast = _over_noise(seen.contrast, seen.noise)
    _add(found, seen.names, seen.kinds, seen.centre_px, seen.cov_px2, contrast)
    found.ellipse[len(found.ellipse) - seen.count :] = np.column_stack([seen.semi_axes_px, seen.axis_angle_rad])
    for reason, count in seen.rejected.items():
        found.rejected[("circle", reason)] += count


def _add_markers(found: Measured, seen: MarkerCorners, families: tuple[str, ...], noise: ImageNoise) -> None:
    triples = zip(seen.family.tolist(), seen.code.tolist(), seen.corner.tolist(), strict=True)
    names = [f"{families[family]}-{code}.{corner}" for family, code, corner in triples]
    kinds = [_marker_kind(families[family]) for family in seen.family.tolist()]
    _add(found, names, kinds, seen.xy_px, seen.cov_px2, _over_noise(seen.contrast, noise))
    for (family, reason), count in seen.rejected.items():
        found.rejected[(_marker_kind(families[family]), reason)] += count


def _marker_kind(family: str) -> str:
    return "apriltag" if family.startswith("apriltag") else "aruco"


def _add_board(found: Measured, seen: BoardCorners, board: BoardPlan, noise: ImageNoise) -> None:
    names = [f"{board.name}-{number}" for number in seen.number.tolist()]
    _add(found, names, [board.kind] * len(names), seen.xy_px, seen.cov_px2, _over_noise(seen.contrast, noise))
    for reason, count in seen.rejected.items():
        found.rejected[(board.kind, reason)] += count


def _over_noise(contrast: Array, noise: ImageNoise) -> Array:
    return contrast / np.sqrt(np.maximum(noise.variance(0.5 * contrast), 1e-12))


def _drop_repeated(found: Measured) -> None:
    """A name that stands twice in one image tells of neither which it is."""
    counts = Counter(name for name in found.names if name)
    keep = np.array([counts[name] < 2 for name in found.names], dtype=bool)
    if keep.all():
        return
    for row in np.flatnonzero(~keep):
        found.rejected[(found.kinds[row], "code seen twice in one image")] += 1
    found.names = [name for name, kept in zip(found.names, keep, strict=True) if kept]
    found.kinds = [kind for kind, kept in zip(found.kinds, keep, strict=True) if kept]
    found.xy_px, found.cov_px2 = found.xy_px[keep], found.cov_px2[keep]
    found.ellipse, found.contrast = found.ellipse[keep], found.contrast[keep]
