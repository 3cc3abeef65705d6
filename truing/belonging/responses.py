"""Responses of recorded columns to the loads of each run, by which slips of whole runs are detected."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index, Mask

_FEWEST = 4  # fewest rows of a run for a response
_INDEPENDENT = 0.05  # least size of an independent direction of loading, relative to the largest
_GROSS = 6.0  # scatters beyond which a row is left out
_MEDIAN = 1.4826
_MOST_OUT = 0.2  # largest share of a run's rows that is left out
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Responses:
    """C responses: the change of a column at the largest load of a run, along one direction of its loads.

    ``run``, ``column`` (C,); ``direction`` (C, 6) that largest load, N and N m; ``size`` (C,) the response to it, in
    the unit of the columns; ``sigma`` its standard deviation by the scatter in the run.
    """

    run: Index
    column: Index
    direction: Array
    size: Array
    sigma: Array

    def __len__(self) -> int:
        return len(self.run)

    def subset(self, rows: Mask) -> Responses:
        """Return some of the responses."""
        return Responses(self.run[rows], self.column[rows], self.direction[rows], self.size[rows], self.sigma[rows])


_Cell = tuple[int, int, Array, float, float]


def responses(load: Array, run: Index, value: Array, *, has_zero: bool = True) -> Responses:
    """Return the responses of columns (N, K) to loads (N, 6) in each run (N,); NaN where nothing was recorded.

    has_zero: every run has a zero of its own; otherwise there is none, and all runs are treated as one.
    """
    groups = [np.flatnonzero(run == number) for number in np.unique(run)] if has_zero else [np.arange(len(run))]
    cells = [cell for rows in groups for cell in _fit_cells(int(run[rows[0]]), load[rows], value[rows], has_zero)]
    return Responses(
        np.array([cell[0] for cell in cells], np.int64),
        np.array([cell[1] for cell in cells], np.int64),
        np.array([cell[2] for cell in cells], float).reshape(-1, 6),
        np.array([cell[3] for cell in cells], float),
        np.array([cell[4] for cell in cells], float),
    )


def _fit_cells(run: int, load: Array, value: Array, has_zero: bool) -> Iterator[_Cell]:
    """Return the responses of each column over rows that share a zero, if there are any."""
    is_observed = np.isfinite(value)
    kinds, kind = np.unique(is_observed, axis=1, return_inverse=True)
    for number, rows in enumerate(kinds.T):
        columns = np.flatnonzero(kind.ravel() == number)
        if rows.sum() >= _FEWEST:
            direction, load_coordinates = directions(load[rows], has_zero)
            if len(direction) and rows.sum() >= len(direction) + 3:
                size, sigma = _fitted(load_coordinates, value[rows][:, columns], has_zero)
                for at, column in enumerate(columns.tolist()):
                    for axis in range(len(direction)):
                        yield run, column, direction[axis], float(size[axis, at]), float(sigma[axis, at])


def directions(load: Array, has_zero: bool = True) -> tuple[Array, Array]:
    """Return the independent directions (D, 6) of loads (N, 6), and the part (N, D) of every load along each, at most
    1.

    These are axes where the loaded axes are independent, otherwise principal directions of the loads relative to the
    largest.
    """
    about = load - load.mean(axis=0) if has_zero else load
    largest = np.abs(about).max(axis=0)
    used = np.flatnonzero(largest > _ROUNDING * np.abs(load).max(initial=0.0))
    if not len(used):
        return np.zeros((0, 6)), np.zeros((len(load), 0))
    left, size, right = np.linalg.svd(about[:, used] / largest[used], full_matrices=False)
    rank = int(np.sum(size > _INDEPENDENT * size[0]))
    if rank == len(used):
        most = np.abs(load[:, used]).max(axis=0)
        return np.eye(6)[used] * most[:, None], load[:, used] / most
    direction, load_coordinates = np.zeros((rank, 6)), left[:, :rank] * size[:rank]
    direction[:, used] = right[:rank] * largest[used]
    most = np.abs(load_coordinates).max(axis=0)
    return direction * most[:, None], load_coordinates / most


def _fitted(load_coordinates: Array, value: Array, has_zero: bool) -> tuple[Array, Array]:
    """Return the responses (D, K) of columns (N, K) and their standard deviations, without single gross errors."""
    columns = np.column_stack([load_coordinates, np.ones(len(load_coordinates))]) if has_zero else load_coordinates
    rank = load_coordinates.shape[1]
    inverse = np.linalg.pinv(columns)
    coefficients = inverse @ value
    residual = value - columns @ coefficients
    spread = np.sqrt(np.sum(residual**2, axis=0) / max(len(load_coordinates) - columns.shape[1], 1))
    sigma = np.sqrt(np.sum(inverse**2, axis=1))[:, None] * spread
    out = np.abs(residual) > _GROSS * _MEDIAN * np.median(np.abs(residual), axis=0)
    for at in np.flatnonzero(out.any(axis=0) & (out.sum(axis=0) <= _MOST_OUT * len(load_coordinates))):
        is_used = ~out[:, at]
        again = np.linalg.lstsq(columns[is_used], value[is_used, at], rcond=None)[0]
        if np.linalg.matrix_rank(columns[is_used]) == columns.shape[1]:
            rest = value[is_used, at] - columns[is_used] @ again
            coefficients[:, at] = again
            sigma[:, at] *= np.sqrt(rest @ rest / max(len(rest) - columns.shape[1], 1)) / max(spread[at], 1e-300)
    return coefficients[:rank], sigma[:rank]
