"""One photograph: opened, its targets of all kinds measured, what was refused counted; in a process of its own."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.formats.image_files import read_grey
from truing.formats.photographs import Photograph
from truing.formats.raw import Unusable
from truing.schemas.photographs import MARKERS, RINGS

if TYPE_CHECKING:
    from truing.estimation.image_targets.boards import BoardCorners, BoardPlan
    from truing.estimation.image_targets.circles import ImageTargets
    from truing.estimation.image_targets.image_noise import ImageNoise
    from truing.estimation.image_targets.square_markers import MarkerCorners
    from truing.schemas.photographs import Photographs as PhotographSettings

Array = NDArray[np.float64]


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
