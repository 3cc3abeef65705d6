"""Whitened linear problem of one fit: elimination of unknowns, next step, covariance, projection onto residuals.

Rows are measurements and priors, each divided by its standard deviation. Unknowns are in prior standard deviations, so
a prior is a row of the identity. Local unknowns are eliminated epoch by epoch, shared ones by one orthogonal basis;
`Whitened.rest` is what no unknown explains.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from truing.inference.arrays import Array, Integers, Mask
from truing.inference.linearised_model import LinearisedModel
from truing.inference.shared_rows import SharedRows

# Zero rows of missing observations are left out of products if fewer than this share of all rows is present.
_FEW_MISSING = 0.9


@dataclass(frozen=True)
class Whitened:
    """The problem after elimination of its local unknowns. Rows: epochs with local priors, extra rows,
    shared priors."""

    problem: LinearisedModel
    local_basis: Array  # (B, M + H, H) orthonormal
    local_factor: Array  # (B, H, H) triangular
    own: Array  # (B, M + H, G or C) shared derivatives in the rows of epochs
    residual: Array  # (N,)

    whole: Array | None = None  # (N, G) all rows, unless the problem is compact

    @property
    def rows(self) -> Array:
        """Derivatives (N, G) of all rows by the shared unknowns; expanded at each call if the problem is compact."""
        return self.compact.mapped(np.eye(self.compact.size)) if self.whole is None else self.whole

    @cached_property
    def compact(self) -> SharedRows:
        """The same derivatives of a compact problem, as stored."""
        assert self.problem.columns is not None
        return SharedRows(self.own, self.problem.extra_by_shared, self.problem.columns, self.problem.common)

    def rows_at(self, epochs: Integers | slice) -> Array:
        """Return the derivatives (b, M + H, G) in the rows of some epochs."""
        return self.own[epochs] if self.whole is not None else self.compact.at(epochs)

    def basis_summed(self, epochs: Integers, turned: Callable[[Array], Array]) -> Array:
        """Return the sum (n, G) of the basis' rows over some epochs, transformed from rows (b, M + H, ...) to (b, n,
        ...)."""
        if self.whole is None:
            return np.asarray(self.compact.summed(turned(self.own[epochs]), epochs) @ self._inverse)
        return np.asarray(turned(self.basis_at(epochs)).sum(0))

    def basis_at(self, epochs: Integers | slice) -> Array:
        """Return the rows (b, M + H, G) of the basis that belong to some epochs."""
        if self.whole is None:
            return self.compact.at(epochs) @ self._inverse
        return self._known_basis[: self.own.shape[0] * self.own.shape[1]].reshape(self.own.shape)[epochs]

    def with_residuals(self, problem: LinearisedModel) -> Whitened:
        """Return the whitened problem with the residuals of another one, which has the same derivatives."""
        result = replace(self, problem=problem, residual=_stacked(problem, self.without_local))
        for name in ("_gram", "_factor", "_inverse", "compact"):
            if name in self.__dict__:
                result.__dict__[name] = self.__dict__[name]
        return result

    def without(self, epochs: Mask) -> Whitened:
        """Return the whitened problem without the measurements of some epochs (B,), whose local unknowns are zero.

        Nothing is eliminated anew: the other epochs keep their basis, and products lose the rows of these."""
        problem, (_, tall, count) = self.problem.without(epochs), self.local_basis.shape
        left, of_priors = epochs[:, None, None], np.eye(tall, count, count - tall)
        basis, factor = np.where(left, of_priors, self.local_basis), np.where(left, np.eye(count), self.local_factor)
        residual = self.residual.copy()
        residual[: len(epochs) * tall].reshape(len(epochs), tall)[epochs] = 0.0
        if self.whole is None:
            return Whitened(problem, basis, factor, np.where(left, 0.0, self.own), residual)
        whole, out = self.whole.copy(), self.own[epochs].reshape(-1, self.own.shape[2])
        own = whole[: len(epochs) * tall].reshape(self.own.shape)
        own[epochs] = 0.0
        result = Whitened(problem, basis, factor, own, residual, whole)
        result.__dict__["_gram"] = self._gram - out.T @ out
        return result

    @cached_property
    def _factor(self) -> Array:
        """Upper triangular factor (G, G) of the rows, from the Cholesky factor of their products. The priors among the
        rows keep the products regular. Their condition is the square of that of the rows; nine digits remain."""
        return np.linalg.cholesky(self._gram).T

    @cached_property
    def _inverse(self) -> Array:
        """Inverse (G, G) of the triangular factor."""
        return _inverse_of(self._factor)

    @cached_property
    def _gram(self) -> Array:
        """Products (G, G) of the rows' columns; columns of few epochs are multiplied only there."""
        if self.whole is None:
            return self.compact.gram
        rows = self._informative_rows  # the same array twice: half of the symmetric product is computed
        return np.asarray(rows.T @ rows)

    @property
    def normal_matrix(self) -> Array:
        """Products (G, G) of the rows' columns, priors included."""
        return self._gram

    @cached_property
    def _shared_step(self) -> tuple[Array, float]:
        """Least-squares step (G,) of the shared unknowns, and the reduction of the sum of squares by it."""
        products = self.of_columns(self.residual)
        quick = self.compact.solved(products) if self.whole is None else None
        if quick is not None:
            return quick, float(products @ quick)
        parts = _solved(self._factor, products, transposed=True)
        return _solved(self._factor, parts), float(np.sum(parts**2))

    def moved(self, shared: Array) -> Array:
        """Return the change (N,) of all rows by shared unknowns (G,)."""
        return self.whole @ shared if self.whole is not None else self.compact.times(shared)

    def of_columns(self, residual: Array) -> Array:
        """Return the products (G, ...) of the rows' columns with residuals (N, ...)."""
        return np.asarray(self.rows.T @ residual) if self.whole is not None else self.compact.products(residual)

    @cached_property
    def basis(self) -> Array:
        """Orthonormal basis (N, G) of the space that the shared unknowns explain.

        It is large, so nothing keeps that of a compact problem: `basis_summed`, `rest` and `leverage` do without.
        """
        nearly = self._nearly_orthonormal
        self.__dict__.pop("_nearly_orthonormal")  # as large
        return _times_upper(nearly, _inverse_of(np.linalg.cholesky(nearly.T @ nearly).T))

    @cached_property
    def _nearly_orthonormal(self) -> Array:
        """The same basis, orthonormal to nine digits: enough for leverages, all that most fits need."""
        nearly = _times_upper(self._informative_rows, self._inverse)
        if len(nearly) == len(self.rows):
            return nearly
        basis = np.zeros_like(self.rows)
        basis[self._is_informative] = nearly
        return basis

    @property
    def _known_basis(self) -> Array:
        """The basis (N, G) if it is known, or the nearly orthonormal one."""
        return self.basis if "basis" in self.__dict__ else self._nearly_orthonormal

    @property
    def _informative_rows(self) -> Array:
        """Rows (n, G), without the zero rows of missing observations where these are many."""
        return self.rows if self._is_informative.mean() > _FEW_MISSING else self.rows[self._is_informative]

    @cached_property
    def _is_informative(self) -> Mask:
        informative = np.ones(len(self.rows), bool)
        epochs, count = self.problem.local_value.shape
        own = np.concatenate([self.problem.present, np.ones((epochs, count), bool)], 1).ravel()
        informative[: len(own)] = own
        return informative

    @cached_property
    def _rough_basis(self) -> Array:
        """The basis (N, G) in single precision."""
        return self.basis.astype(np.float32)

    def prepare_draws(self) -> None:
        """Form the matrices of `without_shared_roughly`, before several threads call it."""
        _ = self._inverse if self.whole is None else self._rough_basis

    def without_draws(self) -> None:
        """Free the array that only `without_shared_roughly` needs."""
        self.__dict__.pop("_rough_basis", None)

    def without_shared_roughly(self, rows: Array) -> Array:
        """Return rows (D, N) without their projection on the space that the shared unknowns explain, all in single
        precision. A compact problem takes few products in double precision, instead of many with its basis."""
        if self.whole is not None:
            return np.asarray(rows - (rows @ self._rough_basis) @ self._rough_basis.T)
        shared = self._inverse @ (self._inverse.T @ self.compact.products(rows.T.astype(float)))
        return np.asarray(rows - self.compact.mapped(shared, np.float32).T)

    def along_basis(self, parts: Array) -> Array:
        """Return rows (N, ...) from their parts (G, ...) along the basis."""
        return self.basis @ parts if self.whole is not None else self.compact.mapped(self._inverse @ parts)

    def onto_basis(self, products: Array) -> Array:
        """Return the parts (G, P) along the basis, from products (G, P) of a compact problem's columns."""
        return _times_upper(products.T, self._inverse).T

    @cached_property
    def rest(self) -> Array:
        """Residual (N,) after the fit of all unknowns."""
        return self.without_shared(self.residual)

    def without_shared(self, rows: Array) -> Array:
        """Return rows (N,) without their projection on the space that the shared unknowns explain."""
        for _ in range(2):  # the second projection removes what rounding left of the first
            rows = rows - self.moved(self.fitted(rows))
        return rows

    def taken(self, rows: slice) -> Array:
        """Return the blocks (B, n, n) of the hat matrix for some rows of each epoch."""
        local = self.local_basis[:, rows]
        if self.whole is None:
            shared = self.compact.followed(self.covariance(), rows)
        else:
            basis = self.basis_at(slice(None))[:, rows]
            shared = basis @ np.swapaxes(basis, 1, 2)
        return np.asarray(local @ np.swapaxes(local, 1, 2) + shared)

    @cached_property
    def explained(self) -> float:
        """Reduction of the sum of squares by the next step of all unknowns."""
        local = np.einsum(
            "bmh,bm->bh", self.local_basis, _with_priors(self.problem.residual, -self.problem.local_value)
        )
        return float(np.sum(local**2)) + self._shared_step[1]

    def taken_in_blocks(self, count: int, size: int) -> Array:
        """Return the same (B, count, size, size) for blocks of neighbouring rows, from the first row of an epoch on."""
        if self.whole is None and size == 1:
            return self._leverage.reshape(len(self.own), -1)[:, :count, None, None]
        if self.whole is None:
            each = np.arange(count)
            matrix = self.taken(slice(0, count * size)).reshape(-1, count, size, count, size)
            return np.moveaxis(matrix[:, each, :, each], 0, 1)
        rows = (self.local_basis, self.basis_at(slice(None)))
        parts = (row[:, : count * size].reshape(len(row), count, size, -1) for row in rows)
        return np.asarray(sum(part @ np.swapaxes(part, -1, -2) for part in parts))

    @cached_property
    def leverage(self) -> Array:
        """Leverage (N,) of each row; 1 where nothing is left to test."""
        others = self.leverage_of_shared[len(self._leverage) :]
        return np.asarray(np.minimum(np.concatenate([self._leverage, others]), 1.0))

    @cached_property
    def _leverage(self) -> Array:
        """Leverage of each row of the epochs, up to rounding."""
        local = np.sum(self.local_basis**2, -1).ravel()
        return np.asarray(self.leverage_of_shared[: len(local)] + local)

    @cached_property
    def leverage_of_shared(self) -> Array:
        """Part (N,) of the leverage that is due to the shared unknowns."""
        if self.whole is not None:
            return np.asarray(np.sum(self._known_basis**2, -1))
        covariance = self.covariance()
        of_epochs = self.compact.followed_squares(covariance)
        extra = self.problem.extra_by_shared
        of_extra = np.sum((extra @ covariance) * extra, -1)
        return np.concatenate([of_epochs.ravel(), of_extra, np.diagonal(covariance)])

    @cached_property
    def present(self) -> Mask:
        """True for rows (N,) with information: measured values, and priors that are knowledge."""
        priors = np.broadcast_to(self.problem.local_known, self.problem.local_value.shape)
        epoch_rows = np.concatenate([self.problem.present, priors], 1).ravel()
        extra = np.ones(len(self.problem.extra_residual), bool)
        return np.concatenate([epoch_rows, extra, self.problem.shared_known])

    @cached_property
    def freedom(self) -> float:
        """Degrees of freedom of `rest`."""
        return float(np.sum((1.0 - self.leverage)[self.present]))

    def step(self) -> tuple[Array, Array]:
        """Return the least-squares step of the shared (G,) and local (B, H) unknowns, in prior sigmas."""
        shared, _ = self._shared_step
        return shared, self.local_step(shared)

    def local_step(self, shared: Array) -> Array:
        """Return the least-squares step of the local unknowns (B, H) for a given step (G,) of the shared ones."""
        left = _with_priors(self.problem.residual - self.problem.moved(shared), -self.problem.local_value)
        local = np.linalg.solve(self.local_factor, np.einsum("bmh,bm->bh", self.local_basis, left)[..., None])
        return np.asarray(local[..., 0])

    def in_basis(self, shared: Array) -> Array:
        """Return steps (G, ...) of the shared unknowns as parts along the basis, in standard deviations."""
        return self._factor @ shared

    def fitted(self, rows: Array) -> Array:
        """Return the shared unknowns (G, ...), in prior sigmas, that fit rows (N, ...) best."""
        return self._inverse @ (self._inverse.T @ self.of_columns(rows))

    def from_basis(self, parts: Array) -> Array:
        """Return the shared unknowns (G, ...), in prior sigmas, whose rows are the basis times parts (G, ...)."""
        return self._inverse @ parts

    def covariance(self) -> Array:
        """Return the covariance (G, G) of the shared unknowns, in prior sigmas squared."""
        return self._covariance

    @cached_property
    def _covariance(self) -> Array:
        return self._inverse @ self._inverse.T

    def covariance_from(self, rows: Mapping[str, Mask], place: slice) -> dict[str, Array]:
        """Return the covariance (P, P) of some shared unknowns that the errors of each group of rows (N,) cause.

        Rows have independent errors of unit variance; if the groups hold every row once, they sum to `covariance`.
        """
        steps = self._inverse @ self._inverse[place].T
        follows = (self.rows @ steps if self.whole is not None else self.compact.mapped(steps)).T
        return {name: follows[:, own] @ follows[:, own].T for name, own in rows.items()}

    def without_local(self, columns: Array) -> Array:
        """Return columns (B, M + H, P) without their projection on the local unknowns."""
        explained = self.local_basis @ (np.swapaxes(self.local_basis, 1, 2) @ columns)
        return np.subtract(columns, explained, out=explained)


def whiten(problem: LinearisedModel) -> Whitened:
    """Return the problem with its local unknowns eliminated (batched QR of each epoch's rows and priors)."""
    epochs, _, count = problem.by_local.shape
    identity = np.broadcast_to(np.eye(count), (epochs, count, count))
    basis, factor = np.linalg.qr(np.concatenate([problem.by_local, identity], 1))
    bare = Whitened(problem, basis, factor, np.empty(0), np.empty(0))
    stacked = _stacked(problem, bare.without_local)
    if problem.columns is None:
        rows = _shared_rows(problem, basis)
        own = rows[: basis.shape[0] * basis.shape[1]].reshape(*basis.shape[:2], -1)
        return Whitened(problem, basis, factor, own, stacked, rows)
    own = bare.without_local(_padded(problem.by_shared, count)) if count else problem.by_shared
    return Whitened(problem, basis, factor, own, stacked)


def _stacked(problem: LinearisedModel, without_local: Callable[[Array], Array]) -> Array:
    """Return the residuals (N,) of all rows, without their projection on the local unknowns."""
    own = without_local(_with_priors(problem.residual, -problem.local_value)[..., None])
    return np.concatenate([own.ravel(), problem.extra_residual, -problem.shared_value])


def _shared_rows(problem: LinearisedModel, basis: Array) -> Array:
    """Return the derivatives (N, G) of all rows by the shared unknowns, without their projection on the local ones.
    This is the largest array of all, so each part is written directly into its place."""
    (epochs, height, size), tall = problem.by_shared.shape, basis.shape[1]
    first, extra = epochs * tall, len(problem.extra_by_shared)
    rows = np.empty((first + extra + size, size))
    own = rows[:first].reshape(epochs, tall, size)
    np.matmul(-basis, np.swapaxes(basis[:, :height], 1, 2) @ problem.by_shared, out=own)
    own[:, :height] += problem.by_shared
    rows[first : first + extra] = problem.extra_by_shared
    rows[first + extra :] = np.eye(size)
    return rows


def _padded(rows: Array, count: int) -> Array:
    """Return rows (B, M + H, C): rows (B, M, C), then the zero rows of ``count`` priors."""
    return np.concatenate([rows, np.zeros((len(rows), count, rows.shape[2]))], 1)


def _inverse_of(factor: Array) -> Array:
    """Return the inverse (G, G) of an upper triangular factor."""
    from scipy.linalg.lapack import dtrtri

    return np.asarray(dtrtri(factor)[0])


def _solved(factor: Array, values: Array, *, transposed: bool = False) -> Array:
    """Return the solution (G,) of an upper triangular system (G, G), or of its transpose, for values (G,)."""
    from scipy.linalg.lapack import dtrtrs

    return np.asarray(dtrtrs(factor, values, trans=int(transposed))[0])


def _times_upper(rows: Array, upper: Array) -> Array:
    """Return rows (N, G) times an upper triangular matrix (G, G), at half the cost of a full product."""
    from scipy.linalg.blas import dtrmm

    return np.asarray(dtrmm(1.0, upper, rows.T, trans_a=1)).T


def _with_priors(rows: Array, priors: Array) -> Array:
    return np.concatenate([rows, priors], 1)
