"""All targets of one photograph, of all requested kinds: names, image points with covariance, rejections."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array
from truing.estimation.image_targets.boards import BoardPlan, measure_board
from truing.estimation.image_targets.circles import CirclePlan, measure_circles
from truing.estimation.image_targets.image_noise import ImageNoise, estimate_noise
from truing.estimation.image_targets.ring_codes import family_of_rings
from truing.estimation.image_targets.square_markers import measure_markers


@dataclass(frozen=True)
class TargetPlan:
    """Requested targets: families of ring codes, circles without a code, families of markers, boards; circles lighter
    than their ground (white), darker or both, least semi-minor and largest semi-major axis in px."""

    rings: tuple[str, ...]
    uncoded: bool
    markers: tuple[str, ...]
    boards: tuple[BoardPlan, ...]
    polarity: Literal["white", "black", "both"]
    smallest_px: float
    largest_px: float


@dataclass(frozen=True)
class PhotographTargets:
    """Image points: names (N,) (empty: uncoded), kinds (N,), xy_px (N, 2), cov_px2 (N, 2, 2), ellipse (N, 3) of circles
    (semi-axes in px, direction in rad; NaN of others), contrast (N,) over the noise; and counts of rejected candidates
    by kind and reason."""

    names: NDArray[np.object_]
    kinds: NDArray[np.object_]
    xy_px: Array
    cov_px2: Array
    ellipse: Array
    contrast: Array
    rejected: Counter[tuple[str, str]]


def measure_targets(grey: NDArray, plan: TargetPlan) -> PhotographTargets:
    """Return all targets of a grey image (h, w) of 8 or 16 bits.

    If a name occurs twice, both targets are rejected, since either may be wrong.
    """
    noise = estimate_noise(grey)
    parts = [_part([], [], np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0))]
    if plan.rings or plan.uncoded:
        parts.append(_circles(grey, plan, noise))
    if plan.markers:
        parts.append(_markers(grey, plan.markers, noise))
    parts += [_board(grey, board, noise) for board in plan.boards]
    rejected = sum((part.rejected for part in parts), Counter())
    names, kinds, xy, cov, ellipse, contrast = (
        np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(PhotographTargets)[:-1]
    )
    times = Counter(names.tolist())
    once = np.array([not name or times[name] < 2 for name in names], dtype=bool)
    rejected.update((kind, "code seen twice in one image") for kind in kinds[~once])
    return PhotographTargets(names[once], kinds[once], xy[once], cov[once], ellipse[once], contrast[once], rejected)


def _part(
    names: list[str],
    kinds: list[str],
    xy: Array,
    cov: Array,
    contrast: Array,
    ellipse: Array | None = None,
) -> PhotographTargets:
    """Return image points of one kind, without ellipses if none are given; contrast (N,) over its noise."""
    ellipse = np.full((len(xy), 3), np.nan) if ellipse is None else ellipse
    words = np.array(names, dtype=object), np.array(kinds, dtype=object)
    return PhotographTargets(*words, xy, cov, ellipse, contrast, Counter())


def _over_noise(contrast: Array, noise: ImageNoise) -> Array:
    """Return contrasts (N,) in grey levels over the noise of an image."""
    return contrast / np.sqrt(np.maximum(noise.variance(0.5 * contrast), 1e-12))


def _circles(grey: NDArray, plan: TargetPlan, noise: ImageNoise) -> PhotographTargets:
    codes = tuple(map(family_of_rings, plan.rings))
    wanted = CirclePlan(codes, plan.uncoded, plan.polarity, plan.smallest_px, plan.largest_px)
    seen = measure_circles(grey, wanted, noise)
    ellipse = np.column_stack([seen.semi_axes_px, seen.axis_angle_rad])
    part = _part(seen.names, seen.kinds, seen.centre_px, seen.cov_px2, _over_noise(seen.contrast, noise), ellipse)
    part.rejected.update({("circle", reason): count for reason, count in seen.rejected.items()})
    return part


def _markers(grey: NDArray, families: tuple[str, ...], noise: ImageNoise) -> PhotographTargets:
    seen = measure_markers(grey, families, noise)
    kind = ["apriltag" if family.startswith("apriltag") else "aruco" for family in families]
    numbers = zip(seen.family.tolist(), seen.code.tolist(), seen.corner.tolist(), strict=True)
    names = [f"{families[family]}-{code}.{corner}" for family, code, corner in numbers]
    part = _part(names, [kind[k] for k in seen.family], seen.xy_px, seen.cov_px2, _over_noise(seen.contrast, noise))
    for (family, reason), count in seen.rejected.items():
        part.rejected[kind[family], reason] += count
    return part


def _board(grey: NDArray, board: BoardPlan, noise: ImageNoise) -> PhotographTargets:
    seen = measure_board(grey, board, noise)
    names = [f"{board.name}-{number}" for number in seen.number.tolist()]
    part = _part(names, [board.kind] * len(names), seen.xy_px, seen.cov_px2, _over_noise(seen.contrast, noise))
    part.rejected.update({(board.kind, reason): count for reason, count in seen.rejected.items()})
    return part
