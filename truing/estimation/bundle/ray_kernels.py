"""Compiled kernels of large poses: elimination of points ray by ray, and covariances of points from those of images.

Entries (n) are small blocks (3, 6) of a point by the six unknowns of an image. These begin at an offset among the kept
unknowns. The entries of point p are those from start[p] to stop[p]. Own code because sparse libraries order and fill in
general patterns; here the pattern is known, and the reduced system of the images is small and dense.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.compiled_code import compiled, inner
from truing.estimation import simd_arithmetic
from truing.estimation.bundle import kernel_arguments, kernels
from truing.estimation.bundle.kernel_arguments import (
    CameraArrays,
    EntryArrays,
    PoseCovarianceArrays,
    PoseRays,
    RayBlocks,
    StateArrays,
)
from truing.estimation.bundle.kernels import (
    INTERIOR,
    WIDTH,
    direct,
    invert_lower,
    linearised,
    lower_root,
    lower_times,
    turned,
)

_SOURCES = (simd_arithmetic.__file__, kernel_arguments.__file__, kernels.__file__, __file__)


@compiled(*_SOURCES)
def forward_rays(
    diagonal: NDArray,
    rays: RayBlocks,
    sides: NDArray,
    damping: float,
    root: NDArray,
    reduced: NDArray,
    reduced_sides: NDArray,
) -> bool:
    """Fill in the inverse Cholesky factors (b, 3, 3) of damped blocks of points; their products with the rays' blocks
    (n, 3, 6) and with the sides (3 b, .).

    Returns whether all blocks are positive definite.
    """
    lower = np.zeros((3, 3))
    for n in range(len(diagonal)):
        if not lower_root(diagonal[n], damping, lower):
            return False
        invert_lower(lower, root[n])
        at = slice(3 * n, 3 * n + 3)
        lower_times(root[n], sides[at], reduced_sides[at])
        for r in range(rays.first[n], rays.first[n + 1]):
            block = rays.blocks[rays.ray[r]]
            for a in range(3):
                for b in range(6):
                    value = 0.0
                    for j in range(a + 1):
                        value += root[n, a, j] * block[b, j]
                    reduced[r, a, b] = value
    return True


@compiled(*_SOURCES)
def subtract_products(entries: EntryArrays, chosen: NDArray, total: NDArray) -> None:
    """Subtract the products of the entries of each chosen point from the upper blocks of a matrix (k, k)."""
    for p in chosen:
        for r in range(entries.start[p], entries.stop[p]):
            for s in range(entries.start[p], entries.stop[p]):
                if entries.offset[s] >= entries.offset[r]:
                    first, second = entries.blocks[r], entries.blocks[s]
                    for a in range(6):
                        x, y, z = first[0, a], first[1, a], first[2, a]
                        row = total[entries.offset[r] + a, entries.offset[s] : entries.offset[s] + 6]
                        for b in range(6):
                            row[b] -= x * second[0, b] + y * second[1, b] + z * second[2, b]


@compiled(*_SOURCES)
def times_kept(entries: EntryArrays, values: NDArray, product: NDArray) -> None:
    """Add the products of the entries with values (k, w) of the kept unknowns to those of the points (p, 3, w)."""
    for p in range(len(entries.start)):
        for r in range(entries.start[p], entries.stop[p]):
            for a in range(3):
                row = product[p, a]
                for j in range(6):
                    f, source = entries.blocks[r, a, j], values[entries.offset[r] + j]
                    for b in range(len(row)):
                        row[b] += f * source[b]


@compiled(*_SOURCES)
def times_points(entries: EntryArrays, values: NDArray, product: NDArray) -> None:
    """Add the products of the transposed entries with values (p, 3, w) of the points to those of the kept (k, w)."""
    for p in range(len(entries.start)):
        for r in range(entries.start[p], entries.stop[p]):
            for j in range(6):
                row = product[entries.offset[r] + j]
                for a in range(3):
                    f, source = entries.blocks[r, a, j], values[p, a]
                    for b in range(len(row)):
                        row[b] += f * source[b]


@compiled(*_SOURCES)
def spread_entries(entries: EntryArrays, chosen: NDArray, rows: NDArray) -> None:
    """Add the entries of chosen points to dense rows (3 n, k)."""
    for n, p in enumerate(chosen):
        for r in range(entries.start[p], entries.stop[p]):
            for a in range(3):
                for j in range(6):
                    rows[3 * n + a, entries.offset[r] + j] += entries.blocks[r, a, j]


@inner
def add_times(total: NDArray, block: NDArray, kept: NDArray, row: int, column: int) -> None:
    """Add block (3, 6) times the block of a matrix at row and column to a total (3, 6)."""
    for a in range(3):
        for j in range(6):
            f, source = block[a, j], kept[row + j, column : column + 6]
            for b in range(6):
                total[a, b] += f * source[b]


@compiled(*_SOURCES)
def point_covariances(entries: EntryArrays, chosen: NDArray, kept: NDArray, covariance: NDArray) -> None:
    """Add the covariance that each chosen point has from the kept unknowns, with covariance (k, k), to (p, 3, 3)."""
    total = np.zeros((3, 6))
    for p in chosen:
        for s in range(entries.start[p], entries.stop[p]):
            total[:] = 0.0
            for r in range(entries.start[p], entries.stop[p]):
                add_times(total, entries.blocks[r], kept, entries.offset[r], entries.offset[s])
            for a in range(3):
                for b in range(3):
                    value = 0.0
                    for j in range(6):
                        value += total[a, j] * entries.blocks[s, b, j]
                    covariance[p, a, b] += value


@compiled(*_SOURCES)
def image_covariances(
    entries: EntryArrays,
    point: NDArray,
    image: NDArray,
    chosen: NDArray,
    kept: NDArray,
    covariance: NDArray,
) -> None:
    """Fill in the covariance (m, 6, 3) of each chosen pair of an image and a point, from that of the kept unknowns."""
    total = np.zeros((3, 6))
    for m in chosen:
        total[:] = 0.0
        p = point[m]
        for r in range(entries.start[p], entries.stop[p]):
            add_times(total, entries.blocks[r], kept, entries.offset[r], 6 * image[m])
        for a in range(3):
            for b in range(6):
                covariance[m, b, a] = total[a, b]


@inner
def by_pose_unknowns(row: NDArray, derivative: NDArray) -> None:
    """Fill in the derivatives (2, 9) of image coordinates by centre and rotation of the image and by the point, from a
    linearised row."""
    for q in range(2):
        for a in range(3):
            derivative[q, a], derivative[q, 3 + a], derivative[q, 6 + a] = -row[q, a], row[q, 3 + a], row[q, a]


@inner
def joined(image: NDArray, point: NDArray, cross: NDArray, both: NDArray) -> None:
    """Fill in the covariance (9, 9) of an image (6, 6) and a point (3, 3) with their cross covariance (6, 3)."""
    # By loops: the assignment of an array to a part of another takes 20 s to compile.
    for a in range(6):
        for b in range(6):
            both[a, b] = image[a, b]
        for b in range(3):
            both[a, 6 + b] = both[6 + b, a] = cross[a, b]
    for a in range(3):
        for b in range(3):
            both[6 + a, 6 + b] = point[a, b]


@inner
def by_common_unknowns(
    row: NDArray, slot: NDArray, derivative: NDArray, image: NDArray, point: NDArray, by_common: NDArray
) -> None:
    """Fill in the derivatives (2, c) by the common unknowns: of the camera at its ``slot`` (10,), and through image
    (6, c) and point (3, c)."""
    by_common[:] = 0.0
    for q in range(2):
        for a in range(10):
            if slot[a] >= 0:
                by_common[q, slot[a]] += row[q, INTERIOR + a]
        for a in range(9):
            moved = image[a] if a < 6 else point[a - 6]
            for b in range(by_common.shape[1]):
                by_common[q, b] += derivative[q, a] * moved[b]


@inner
def add_propagated(derivative: NDArray, covariance: NDArray, half: NDArray, total: NDArray) -> None:
    """Add J C J^T (2, 2) of a derivative J (2, n) and a covariance C (n, n); half (n,) is work space."""
    for q in range(2):
        half[:] = 0.0
        for a in range(len(half)):
            for b in range(len(half)):
                half[b] += derivative[q, a] * covariance[a, b]
        for r in range(2):
            for b in range(len(half)):
                total[q, r] += half[b] * derivative[r, b]


@compiled(*_SOURCES)
def computed_covariances(
    rays: PoseRays,
    cameras: CameraArrays,
    state: StateArrays,
    interior_slot: NDArray,
    known: PoseCovarianceArrays,
    covariance: NDArray,
) -> None:
    """Fill in the covariance (n, 2, 2) of computed image points of one pose; NaN for a point that is not in front of
    its camera.

    Cameras and state are those of the whole network; interior_slot (C, 10): interior elements among the common
    unknowns; known: covariances of the pose.
    """
    c = len(known.common)
    derivative, both, by_common, spread = np.zeros((2, 9)), np.zeros((9, 9)), np.zeros((2, c)), np.zeros(c)
    half, row, X = np.zeros(9), np.zeros((2, WIDTH)), np.zeros(3)
    for n in range(len(rays.image)):
        image, i, p = rays.image[n], rays.image_slot[n], rays.point_slot[n]
        R, centre, point, k = state.R[image], state.centre[image], state.points[rays.point[n]], cameras.of_image[image]
        direct(X, R, point, centre)
        if not X[2] > 0.0:
            covariance[n] = np.nan
            continue
        linearised(row, cameras.interior[k], cameras.radius[k], X, (1.0, 0.0, 1.0))
        turned(row, R, point, centre)
        by_pose_unknowns(row, derivative)
        joined(known.images[i], known.points[p], known.cross[n], both)
        image_by_common, point_by_common = known.images_by_common[i], known.points_by_common[p]
        by_common_unknowns(row, interior_slot[k], derivative, image_by_common, point_by_common, by_common)
        covariance[n] = 0.0
        add_propagated(derivative, both, half, covariance[n])
        add_propagated(by_common, known.common, spread, covariance[n])
