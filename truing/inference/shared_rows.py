"""Derivatives of a whitened problem's rows by its shared unknowns, stored once where columns act in few epochs each.

Rows are those of epochs, then extra rows, then priors, which are rows of the identity. Nothing here expands all of
them: with many runs the full matrix is the largest array of a fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from truing.inference.arrays import Array, Integers

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Epochs whose products are formed at a time.
_AT_ONCE = 64
_ROWS_AT_ONCE = 1024
# Most columns of few epochs that overlap with others and are eliminated with the common ones.
_MOST_OVERLAPPING = 64


@dataclass(frozen=True)
class SharedRows:
    """Rows of epochs ``own`` (B, H, C), whose columns belong to the unknowns ``columns`` (B, C), and rows ``extra``
    (E, G).

    The first ``common`` columns are the same in all epochs; the number G marks an empty column.
    """

    own: Array
    extra: Array
    columns: Integers
    common: int

    @property
    def size(self) -> int:
        """Number G of shared unknowns."""
        return int(self.extra.shape[1])

    @property
    def of_epochs(self) -> int:
        """Number of rows of epochs."""
        return int(self.own.shape[0] * self.own.shape[1])

    @property
    def count(self) -> int:
        """Number N of all rows."""
        return self.of_epochs + len(self.extra) + self.size

    def at(self, epochs: Integers | slice) -> Array:
        """Rows (b, H, G) of some epochs, with all columns."""
        own_rows = self.own[epochs]
        wide = np.zeros((*own_rows.shape[:2], self.size + 1))
        np.put_along_axis(wide, self.columns[epochs][:, None], own_rows, 2)
        return wide[..., : self.size]

    def picked(self, values: Array) -> Array:
        """Values (B, C, ...) of each epoch's own columns, from those of all unknowns (G, ...)."""
        return np.concatenate([values, np.zeros((1, *values.shape[1:]))])[self.columns]

    def times(self, shared: Array) -> Array:
        """Products (N, ...) of the rows with shared unknowns (G, ...)."""
        if shared.ndim == 1:
            epochs = np.matmul(self.own, self.picked(shared)[..., None])[..., 0]
        else:
            epochs = np.matmul(self.own, self.picked(shared))
        return np.concatenate([epochs.reshape(-1, *shared.shape[1:]), self.extra @ shared, shared])

    def products(self, rows: Array) -> Array:
        """Products (G, ...) of the columns with rows (N, ...)."""
        first, extra = self.of_epochs, self.of_epochs + len(self.extra)
        epochs = rows[:first].reshape(*self.own.shape[:2], -1)
        sums = self.of_epoch_rows(epochs).reshape(-1, *rows.shape[1:])
        return np.asarray(sums + self.extra.T @ rows[first:extra] + rows[extra:])

    def of_epoch_rows(self, rows: Array) -> Array:
        """Products (G, P) of the columns with rows (B, H, P) of epochs, zero in all other rows."""
        return self.combined(self.own, rows, few=self._few_of_own)

    def combined(
        self, products: Array, designs: Array, during: slice = slice(None), few: csr_array | None = None
    ) -> Array:
        """Sums (G, P) over some epochs of products (b, n, C) with each epoch's own columns, weighted by designs
        (b, n, P). ``few``: the part of the products that `few_of` returns, if known."""
        size = designs.shape[-1]
        designs = designs.reshape(-1, size)
        wide = products.reshape(len(designs), products.shape[-1])[:, : self.common]
        sums = np.zeros((self.size + 1, size))
        sums[self.columns[0, : self.common]] = wide.T @ designs
        if self.columns.shape[1] > self.common:
            sums += (self.few_of(products, during) if few is None else few) @ designs
        return sums[: self.size]

    def weighted(self, products: Array, weights: Array, few: Sequence[csr_array]) -> Array:
        """Sums (W, n, G) over epochs of products (B, n, C) with each epoch's own columns, weighted by (W, B). ``few``:
        the part of each of the n products that `few_of` returns."""
        epochs, count, _ = products.shape
        sums = np.zeros((len(weights), count, self.size + 1))
        common = weights @ products[..., : self.common].reshape(epochs, count * self.common)
        sums[..., self.columns[0, : self.common]] = common.reshape(len(weights), count, self.common)
        for number, few_columns in enumerate(few):
            sums[:, number] += (few_columns @ weights.T).T
        return sums[..., : self.size]

    def summed(self, rows: Array, epochs: Integers) -> Array:
        """Sum (n, G) of rows (b, n, C) with the columns of some epochs."""
        sums = np.zeros((rows.shape[1], self.size + 1))
        few = self.columns[epochs, self.common :]
        np.add.at(sums, (np.arange(len(sums))[:, None], few[:, None]), rows[..., self.common :])
        sums[:, self.columns[0, : self.common]] = rows[..., : self.common].sum(0)
        return sums[:, : self.size]

    def few_of(self, products: Array, during: slice = slice(None)) -> csr_array:
        """Sparse matrix (G + 1, b n) of products (b, n, C) with those columns of some epochs that act in few. Most are
        zero: a reading has the zero of its own run and channel."""
        from scipy.sparse import csr_array

        columns, values = self.columns[during, self.common :], products[..., self.common :]
        epoch, row, place = np.nonzero(values)
        at = columns[epoch, place], epoch * values.shape[1] + row
        return csr_array((values[epoch, row, place], at), shape=(self.size + 1, values.shape[0] * values.shape[1]))

    @cached_property
    def _few_of_own(self) -> csr_array:
        return self.few_of(self.own)

    @cached_property
    def _rows_of_few(self) -> csr_array:
        """The same, a row (G + 1,) for each row of the epochs."""
        return self._few_of_own.T.tocsr()

    @property
    def _wide(self) -> Array:
        """Columns (B H, c) that are common to all epochs."""
        return self.own.reshape(self.of_epochs, self.own.shape[2])[:, : self.common]

    @cached_property
    def gram(self) -> Array:
        """Products (G, G) of the columns with each other, priors included; columns of few epochs are multiplied only
        there."""
        common, wide, few = self.columns[0, : self.common], self._wide, self._few_of_own
        whole = (few @ few.T).toarray()
        cross = few @ wide
        whole[:, common] = cross
        whole[common] = cross.T
        whole[np.ix_(common, common)] = wide.T @ wide
        gram = np.asarray(whole[: self.size, : self.size])
        gram[np.diag_indices(self.size)] += 1.0  # the priors
        return gram + self.extra.T @ self.extra if len(self.extra) else gram

    def solved(self, values: Array) -> Array | None:
        """Solution (G,) of `gram` times it equals values (G,); None where many columns of few epochs overlap.

        Columns that share no row with each other, as the zeros of runs, are eliminated one by one; only the others need
        a factor.
        """
        if self._eliminated is None:
            return None
        exact, squares, cross, left = self._eliminated
        solution = values / squares
        solution[exact] = 0.0
        solution[exact] = np.linalg.solve(left, values[exact] - cross.T @ solution)
        return np.asarray(solution - cross @ solution[exact] / squares)

    @cached_property
    def _eliminated(self) -> tuple[Integers, Array, Array, Array] | None:
        """Columns (k,) that are kept; squares (G,) of the others, priors included; their products (G, k) with those
        kept; and the products (k, k) of those kept without what the others explain. Zero at the kept ones."""
        few, wide = self._few_of_own, self._wide
        exact = self._overlapping
        if exact is None or len(self.extra):
            return None
        wide = np.concatenate([wide, few[exact].toarray().T], 1)
        exact = np.concatenate([self.columns[0, : self.common], exact])
        squares, cross = 1.0 + few.power(2).sum(1)[: self.size], (few @ wide)[: self.size]
        squares[exact], cross[exact] = 1.0, 0.0
        return exact, squares, cross, np.eye(len(exact)) + wide.T @ wide - cross.T @ (cross / squares[:, None])

    @property
    def _overlapping(self) -> Integers | None:
        """Columns of few epochs without which no two of these share a row; None where they are too many."""
        acting = self._few_of_own.astype(bool).astype(float)
        shared = (acting @ acting.T).tocoo()
        pairs = np.stack([shared.row, shared.col])[:, shared.row != shared.col]
        exact: list[int] = []
        while pairs.size and len(exact) < _MOST_OVERLAPPING:
            exact.append(int(np.bincount(pairs[0]).argmax()))
            pairs = pairs[:, (pairs != exact[-1]).all(0)]
        return None if pairs.size else np.array(exact, int)

    def followed(self, covariance: Array, rows: slice) -> Array:
        """Covariance (B, n, n) of some rows of each epoch, by a covariance (G, G) of the shared unknowns."""
        wide = np.zeros((self.size + 1, self.size + 1))
        wide[: self.size, : self.size] = covariance
        common, blocks = self.columns[0, : self.common], []
        among, cross = wide[np.ix_(common, common)], wide[:, common]
        for first in range(0, len(self.own), _AT_ONCE):
            block = self.own[first : first + _AT_ONCE, rows]
            few = self.columns[first : first + _AT_ONCE, self.common :]
            alike, single = block[..., : self.common], block[..., self.common :]
            both = (single @ cross[few]) @ np.swapaxes(alike, 1, 2)
            blocks.append((alike @ among) @ np.swapaxes(alike, 1, 2) + both + np.swapaxes(both, 1, 2))
            blocks[-1] += single @ wide[few[:, :, None], few[:, None]] @ np.swapaxes(single, 1, 2)
        return np.concatenate(blocks)

    def followed_squares(self, covariance: Array) -> Array:
        """Variances (B, H) of the rows of each epoch: the diagonals of what `followed` returns."""
        wide = np.zeros((self.size + 1, self.size + 1))
        wide[: self.size, : self.size] = covariance
        common, few = self.columns[0, : self.common], self.columns[:, self.common :]
        alike, single = self.own[..., : self.common], self.own[..., self.common :]
        cross = single @ wide[:, common][few] if few.shape[1] else 0.0
        single_squares = np.sum(single @ wide[few[:, :, None], few[:, None]] * single, -1) if few.shape[1] else 0.0
        return np.asarray(np.sum((alike @ wide[np.ix_(common, common)] + 2.0 * cross) * alike, -1) + single_squares)

    def mapped(self, matrix: Array, kind: type[np.floating] = np.float64) -> Array:
        """Products (N, P) of all rows with a matrix (G, P), in a given precision; formed for some epochs at a time."""
        result = np.empty((self.count, matrix.shape[1]), kind)
        few, common = np.concatenate([matrix, np.zeros((1, matrix.shape[1]))]), matrix[self.columns[0, : self.common]]
        for first in range(0, self.of_epochs, _ROWS_AT_ONCE):
            chosen = np.s_[first : min(first + _ROWS_AT_ONCE, self.of_epochs)]
            result[chosen] = self._wide[chosen] @ common + self._rows_of_few[chosen] @ few
        result[self.of_epochs :] = np.concatenate([self.extra @ matrix, matrix])
        return result
