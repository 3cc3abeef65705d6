"""Distances of the survey, or sizes of markers and boards, as scale if no scale bar gives one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import Array
from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import COORDINATE_SIGMAS, TARGETS
from truing.formats.row_collection import collect_rows
from truing.formats.source import CampaignFiles
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.photograph_artifacts import FROM_MARKER, FROM_SURVEY
from truing.stages.bundle_adjustment.rays_as_network import stated_sizes
from truing.stages.common.point_arrays import number_column

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.photographs import Board

# Relative uncertainty of a marker's edge without declared noise: that of printers.
PRINTED_TO = 1e-3


def with_scale(tables: Mapping[str, pa.Table], settings: Campaign, source: CampaignFiles) -> Mapping[str, pa.Table]:
    """Tables with further scale bars for poses without a complete bar, unless known points are their datum: distances
    between surveyed targets, else diagonals of markers and boards of known size.

    The tables are unchanged if there are neither.
    """
    bars, rays = tables.get("scale_bars"), tables["image_points"]
    seen = _visible_in_poses(rays)
    lacking = [pose for pose in seen if pose not in _with_bar(bars, seen)]
    has_datum = settings.photographs.datum == "known" and "known_points" in tables
    if has_datum or not lacking:
        return tables
    every, noise_mm = frozenset().union(*seen.values()), settings.noise.point_mm
    surveyed = _surveyed(settings, surveyed_points(source, every, settings))
    surveyed = surveyed or [
        *_markers(tables.get("image_targets"), every, settings.photographs.marker_mm, noise_mm),
        *(bar for board in settings.photographs.boards for bar in _board(board, list(seen.values()), noise_mm)),
    ]
    if not surveyed:
        return tables
    if len(lacking) < len(seen):
        surveyed = [{"pose": pose, **row} for pose in lacking for row in surveyed]
    schema = ARTIFACTS["scale_bars"].arrow_schema(str(rays.schema.field("pose").type), tuple(surveyed[0]))
    own_table = pa.Table.from_pylist(surveyed, schema=schema)
    return {
        **tables,
        "scale_bars": own_table if bars is None else pa.concat_tables([bars, own_table], promote_options="default"),
    }


def unobserved_bars(bars: pa.Table | None, rays: pa.Table) -> list[str]:
    """Message for each scale bar whose ends no pose shows together."""
    if bars is None:
        return []
    seen = _visible_in_poses(rays)
    every = frozenset().union(*seen.values())
    text = {}
    for row in bars.to_pylist():
        ends = {row["first"], row["second"]}
        if not any(ends <= points for points in seen.values()):
            lost = ", ".join(sorted(ends - every))
            reason = f"no image shows {lost}" if lost else "no pose shows both ends"
            text[row["bar"]] = f"scale bar {row['bar']}: {reason}"
    return list(text.values())


def _visible_in_poses(rays: pa.Table) -> dict[object, frozenset[str]]:
    seen: dict[object, set[str]] = {}
    for pose, point in zip(rays.column("pose").to_pylist(), rays.column("point").to_pylist(), strict=True):
        seen.setdefault(pose, set()).add(point)
    return {pose: frozenset(points - {""}) for pose, points in seen.items()}


def _with_bar(bars: pa.Table | None, seen: Mapping[object, frozenset[str]]) -> set[object]:
    """Poses with both ends of a bar that gives the scale."""
    rows = [] if bars is None else [row for row in bars.to_pylist() if row["serves"] == "scale"]
    return {
        pose
        for pose, points in seen.items()
        for row in rows
        if row.get("pose") in (None, pose) and {row["first"], row["second"]} <= points
    }


def _markers(
    targets: pa.Table | None, seen: frozenset[str], marker_mm: float | None, noise_mm: float | None
) -> list[dict[str, object]]:
    """Rows of scale_bars: both diagonals of every square marker of known size with all corners measured.

    Their error is common to all poses, also without a declared uncertainty, because each pose would otherwise keep the
    scale of its start values.
    """
    sizes = stated_sizes(targets, "size_mm")
    markers: list[dict[str, object]] = []
    for stem in sorted({point.rpartition(".")[0] for point in seen} - {""}):
        size = sizes.get(stem) or (marker_mm if stem.startswith(("aruco", "apriltag")) or "/" in stem else None)
        if size and {f"{stem}.{corner}" for corner in range(4)} <= seen:
            markers += [
                _bar(
                    f"{FROM_MARKER}{stem}.{a} to {stem}.{b}",
                    (f"{stem}.{a}", f"{stem}.{b}"),
                    2**0.5 * size,
                    2**0.5 * (noise_mm or PRINTED_TO * size),
                )
                for a, b in ((0, 2), (1, 3))
            ]
    return markers


def _board(board: Board, seen: Sequence[frozenset[str]], noise_mm: float | None) -> list[dict[str, object]]:
    """Rows of scale_bars: two longest diagonals of a board of known squares, between corners in all poses with the
    board; seen: points of each pose."""
    points_of_pose = [points for points in seen if any(name.startswith(f"{board.label}-") for name in points)]
    if board.square_mm is None or not points_of_pose:
        return []
    for inset in range(min(board.columns, board.rows) // 2):
        left, right, top, bottom = inset, board.columns - 1 - inset, inset, board.rows - 1 - inset
        ends = ((left, top), (right, bottom)), ((right, top), (left, bottom))
        names = [tuple(f"{board.label}-{y * board.columns + x}" for x, y in pair) for pair in ends]
        if all(set(names[0]) | set(names[1]) <= points for points in points_of_pose):
            length = board.square_mm * float(np.hypot(right - left, bottom - top))
            sigma = 2**0.5 * noise_mm if noise_mm else PRINTED_TO * length
            return [_bar(f"{FROM_MARKER}{a} to {b}", (a, b), length, sigma) for a, b in names]
    return []


def _surveyed(settings: Campaign, survey: SurveyedPoints | None) -> list[dict[str, object]]:
    """Rows of scale_bars: longest distances of the reference body (of every body without one) that share no end, so
    that their errors are independent. The shape of a mechanism's base is trusted."""
    if survey is None:
        return []
    reference = settings.bodies.reference or ("base" if settings.mechanism.type != "none" else None)
    known, rows = np.isfinite(survey.variance_mm2).all(1), []
    for body in dict.fromkeys(survey.bodies[known]) if reference is None else (reference,):
        indices = np.flatnonzero(known & (survey.bodies == body))
        name, xyz, variance = survey.names[indices], survey.xyz_mm[indices], survey.variance_mm2[indices]
        for first, second in _distant_pairs(xyz):
            difference = xyz[second] - xyz[first]
            length = float(np.linalg.norm(difference))
            sigma = float(np.sqrt((variance[first] + variance[second]) @ (difference / length) ** 2))
            bar = f"{FROM_SURVEY}{name[first]} to {name[second]}"
            rows.append(_bar(bar, (name[first], name[second]), length, sigma))
    return rows


@dataclass(frozen=True)
class SurveyedPoints:
    """Surveyed targets with rays: ray names (N,), bodies (N,), positions xyz_mm (N, 3) in the body's frame, and
    variances (N, 3) in mm^2, NaN if not stated."""

    names: NDArray[np.object_]
    bodies: NDArray[np.object_]
    xyz_mm: Array
    variance_mm2: Array


def surveyed_points(source: CampaignFiles, seen: frozenset[str], settings: Any) -> SurveyedPoints | None:
    """Survey of targets with rays; None if there is none."""
    if not settings.files.targets and not source.entries("targets"):
        return None
    rows = collect_rows(source, TARGETS, FaultLog())  # faults of the survey are reported when it is read for the poses
    if rows is None or any(name not in rows.table.column_names for name in TARGETS.required):
        return None
    body, target = (np.array(rows.table.column(name).to_pylist(), dtype=object) for name in ("body", "target"))
    xyz = np.column_stack([number_column(rows.table, f"{axis}_mm") for axis in "xyz"])
    variance = np.column_stack([_variance(rows.table, name, settings.noise.point_mm) for name in COORDINATE_SIGMAS])
    name = np.array([_name(*both, seen) for both in zip(body, target, strict=True)], dtype=object)
    known = (name != "") & np.isfinite(xyz).all(1)
    return SurveyedPoints(name[known], body[known], xyz[known], variance[known])


def _variance(table: pa.Table, name: str, declared: float | None) -> Array:
    sigma_mm = number_column(table, name) if name in table.column_names else np.full(len(table), np.nan)
    variance: Array = np.where(np.isnan(sigma_mm), np.nan if declared is None else declared, sigma_mm) ** 2
    return np.where(variance > 0.0, variance, np.nan)


def _name(body: str, target: str, seen: frozenset[str]) -> str:
    """Ray name of a surveyed target: with its body, or by the code alone."""
    return next((name for name in (f"{body}/{target}", target) if name in seen), "")


def _distant_pairs(xyz: Array) -> list[tuple[int, int]]:
    """Pairs of points (N, 3), the most distant first, each point in at most one pair."""
    first, second = np.triu_indices(len(xyz), 1)
    order = np.argsort(-np.linalg.norm(xyz[first] - xyz[second], axis=1), kind="stable")
    pairs: list[tuple[int, int]] = []
    used_points: set[int] = set()
    for a, b in zip(first[order].tolist(), second[order].tolist(), strict=True):
        if not used_points & {a, b}:
            pairs.append((a, b))
            used_points |= {a, b}
    return pairs


def _bar(bar: str, ends: tuple[str, str], length_mm: float, sigma_mm: float) -> dict[str, object]:
    reported = {"bar": bar, "first": ends[0], "second": ends[1], "length_mm": length_mm, "sigma_mm": sigma_mm}
    return {**reported, "repeat_sigma_mm": 0.0, "serves": "scale"}
