"""Rows of the eliminated unknowns by the kept ones: one dense array, or the blocks of rays of a large pose."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dsyrk

from truing.arrays import Array, Index
from truing.estimation.bundle.kernel_arguments import EntryArrays, RayBlocks
from truing.estimation.bundle.row_blocks import PointRays

# Share of a pose's images that see a point, from which its products are faster as dense rows.
_DENSE_SHARE = 0.25
_BATCH = 4_000_000  # numbers of a batch of dense rows
_NOT_DEFINITE = "found a block that is not positive definite"


def add_products(total: Array, rows: Array, factor: float) -> None:
    """Add the products (w, w) of rows (r, w), times a factor, to the upper triangle."""
    if len(rows):
        dsyrk(factor, rows.T, 1.0, total.T, lower=1, overwrite_c=1)


@dataclass(frozen=True)
class DenseRows:
    """Rows (b d, k) of the eliminated unknowns by the kept ones."""

    array: Array

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the reduced rows."""
        return self.array.shape

    def eliminate(
        self, diagonal: Array, sides: Array, damping: float, reduced: Array
    ) -> tuple[Array, ReducedDense, Array]:
        """Return the inverse Cholesky factors (b, d, d) of damped blocks, and their products with rows and sides (b d,
        .); overwrites reduced. Raises LinAlgError if a block is not positive definite."""
        from truing.estimation.bundle.kernels import forward

        root, reduced_sides = np.empty_like(diagonal), np.empty_like(sides)
        if not forward(diagonal, self.array, sides, damping, root, reduced, reduced_sides):
            raise np.linalg.LinAlgError(_NOT_DEFINITE)
        return root, ReducedDense(reduced), reduced_sides


@dataclass(frozen=True)
class ReducedDense:
    """Reduced rows (b d, k) as one array."""

    array: Array

    def subtract_products(self, kept: Array) -> None:
        """Subtract the products of the rows from the upper triangle of the kept system (k, k)."""
        add_products(kept, self.array, -1.0)

    def transposed_times(self, values: Array) -> Array:
        """Return the products (k, w) of the transposed rows with values (b d, w)."""
        return np.asarray(self.array.T @ values)

    def times(self, values: Array) -> Array:
        """Return the products (b d, w) of the rows with values (k, w)."""
        return np.asarray(self.array @ values)


@dataclass(frozen=True)
class RayRows:
    """Blocks (., 6, 3) of the rays of a pose, and the rays of its points."""

    blocks: Array
    rays: PointRays

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the reduced rows."""
        return (len(self.rays.rays), 3, 6)

    def eliminate(
        self, diagonal: Array, sides: Array, damping: float, reduced: Array
    ) -> tuple[Array, ReducedRays, Array]:
        """Return the same as `DenseRows.eliminate`, with reduced (n, 3, 6)."""
        from truing.estimation.bundle.ray_kernels import forward_rays

        rays, root, reduced_sides = self.rays, np.empty_like(diagonal), np.empty_like(sides)
        ray_blocks = RayBlocks(self.blocks, rays.rays, rays.first)
        if not forward_rays(diagonal, ray_blocks, sides, damping, root, reduced, reduced_sides):
            raise np.linalg.LinAlgError(_NOT_DEFINITE)
        entries = Entries(reduced, rays.image_place, rays.first[:-1], rays.first[1:], rays.kept)
        return root, ReducedRays(entries, rays.images), reduced_sides


@dataclass(frozen=True)
class Entries:
    """Small blocks (n, 3, 6) of points by kept unknowns, which begin at offsets (n,); those of each point (p,) from
    start to stop; number of kept unknowns k."""

    blocks: Array
    offset: Index
    start: Index
    stop: Index
    kept: int

    @property
    def arrays(self) -> EntryArrays:
        """Argument of the compiled kernels."""
        return EntryArrays(self.blocks, self.offset, self.start, self.stop)

    def times(self, values: Array) -> Array:
        """Return the products (p, 3, w) with values (k, w) of the kept unknowns."""
        from truing.estimation.bundle.ray_kernels import times_kept

        result = np.zeros((len(self.start), 3, values.shape[1]))
        times_kept(self.arrays, np.ascontiguousarray(values), result)
        return result

    def transposed_times(self, values: Array) -> Array:
        """Return the products (k, w) of the transposed blocks with values (p, 3, w) of the points."""
        from truing.estimation.bundle.ray_kernels import times_points

        result = np.zeros((self.kept, values.shape[-1]))
        times_points(self.arrays, np.ascontiguousarray(values), result)
        return result

    def dense(self, points: Index) -> Array:
        """Return the dense rows (3 n, k) of points (n,)."""
        from truing.estimation.bundle.ray_kernels import spread_entries

        rows = np.zeros((3 * len(points), self.kept))
        spread_entries(self.arrays, points, rows)
        return rows

    def narrow_and_wide(self, images: int) -> tuple[Index, Index]:
        """Return the points that few of the images see, and those that many see."""
        is_wide = self.stop - self.start > _DENSE_SHARE * images
        return np.flatnonzero(~is_wide), np.flatnonzero(is_wide)

    def batches(self, points: Index) -> Iterator[Index]:
        """Yield points (n,) in batches whose dense rows fit into the caches' neighbourhood."""
        size = max(1, _BATCH // (3 * self.kept))
        for first in range(0, len(points), size):
            yield points[first : first + size]


@dataclass(frozen=True)
class ReducedRays:
    """Reduced blocks of the rays of a pose with a number of images."""

    entries: Entries
    images: int

    def subtract_products(self, kept: Array) -> None:
        """Subtract the products of the rows from the upper triangle of the kept system (k, k)."""
        from truing.estimation.bundle.ray_kernels import subtract_products

        narrow, wide = self.entries.narrow_and_wide(self.images)
        subtract_products(self.entries.arrays, narrow, kept)
        for points in self.entries.batches(wide):
            add_products(kept, self.entries.dense(points), -1.0)

    def transposed_times(self, values: Array) -> Array:
        """Return the products (k, w) of the transposed rows with values (3 b, w)."""
        return self.entries.transposed_times(values.reshape(len(self.entries.start), 3, values.shape[1]))

    def times(self, values: Array) -> Array:
        """Return the products (3 b, w), or (3 b,), of the rows with values (k, w) or (k,)."""
        width = values.shape[1] if values.ndim > 1 else 1
        times = self.entries.times(values.reshape(self.entries.kept, width))
        return times.reshape(3 * len(times), *values.shape[1:])
