"""The calibration matrix G_B, from signals to a wrench, of a fit in either direction; and wrenches by it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.covariance import symmetric
from truing.estimation.sensor.calibration import Calibration

_ROUNDS, _SETTLED = 30, 1e-10


@dataclass(frozen=True)
class MatrixEstimate:
    """A matrix (W, C) and the covariance (W C, W C) of its entries, row by row."""

    value: NDArray
    covariance: NDArray

    @property
    def sigma(self) -> NDArray:
        """Return the standard deviation (W, C) of every entry."""
        return np.sqrt(np.diag(self.covariance)).reshape(self.value.shape)


def calibration_matrix(fit: Calibration, signal_cov: NDArray | None = None) -> MatrixEstimate:
    """Return G_B (W, C), N or N m per unit of signal, of the terms in signals or loads alone.

    A forward fit V = A F is inverted with the least noise, ``G = (A^T S^-1 A)^-1 A^T S^-1``, S = signal_cov (C, C), by
    default the fit's own noise; its error follows by ``dG = -G dA G + (A^T S^-1 A)^-1 dA^T S^-1 (1 - A G)``.
    """
    if fit.model.direction == "direct":
        return _inputs_part(fit)
    sensitivity = _inputs_part(fit)
    A = sensitivity.value
    white = np.linalg.inv(fit.noise if signal_cov is None else signal_cov)
    spread = np.linalg.inv(A.T @ white @ A)
    G = spread @ A.T @ white
    rest = white @ (np.eye(len(A)) - A @ G)
    # by dA[c, w]: -G[:, c] G[w, :] + spread[:, w] rest[c, :]
    change = -np.einsum("ic,wj->ijcw", G, G) + np.einsum("iw,cj->ijcw", spread, rest)
    change = change.reshape(G.size, A.size)
    return MatrixEstimate(G, symmetric(change @ sensitivity.covariance @ change.T))


def _inputs_part(fit: Calibration) -> MatrixEstimate:
    """Return the coefficients of the inputs themselves."""
    width, count = len(fit.matrix), len(fit.terms.inputs)
    blocks = fit.covariance.reshape(width, -1, width, fit.covariance.shape[0] // width)
    part = blocks[:, :count, :, :count].reshape(width * count, -1)
    return MatrixEstimate(fit.matrix[:, :count], part)


@dataclass(frozen=True)
class Wrenches:
    """Wrenches (N, W) told by signals, and what their errors come from.

    own (N, W, W): covariance by the signals' errors, independent from row to row. gain (N, W, R): how an error of the
    fitted response moves a wrench; columns (N, Q) and coefficients (R Q, R Q): that of the calibration itself.
    """

    value: NDArray
    own: NDArray
    gain: NDArray
    columns: NDArray
    coefficients: NDArray

    @property
    def joint(self) -> NDArray:
        """Return the covariance (N, W, N, W) that the calibration's error gives all rows together."""
        by = np.einsum("nwr,nq->nwrq", self.gain, self.columns).reshape(*self.value.shape, -1)
        return np.einsum("nwc,cd,mvd->nwmv", by, self.coefficients, by, optimize=True)

    @property
    def covariance(self) -> NDArray:
        """Return the whole covariance (N, W, W) of each row."""
        responses = self.gain.shape[2]
        blocks = self.coefficients.reshape(responses, self.columns.shape[1], responses, -1)
        of_response = np.einsum("np,ipjq,nq->nij", self.columns, blocks, self.columns, optimize=True)
        return self.own + self.gain @ of_response @ np.swapaxes(self.gain, 1, 2)


class UnreachedSignalsError(ValueError):
    """Signals that a calibration from loads to signals gives at no load."""


def wrenches(fit: Calibration, signals: NDArray, covariates: NDArray, signal_cov: NDArray) -> Wrenches:
    """Return the wrenches that signals (N, C) with errors of covariance signal_cov (C, C) tell.

    A forward fit is inverted by Gauss-Newton steps from zero load; raises UnreachedSignalsError where they do not
    settle.
    """
    if fit.model.direction == "forward":
        return _inverted(fit, signals, covariates, signal_cov)
    slope = fit.matrix @ fit.terms.by_inputs(signals, covariates)
    value = fit.predict(signals, covariates)
    gain = np.broadcast_to(np.eye(value.shape[1]), (*value.shape, value.shape[1]))
    own = slope @ signal_cov @ np.swapaxes(slope, 1, 2)
    return Wrenches(value, own, gain, fit.columns(signals, covariates), fit.covariance)


def _inverted(fit: Calibration, signals: NDArray, covariates: NDArray, signal_cov: NDArray) -> Wrenches:
    white = np.linalg.inv(signal_cov)
    loads = np.zeros((len(signals), len(fit.terms.inputs)))
    for _ in range(_ROUNDS):
        slope = fit.matrix @ fit.terms.by_inputs(loads, covariates)
        weighted = np.swapaxes(slope, 1, 2) @ white
        gain = np.linalg.solve(weighted @ slope, weighted)
        step = np.einsum("nwc,nc->nw", gain, signals - fit.predict(loads, covariates))
        loads = loads + step
        if np.all(np.abs(step) <= _SETTLED * np.abs(loads).max(initial=0.0)):
            break
    else:
        raise UnreachedSignalsError(f"found signals that no load gives, inverting {fit.model.name!r}")
    own = gain @ signal_cov @ np.swapaxes(gain, 1, 2)
    return Wrenches(loads, own, gain, fit.columns(loads, covariates), fit.covariance)
