"""Fit of a calibration to a table of loads (plain, weighted, or with errors in loads and signals), and checks of the
data.

The printed formula inverts V V^T. This has no inverse if channels are dependent or a load direction is missing; if it
is regular only due to noise, its inverse is noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truing.estimation.design.observability import inseparable, observe
from truing.estimation.errors_in_variables.descent import Prior
from truing.estimation.errors_in_variables.fit import fit_errors_in_variables
from truing.estimation.least_squares.solver import SolverStatus
from truing.estimation.sensor.calibration import Calibration, CalibrationModel, Terms
from truing.estimation.sensor.load_table import LoadTable, least_signal

_LEAST_SINGULAR = 1e-8  # share of the unit columns' largest singular value below which one is zero


class UndeterminedCalibrationError(ValueError):
    """Loads or signals do not determine the calibration; the message names the missing combinations."""


def check_determined(columns: NDArray, labels: Sequence[str], what: str) -> None:
    """Raise UndeterminedCalibrationError, naming combinations, unless columns (N, Q) are independent.

    ``what``: the columns, in words. Columns may differ in unit by any factor.
    """
    unseen = _undetermined_combinations(columns, labels)
    if unseen:
        raise UndeterminedCalibrationError(f"{what}: {'; '.join(unseen)}")


def _undetermined_combinations(columns: NDArray, labels: Sequence[str]) -> list[str]:
    """Return in words the combinations that columns (N, Q) do not determine, and columns that are always zero."""
    length = np.linalg.norm(columns, axis=0)
    idle = length <= _LEAST_SINGULAR**2 * max(length.max(initial=0.0), np.finfo(float).tiny)
    texts = [f"{label} is zero in all rows" for label, none in zip(labels, idle, strict=True) if none]
    used = [label for label, none in zip(labels, idle, strict=True) if not none]
    if not used:
        return texts
    seen = observe(columns[:, ~idle], 1.0 / length[~idle], used, unidentifiable=1.0 / _LEAST_SINGULAR)
    return texts if seen.rank == len(used) else texts + [group.text for group in inseparable(seen)]


def check_signals(signals: NDArray, signal_cov: NDArray | None, labels: Sequence[str]) -> None:
    """Raise UndeterminedCalibrationError unless V V^T of signals (N, C) has an inverse beyond noise.

    signal_cov (C, C): covariance of one row's errors; if not declared, rounding is the limit.
    """
    rank = "V V^T is singular"
    check_determined(signals, labels, f"{rank}, the channels are not independent")
    if signal_cov is None:
        return
    level = np.sqrt(np.diag(signal_cov))
    known = level > 0
    if not known.any():
        return
    rows = len(signals)
    used = [label for label, noisy in zip(labels, known, strict=True) if noisy]
    seen = observe(signals[:, known], 1.0 / level[known], used, unidentifiable=1.0 / least_signal(rows))
    if seen.rank < known.sum():
        unseen = "; ".join(group.text for group in inseparable(seen))
        raise UndeterminedCalibrationError(
            f"{rank} within noise: {len(signals)} rows hold {seen.rank} independent signals in {known.sum()} channels "
            f"({unseen}); apply loads in more directions, or fit signals to loads (direction 'forward')"
        )


def check_loads(loads: NDArray, labels: Sequence[str]) -> None:
    """Raise UndeterminedCalibrationError, naming the loads, unless loads (N, W) cover every direction."""
    unseen = _undetermined_combinations(loads, labels)
    if unseen:
        raise UndeterminedCalibrationError(
            f"the loads do not cover all directions of the wrench: {'; '.join(unseen)}; apply loads that separate them"
        )


@dataclass(frozen=True)
class _CalibrationTable:
    """A table in the direction of a model: response y (N, W), inputs x (N, C), columns of the zeros (N, G)."""

    model: CalibrationModel
    table: LoadTable

    @property
    def direct(self) -> bool:
        return self.model.direction == "direct"

    @property
    def y(self) -> NDArray:
        return self.table.loads if self.direct else self.table.signals

    @property
    def x(self) -> NDArray:
        return self.table.signals if self.direct else self.table.loads

    @property
    def response_names(self) -> tuple[str, ...]:
        return self.table.load_names if self.direct else self.table.signal_names

    @property
    def covariances(self) -> tuple[NDArray | None, NDArray | None]:
        """Declared covariances of the response and of the inputs."""
        pair = self.table.load_cov, self.table.signal_cov
        return pair if self.direct else (pair[1], pair[0])

    @cached_property
    def terms(self) -> Terms:
        inputs = self.table.signal_names if self.direct else self.table.load_names
        model = self.model
        return Terms(inputs, self.table.covariate_names, model.drift, model.gain, model.powers)

    @cached_property
    def zeros(self) -> NDArray:
        if self.model.zero == "case":
            return (self.table.case[:, None] == self.table.cases).astype(float)
        return np.ones((len(self.y), int(self.model.zero == "common")))

    @cached_property
    def columns(self) -> NDArray:
        return np.concatenate([self.terms.at(self.x, self.table.covariates), self.zeros], axis=1)

    @property
    def labels(self) -> tuple[str, ...]:
        zero = {"none": [], "common": ["zero"], "case": [f"zero of {case}" for case in self.table.cases]}
        return (*self.terms.labels, *zero[self.model.zero])

    def prior(self) -> Prior | None:
        """Prior of all coefficients, row by row; None if the model has none."""
        if self.model.ridge is None and self.model.shrink is None:
            return None
        count, width = self.columns.shape[1], self.y.shape[1]
        share = np.full(count, np.inf)
        inputs, terms = len(self.terms.inputs), len(self.terms.labels)
        share[:inputs] = np.inf if self.model.ridge is None else self.model.ridge
        share[inputs:terms] = np.inf if self.model.shrink is None else self.model.shrink
        rms = np.sqrt(np.mean(self.columns**2, 0))
        size = np.sqrt(np.mean(self.y**2, 0))
        information = (rms / (share * np.where(size > 0, size, 1.0)[:, None])) ** 2
        return Prior(np.zeros(width * count), np.diag(information.ravel()))


def fit_calibration(table: LoadTable, model: CalibrationModel | None = None) -> Calibration:
    """Return the calibration of a table of loads.

    Raises UndeterminedCalibrationError, naming what is missing, if loads or signals do not determine it. Raises
    ValueError if the estimator needs an undeclared covariance, or a covariate that the table lacks.
    """
    problem = _CalibrationTable(model or CalibrationModel(), table)
    _check(problem)
    if problem.model.estimator == "errors in both":
        return _fit_with_both_errors(problem)
    prior = problem.prior()
    if problem.model.estimator == "weighted":
        cov = _declared_covariance(problem, 0)
        if np.linalg.eigvalsh(cov).min() <= 0:
            raise ValueError("found a response that is exactly known, expected an error of each, or errors in both")
        fit = _with_errors_of_zeros(problem, weighted_fit(problem.columns, problem.y, cov, prior))
    elif prior is not None:
        fit = weighted_fit(problem.columns, problem.y, _first_noise(problem), prior)
    else:
        fit = least_squares_fit(problem.columns, problem.y)
    return _result(problem, fit)


def _with_errors_of_zeros(problem: _CalibrationTable, fit: LinearFit) -> LinearFit:
    """Return a fit of signals to loads whose covariance holds the errors of the zeros that were subtracted.

    The error of a run's zero is common to its loaded rows, and such rows determine less than independent ones.
    """
    table, cov = problem.table, problem.table.signal_cov
    if problem.direct or table.zeros is None or table.zero_share is None or cov is None or problem.prior():
        return fit
    member = (table.zeros[:, None] == np.unique(table.zeros)) * table.zero_share[:, None]
    inverse, _ = _scaled_inverse(problem.columns)
    shifted = member.T @ problem.columns @ inverse  # change of the coefficients by one sigma of each zero
    return replace(fit, covariance=fit.covariance + np.kron(cov, shifted.T @ shifted))


def _check(problem: _CalibrationTable) -> None:
    model, table = problem.model, problem.table
    if (model.drift or model.gain) and not table.covariate_names:
        raise ValueError(f"model {model.name!r} needs a covariate such as a temperature, found none in the table")
    if model.ridge is None and model.shrink is None and len(problem.y) <= problem.columns.shape[1]:
        raise UndeterminedCalibrationError(
            f"found {len(problem.y)} rows for {problem.columns.shape[1]} terms of each component, expected more rows"
        )
    check_loads(table.loads, table.load_names)
    if model.ridge is not None:
        return
    if problem.direct:
        check_signals(table.signals, table.signal_cov, table.signal_names)
    if model.shrink is None:
        check_determined(problem.columns, problem.labels, "the terms are not independent")


def _declared_covariance(problem: _CalibrationTable, which: int) -> NDArray:
    """Return the declared covariance of the response (0) or the inputs (1)."""
    cov = problem.covariances[which]
    if cov is None:
        of_loads = problem.direct == (which == 0)
        raise ValueError(
            f"estimator {problem.model.estimator!r} needs the covariance of the {'loads' if of_loads else 'signals'}, "
            "found none declared"
        )
    return cov


def _first_noise(problem: _CalibrationTable) -> NDArray:
    """Return the noise (W, W) of a fit to inputs and zeros alone, to weight data against a prior."""
    declared = problem.covariances[0]
    if declared is not None and np.linalg.eigvalsh(declared).min() > 0:
        return declared
    inputs = len(problem.terms.inputs)
    columns = np.delete(problem.columns, np.s_[inputs : len(problem.terms.labels)], axis=1)
    values, _, rank, _ = np.linalg.lstsq(columns / np.linalg.norm(columns, axis=0), problem.y, rcond=1e-8)
    residual = problem.y - columns / np.linalg.norm(columns, axis=0) @ values
    return np.asarray(residual.T @ residual / max(len(columns) - int(rank), 1))


def _result(
    problem: _CalibrationTable, linear_fit: LinearFit, status: SolverStatus = SolverStatus.CONVERGED
) -> Calibration:
    terms = len(problem.terms.labels)
    return Calibration(
        model=problem.model,
        terms=problem.terms,
        response_names=problem.response_names,
        matrix=linear_fit.matrix[:, :terms],
        zeros=linear_fit.matrix[:, terms:],
        covariance=linear_fit.covariance,
        residuals=problem.y - problem.columns @ linear_fit.matrix.T,
        noise=linear_fit.noise,
        chi_square=linear_fit.chi_square,
        dof=linear_fit.dof,
        status=status,
    )


def _fit_with_both_errors(problem: _CalibrationTable) -> Calibration:
    """Return the maximum-likelihood fit with errors in response and inputs, starting from the weighted one."""
    rows, width, count = len(problem.y), problem.y.shape[1], problem.x.shape[1]
    response_cov, input_cov = _declared_covariance(problem, 0), _declared_covariance(problem, 1)
    cov = np.zeros((rows, width + count, width + count))
    cov[:, :width, :width], cov[:, width:, width:] = response_cov, input_cov
    prior = problem.prior()
    spread = np.linalg.eigvalsh(response_cov).min() > 0  # exactly known loads have no weighted fit as a start
    columns, y = problem.columns, problem.y
    start = weighted_fit(columns, y, response_cov, prior) if spread else least_squares_fit(columns, y)
    equations = TermEquations(problem.terms, problem.y, problem.x, problem.table.covariates, problem.zeros)
    fit = fit_errors_in_variables(equations.constrain, cov, start.matrix.ravel(), prior, robust=False)
    matrix = fit.values.reshape(width, -1)
    residuals = problem.y - problem.columns @ matrix.T
    dof = float(rows * width - len(fit.values))
    noise = residuals.T @ residuals / max(dof / width, 1.0)
    return _result(problem, LinearFit(matrix, fit.covariance, noise, fit.cost, dof), fit.status)


@dataclass(frozen=True)
class Equations:
    """Equations (N, W) with their derivatives by deviations (N, W, W + C) and by values (N, W, W Q)."""

    value: NDArray
    by_deviation: NDArray
    by_values: NDArray


@dataclass(frozen=True)
class TermEquations:
    """``0 = y + d_y - B [terms(x + d_x, z), zero]`` in every row; values are B (W, Q) row by row.

    response y (N, W), inputs x (N, C), covariates z (N, K), zeros (N, G): columns of the zeros.
    """

    terms: Terms
    response: NDArray
    inputs: NDArray
    covariates: NDArray
    zeros: NDArray

    def constrain(self, values: NDArray, deviation: NDArray) -> Equations:
        """Return the equations at values (W Q,) and deviations (N, W + C), those of the response first."""
        rows, width = self.response.shape
        matrix = values.reshape(width, -1)
        x = self.inputs + deviation[:, width:]
        columns = np.concatenate([self.terms.at(x, self.covariates), self.zeros], axis=1)
        slope = matrix[:, : columns.shape[1] - self.zeros.shape[1]] @ self.terms.by_inputs(x, self.covariates)
        identity = np.broadcast_to(np.eye(width), (rows, width, width))
        by_values = -identity[..., None] * columns[:, None, None]
        return Equations(
            self.response + deviation[:, :width] - columns @ matrix.T,
            np.concatenate([identity, -slope], axis=2),
            by_values.reshape(rows, width, -1),
        )


@dataclass(frozen=True)
class LinearFit:
    """B (W, Q), covariance (W Q, W Q), estimated noise (W, W) of one row; chi_square under the declared noise with
    freedom dof (both of the residuals alone if none was declared)."""

    matrix: NDArray
    covariance: NDArray
    noise: NDArray
    chi_square: float
    dof: float


def least_squares_fit(columns: NDArray, response: NDArray, cov: NDArray | None = None) -> LinearFit:
    """Return the fit with equal weights, ``B = Y^T X (X^T X)^-1``, by default with the noise of the residuals.

    cov (W, W): declared covariance of every row's response, without influence on B. Solved by QR of the columns scaled
    to unit length, not by that inverse. Needs more rows than columns.
    """
    spare = len(columns) - columns.shape[1]
    inverse, root = _scaled_inverse(columns)
    matrix = (root @ response).T
    residual = response - columns @ matrix.T
    noise = residual.T @ residual / max(spare, 1)
    if cov is None:
        return LinearFit(matrix, np.kron(noise, inverse), noise, float(np.trace(residual.T @ residual)), float(spare))
    squares = float(np.sum(np.linalg.solve(cov, residual.T) * residual.T))
    return LinearFit(matrix, np.kron(cov, inverse), noise, squares, float(spare * response.shape[1]))


def _scaled_inverse(columns: NDArray) -> tuple[NDArray, NDArray]:
    """Return (X^T X)^-1 (Q, Q) and its product with X^T (Q, N)."""
    scale = np.linalg.norm(columns, axis=0)
    Q, R = np.linalg.qr(columns / scale)
    back = np.linalg.inv(R) / scale[:, None]
    return back @ back.T, back @ Q.T


def weighted_fit(columns: NDArray, response: NDArray, cov: NDArray, prior: Prior | None = None) -> LinearFit:
    """Return the fit with covariances cov (N, W, W) or (W, W) of the responses, and a prior of the coefficients.

    The covariance is that of declared noise; ``noise`` is estimated from the residuals.
    """
    rows, width = response.shape
    if prior is None and cov.ndim == 2:
        return least_squares_fit(columns, response, cov)
    # With equal weights, all that the rows tell is the triangular factor, and the response along its basis.
    basis, orthonormal = np.linalg.qr(columns) if cov.ndim == 2 else (None, columns)
    along = response if basis is None else basis.T @ response
    factor = np.linalg.inv(np.linalg.cholesky(np.broadcast_to(cov, (len(orthonormal), width, width))))
    products = np.einsum("nwi,nq->nwiq", factor, orthonormal).reshape(len(orthonormal) * width, -1)
    target = np.einsum("nwi,ni->nw", factor, along).ravel()
    beyond = 0.0 if basis is None else float(np.sum(((response - basis @ along) @ factor[0].T) ** 2))
    equations = rows * width
    if prior is not None:
        root = _root(prior.information)
        products, target = np.concatenate([products, root]), np.concatenate([target, root @ prior.mean])
        equations += len(root)
    covariance, solve = _scaled_inverse(products)
    values = solve @ target
    matrix = values.reshape(width, -1)
    residual = response - columns @ matrix.T
    squares = float(np.sum((target - products @ values) ** 2)) + beyond
    dof = float(equations - len(values))
    return LinearFit(matrix, covariance, residual.T @ residual / max(dof / width, 1.0), squares, dof)


def _root(information: NDArray) -> NDArray:
    """Return rows (r, P) whose products add up to an information (P, P) that may be singular."""
    strength, axes = np.linalg.eigh(information)
    mask = strength > 1e-14 * max(strength[-1], 0.0)
    return np.sqrt(strength[mask])[:, None] * axes[:, mask].T
