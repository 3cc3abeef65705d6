"""What each source gives to a calibration of a sensor, and how far load cases differ beyond that."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.estimation.sensor.calibration import Calibration
from truing.estimation.sensor.calibration_matrix import MatrixEstimate, calibration_matrix
from truing.estimation.sensor.load_table import LoadTable
from truing.estimation.sensor.recorded_signals import Recorded
from truing.estimation.uncertainty_budget import Source, linear_estimate

Array = NDArray[np.float64]
BY_LOADS = Source("applied loads, as declared", "B")
_BY_CHANCE = 0.01


@dataclass(frozen=True)
class Calibrated:
    """The chosen calibration, its table, and the covariance of its coefficients by source; and from case to case."""

    found: Recorded
    table: LoadTable
    fit: Calibration
    parts: dict[Source, Array]
    by_case: MatrixEstimate
    signals: Source

    @property
    def cases(self) -> Source:
        """What one load case differs by from another, beyond the noise."""
        return Source("differences between load cases beyond that", "A", float(len(self.table.cases) - 1))

    def beyond_chance(self, by_case: Array, told: Array) -> Array:
        """Standard uncertainties (N,) that load cases show beyond what the budget has; zero within chance."""
        from scipy.special import chdtri

        freedom = len(self.table.cases) - 1
        limit = chdtri(freedom, _BY_CHANCE / len(told)) / freedom if freedom > 0 else np.inf
        return np.sqrt(np.where(by_case > limit * told, by_case - told, 0.0))


def coefficient_parts(fit: Calibration, table: LoadTable, signals: Source) -> dict[Source, Array]:
    """Return the covariance of all coefficients, row by row, that each source gives; signals: the source of their
    noise."""
    from scipy.special import chdtrc

    model, direct = fit.model, fit.model.direction == "direct"
    dof = fit.dof * (1.0 if model.estimator == "least squares" else 1.0 / len(fit.matrix))
    if model.estimator == "least squares" or model.ridge is not None or model.shrink is not None:
        return {Source("scatter of the loads about the calibration", "A", max(dof, 1.0)): fit.covariance}
    x, own = (table.signals, table.load_cov) if direct else (table.loads, table.signal_cov)
    columns = fit.columns(x, table.covariates)
    of_own, of_other = (BY_LOADS, signals) if direct else (signals, BY_LOADS)
    if model.estimator == "weighted":
        parts = {of_own: fit.covariance}
        other = table.load_cov if not direct else None  # what a direct fit's signals err by is in none of its weights
        if other is not None and np.any(other):
            slope = fit.matrix[:, : len(fit.terms.inputs)]
            parts[of_other] = np.kron(slope @ other @ slope.T, np.linalg.inv(columns.T @ columns))
    else:
        slope = fit.matrix @ fit.terms.by_inputs(x, table.covariates)
        other = table.signal_cov if direct else table.load_cov
        assert own is not None, "errors in both need a covariance of either"
        assert other is not None
        jacobian = np.einsum("wi,nq->nwiq", np.eye(len(fit.matrix)), columns).reshape(len(x), len(fit.matrix), -1)
        rows = np.zeros((len(x), 1, 1))
        parts = linear_estimate(jacobian, {of_own: rows + own, of_other: slope @ other @ np.swapaxes(slope, 1, 2)})
        whole = sum(parts.values(), np.zeros(()))
        size = np.sqrt(np.diag(fit.covariance) / np.diag(whole))  # the fit settles deviations, and is linear there
        parts = {source: part * np.outer(size, size) for source, part in parts.items()}
    if fit.dof > 0 and chdtrc(fit.dof, fit.chi_square) < _BY_CHANCE:
        beyond = Source("scatter of the calibration beyond that", "A", fit.dof)
        parts[beyond] = (fit.noise_ratio**2 - 1.0) * sum(parts.values(), np.zeros(()))
    return parts


def matrix_parts(made: Calibrated) -> dict[Source, Array]:
    """Return the covariance of the entries of G_B, row by row, that each source gives."""
    return {
        source: calibration_matrix(replace(made.fit, covariance=part), made.table.signal_cov).covariance
        for source, part in made.parts.items()
    }
