"""Errors of single parts of a fitted model, as far as the observations determine them.

An error of one part moves the observations of an epoch in a known direction, which differs between epochs. So a course
of it has no pattern in space that a principal component could show. All parts may also scatter, with heavy tails: the
scatter is estimated, and everything is weighted by it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from truing.inference.arrays import Array
from truing.inference.fitted_model import FittedModel
from truing.inference.model import CauseT

_TAILS = 2.0  # degrees of freedom of Student's t, the distribution of the scatter
_FITS, _STEPS = 3, 20  # fits of the unknowns, and steps of the scatter's estimate in each
_LEAST_SCATTER = 1e-6  # variance, in units of that of the noise
_MOST_PRODUCTS = 1e10  # of numbers, in one fit: about ten seconds
_LEAST_INFORMATION = 1e-6  # on a combination of errors, over that on all of them; of less, nothing is known


@dataclass(frozen=True)
class PartProblem:
    """Whitened rows of a fit, and the change of them by errors of the parts.

    ``moved`` (B, M, n): change by the error of each part, of one noise on average; ``by_shared`` (B, M, G) and
    ``residual`` (B, M) of the epochs' rows; ``prior_by_shared`` (E, G) and ``prior_residual`` (E,) of all others.
    """

    moved: Array
    by_shared: Array
    residual: Array
    prior_by_shared: Array
    prior_residual: Array

    def beyond(self, index: int, functions: Array) -> PartProblem:
        """Return the problem with the error of a part along functions (B, m) among the unknowns, each N(0, 1)."""
        count = functions.shape[1]
        priors = np.zeros((len(self.prior_by_shared) + count, self.by_shared.shape[2] + count))
        priors[: len(self.prior_by_shared), : self.by_shared.shape[2]] = self.prior_by_shared
        priors[len(self.prior_by_shared) :, self.by_shared.shape[2] :] = np.eye(count)
        return replace(
            self,
            by_shared=np.concatenate([self.by_shared, self.moved[:, :, index, None] * functions[:, None]], 2),
            prior_by_shared=priors,
            prior_residual=np.concatenate([self.prior_residual, np.zeros(count)]),
        )

    @property
    def is_too_large(self) -> bool:
        """True if one fit would take longer than ten seconds."""
        epochs, tall, unknowns = self.by_shared.shape
        return bool(epochs * tall * unknowns**2 > _MOST_PRODUCTS)

    def estimated(self) -> PartErrors:
        """Return the errors of the parts, weighted by noise and by the scatter of all parts."""
        variance = np.full((len(self.moved), self.moved.shape[2]), _LEAST_SCATTER)
        for _ in range(_FITS):
            rest = self.residual - self.by_shared @ _Weights(self, variance).shared
            variance = _scatter(self.moved, rest)
        return self.weighted(variance)

    def weighted(self, variance: Array) -> PartErrors:
        """Return the errors of the parts for a known variance (B, n) of their scatter."""
        return _Weights(self, variance).errors()


@dataclass(frozen=True)
class PartErrors:
    """Information on the errors of n parts over the epochs, next to all unknowns of the model.

    ``weight`` (B, n): information on each error where all unknowns are known; ``taken`` (n, B, r): its part that the
    unknowns take, as products; ``score`` (n, B): derivatives of the log likelihood by the errors.
    """

    weight: Array
    taken: Array
    score: Array

    def products(self, index: int, functions: Array) -> tuple[Array, Array, float]:
        """Return products (m, m) of functions (B, m) of a part's error, their products (m,) with the residuals, and
        their size: divided by it, the functions have one noise on average. A constant error is the part's zero."""
        whole = np.column_stack([functions, np.ones(len(functions))])
        taken = whole.T @ self.taken[index]
        gram = whole.T @ (self.weight[:, index, None] * whole) - taken @ taken.T
        score = whole.T @ self.score[index]
        shift = gram[:-1, -1] / max(gram[-1, -1], 1e-300)
        size = float(np.sum(self.weight[:, index] @ functions**2)) / len(functions)
        return gram[:-1, :-1] - np.outer(shift, gram[-1, :-1]), score[:-1] - shift * score[-1], max(size, 1e-300)

    def along(self, index: int, functions: Array) -> tuple[Array, Array, Array]:
        """Return the components (r,) of the residuals along functions (B, m) of a part's error.

        Also their strengths (r,), for functions whose average size is one noise, and their directions (m, r).
        """
        gram, score, size = self.products(index, functions)
        values, vectors = np.linalg.eigh((gram + gram.T) / 2.0)
        is_large = values > _LEAST_INFORMATION * size * len(functions)
        values, vectors = values[is_large], vectors[:, is_large]
        return (vectors.T @ score) / np.sqrt(values), np.sqrt(values / size), vectors / np.sqrt(size)

    @cached_property
    def squares(self) -> tuple[Array, Array]:
        """Squares (n,) explained by random errors of each part next to a constant one, and their degrees of freedom
        (n,)."""
        found = [self._squares_of_any(index) for index in range(len(self.score))]
        return np.array([squares for squares, _ in found]), np.array([freedom for _, freedom in found])

    def _squares_of_any(self, index: int) -> tuple[float, float]:
        """Return the squares that an error in every epoch explains, and their degrees of freedom.

        As `along` all unit vectors (B, B), but by the few directions that the unknowns take: the gram matrix is
        diag(w) - U U', and I - V V' after division by the roots of w.
        """
        weight, taken, score = self.weight[:, index], self.taken[index], self.score[index]
        by_constant = weight - taken @ taken.sum(0)
        of_constant = max(float(by_constant.sum()), 1e-300)
        score = score - by_constant / of_constant * score.sum()
        seen = weight > _LEAST_INFORMATION * weight.sum()
        root = np.sqrt(weight[seen])
        taken = np.column_stack([taken, by_constant / np.sqrt(of_constant)])[seen] / root[:, None]
        values, vectors = np.linalg.eigh(taken.T @ taken)
        along = vectors.T @ (taken.T @ (score[seen] / root))
        left = values < 1.0 - _LEAST_INFORMATION * len(weight)  # the other directions are those of the unknowns alone
        of_others = np.sum(score[seen] ** 2 / weight[seen]) - np.sum(along[~left] ** 2 / values[~left])
        squares = float(of_others + np.sum(along[left] ** 2 / (1.0 - values[left])))
        return max(squares, 0.0), float(seen.sum() - np.sum(~left))


def part_problem(fitted: FittedModel[CauseT]) -> PartProblem | None:
    """Return the problem of the errors of a model's parts; None where there are none."""
    whitened, error_pathways = fitted.fit.whitened, fitted.model.error_pathways
    if not error_pathways or whitened.whole is None:
        return None
    places = fitted.pathways.places
    moved = fitted.pathways.columns[
        :, :, [places[pathway.pathway].start + pathway.column for pathway in error_pathways]
    ]
    epochs, tall, _ = moved.shape
    size = np.sqrt(np.mean(np.sum(moved**2, 1), 0))
    first = epochs * tall
    return PartProblem(
        moved / np.where(size > 0.0, size, 1.0),
        whitened.own,
        whitened.residual[:first].reshape(epochs, tall),
        whitened.whole[first:],
        whitened.residual[first:],
    )


class _Weights:
    """A problem solved with the noise and a scatter of the parts with variances (B, n)."""

    def __init__(self, problem: PartProblem, variance: Array) -> None:
        self._problem = problem
        self._scattered = problem.moved * np.sqrt(variance)[:, None]
        products = np.swapaxes(self._scattered, 1, 2) @ self._scattered
        self._inner = np.linalg.inv(np.eye(products.shape[1]) + products)
        normal = self._summed_products(problem.by_shared)
        normal += problem.prior_by_shared.T @ problem.prior_by_shared
        self._inverse = np.linalg.inv(np.linalg.cholesky(normal))
        known = self._products(problem.by_shared, problem.residual[..., None])[..., 0].sum(0)
        known += problem.prior_by_shared.T @ problem.prior_residual
        self.shared = self._inverse.T @ (self._inverse @ known)

    def _summed_products(self, columns: Array) -> Array:
        """Return the sum (p, p) over epochs of the products of columns (B, M, p) with themselves, as `_products`; the
        products of single epochs would take p times the memory of the columns."""
        root = np.swapaxes(np.linalg.cholesky(self._inner), 1, 2)
        taken = root @ (np.swapaxes(self._scattered, 1, 2) @ columns)
        size = columns.shape[2]
        rows, scattered = (one.reshape(one.shape[0] * one.shape[1], size) for one in (columns, taken))
        return np.asarray(rows.T @ rows - scattered.T @ scattered)

    def _products(self, first: Array, second: Array) -> Array:
        """Return the products (B, p, q) of columns (B, M, p) and (B, M, q) over the covariance of the rows."""
        scattered_first, scattered_second = (
            np.swapaxes(self._scattered, 1, 2) @ columns for columns in (first, second)
        )
        return np.asarray(
            np.swapaxes(first, 1, 2) @ second - np.swapaxes(scattered_first, 1, 2) @ (self._inner @ scattered_second)
        )

    def errors(self) -> PartErrors:
        """Return the information on the errors of the parts."""
        problem = self._problem
        residuals = (problem.residual - problem.by_shared @ self.shared)[..., None]
        weight = np.diagonal(self._products(problem.moved, problem.moved), axis1=1, axis2=2)
        taken = self._products(problem.moved, problem.by_shared) @ self._inverse.T
        score = self._products(problem.moved, residuals)[..., 0]
        return PartErrors(weight, np.swapaxes(taken, 0, 1), score.T)


def _scatter(moved: Array, rest: Array) -> Array:
    """Return the variances (B, n) of the parts' scatter in residuals (B, M), larger where an error is far off.

    Steps of expectation and maximisation for Student's t (Lange, Little and Taylor, J. Am. Stat. Assoc. 84 (1989) 881).
    """
    products = np.swapaxes(moved, 1, 2) @ moved
    along = (np.swapaxes(moved, 1, 2) @ rest[..., None])[..., 0]
    variance, usual = np.ones((len(moved), moved.shape[2])), np.ones(moved.shape[2])
    identity = np.eye(moved.shape[2])
    for _ in range(_STEPS):
        # Posterior of the errors: covariance (1 / variance + products)^-1.
        root = np.sqrt(variance)
        inner = np.linalg.inv(identity + root[:, :, None] * products * root[:, None])
        covariance = root[:, :, None] * inner * root[:, None]
        error = (covariance @ along[..., None])[..., 0]
        squares = error**2 + np.diagonal(covariance, axis1=1, axis2=2)
        weights = (_TAILS + 1.0) / (_TAILS + squares / usual)
        known = np.sum(1.0 - np.diagonal(covariance, axis1=1, axis2=2) / variance, 0)
        usual = np.maximum(np.sum(weights * error**2, 0) / np.maximum(known, _LEAST_SCATTER), _LEAST_SCATTER)
        variance = usual / (_TAILS + 1.0) * (_TAILS + squares / usual)
    return np.asarray(variance)
