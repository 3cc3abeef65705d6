"""Uncertainty budgets of a sensor's calibration: of G_B, of loads from one reading, and of held-out loads.

Scatter between load cases that the other sources do not explain is a source of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truing.arrays import Array, Index
from truing.estimation.sensor.calibrate import fit_calibration
from truing.estimation.sensor.calibration import Calibration, MatrixEstimate, calibration_matrix, wrenches
from truing.estimation.sensor.contenders import by_cases, contenders, covariance_by_case, hold_out
from truing.estimation.sensor.load_table import LoadTable, RecordedLoads
from truing.estimation.uncertainty_budget import Budget, Source, budget, linear_estimate

BY_LOADS = Source("applied loads, as declared", "B")
_BY_CHANCE = 0.01


@dataclass(frozen=True)
class Calibrated:
    """The chosen calibration, its table, and the covariance of its coefficients by source and between cases."""

    found: RecordedLoads
    table: LoadTable
    fit: Calibration
    parts: dict[Source, Array]
    by_case: MatrixEstimate
    signals: Source

    @property
    def cases(self) -> Source:
        """Source for differences between load cases beyond the noise."""
        return Source("differences between load cases beyond that", "A", float(len(self.table.cases) - 1))

    def beyond_chance(self, by_case: Array, stated: Array) -> Array:
        """Return the standard uncertainties (N,) of load cases in excess of the budget; zero if within chance."""
        from scipy.special import chdtri

        freedom = len(self.table.cases) - 1
        limit = chdtri(freedom, _BY_CHANCE / len(stated)) / freedom if freedom > 0 else np.inf
        return np.sqrt(np.where(by_case > limit * stated, by_case - stated, 0.0))


def coefficient_parts(fit: Calibration, table: LoadTable, signals: Source) -> dict[Source, Array]:
    """Return the covariance of all coefficients, row by row, due to each source; signals: the source of their noise."""
    from scipy.special import chdtrc

    model, direct = fit.model, fit.model.direction == "direct"
    dof = fit.dof * (1.0 if model.estimator == "least squares" else 1.0 / len(fit.matrix))
    if model.estimator == "least squares" or model.ridge is not None or model.shrink is not None:
        return {Source("scatter of the loads about the calibration", "A", max(dof, 1.0)): fit.covariance}
    x, covariance = (table.signals, table.load_cov) if direct else (table.loads, table.signal_cov)
    columns = fit.columns(x, table.covariates)
    of_own, of_other = (BY_LOADS, signals) if direct else (signals, BY_LOADS)
    if model.estimator == "weighted":
        parts = {of_own: fit.covariance}
        input_cov = (
            table.load_cov if not direct else None
        )  # the weights of a direct fit do not include errors of signals
        if input_cov is not None and np.any(input_cov):
            slope = fit.matrix[:, : len(fit.terms.inputs)]
            parts[of_other] = np.kron(slope @ input_cov @ slope.T, np.linalg.inv(columns.T @ columns))
    else:
        slope = fit.matrix @ fit.terms.by_inputs(x, table.covariates)
        input_cov = table.signal_cov if direct else table.load_cov
        assert covariance is not None, "errors in both need a covariance of either"
        assert input_cov is not None
        jacobian = np.einsum("wi,nq->nwiq", np.eye(len(fit.matrix)), columns).reshape(len(x), len(fit.matrix), -1)
        rows = np.zeros((len(x), 1, 1))
        parts = linear_estimate(
            jacobian, {of_own: rows + covariance, of_other: slope @ input_cov @ np.swapaxes(slope, 1, 2)}
        )
        total = sum(parts.values(), np.zeros(()))
        # Scales the linear result to the fit with estimated deviations.
        size = np.sqrt(np.diag(fit.covariance) / np.diag(total))
        parts = {source: part * np.outer(size, size) for source, part in parts.items()}
    if fit.dof > 0 and chdtrc(fit.dof, fit.chi_square) < _BY_CHANCE:
        beyond = Source("scatter of the calibration beyond that", "A", fit.dof)
        parts[beyond] = (fit.noise_ratio**2 - 1.0) * sum(parts.values(), np.zeros(()))
    return parts


def recalibrated(recorded_loads: RecordedLoads, name: str, declared: bool) -> Calibrated:
    """Return the calibration by the model of a name, with the contribution of each source.

    declared: whether the noise of signals was declared. Raises UndeterminedCalibrationError as
    `contenders.calibrations`.
    """
    model = next(model for model in contenders(recorded_loads) if model.name == name)
    table, _ = by_cases(recorded_loads, ~recorded_loads.steps.held_out)
    fit = fit_calibration(table, model)
    spare = float(max(len(table.signals) - fit.matrix.shape[1], 1))
    signals = Source("noise of the signals", "B") if declared else Source("noise of the signals", "A", spare)
    parts = coefficient_parts(fit, table, signals)
    return Calibrated(recorded_loads, table, fit, parts, covariance_by_case(table, model), signals)


def budget_of_matrix(made: Calibrated) -> tuple[Array, Budget]:
    """Return G_B (W, C), N or N m per unit of signal, and the budget of its entries row by row."""
    cov = made.table.signal_cov
    parts = {
        source: calibration_matrix(replace(made.fit, covariance=part), cov).covariance
        for source, part in made.parts.items()
    }
    stated = budget(parts)
    more = made.beyond_chance(np.diag(made.by_case.covariance), stated.standard**2)
    return calibration_matrix(made.fit, cov).value, stated.with_source(made.cases, more).filled()


def budget_of_loads(made: Calibrated, loads: Array, axes: Index) -> tuple[Array, Budget]:
    """Return loads (N,), each along one axis (N,) of loads (N, W), from a single reading of the signals, with their
    budget."""
    fit, table = made.fit, made.table
    none = np.zeros((len(axes), table.covariates.shape[1]))
    if fit.model.direction == "forward":
        signals = fit.predict(loads, none)
    else:
        signals = loads @ np.linalg.pinv(fit.matrix[:, : len(fit.terms.inputs)]).T
    noise = np.zeros((signals.shape[1],) * 2) if table.signal_cov is None else table.signal_cov
    estimated = wrenches(fit, signals, none, noise)
    diagonal = np.arange(len(axes)), axes, axes
    reading = Source("noise of the signals, in the one reading", made.signals.evaluation, made.signals.dof)
    parts = {reading: estimated.own[diagonal]}
    for source, part in made.parts.items():
        by_part = replace(estimated, own=np.zeros_like(estimated.own), coefficients=part).covariance
        parts[Source(f"calibration: {source.name}", source.evaluation, source.dof)] = by_part[diagonal]
    stated = Budget(tuple(parts), np.sqrt(np.maximum(np.array(list(parts.values())), 0.0)))
    width = made.by_case.value.shape[1]
    blocks = made.by_case.covariance.reshape(-1, width, len(table.load_names), width)
    by_case = np.einsum("nc,ncd,nd->n", signals, blocks[axes, :, axes], signals)
    more = made.beyond_chance(by_case, stated.standard**2 - parts[reading])
    return estimated.value[diagonal[:2]], stated.with_source(made.cases, more).filled()


def rms_of_held_out(made: Calibrated) -> tuple[Array, Budget] | None:
    """Return the rms errors (W,) of loads in held-out cases, with their budget; None for a single case."""
    errors, cases = hold_out(made.table, made.fit.model).errors, made.table.cases
    if len(cases) < 2:
        return None
    share = np.stack([np.sum(errors[made.table.case == case] ** 2, 0) for case in cases]) * len(cases) / len(errors)
    value = np.sqrt(share.mean(0))
    standard_error = np.std(share, axis=0, ddof=1) / np.sqrt(len(cases)) / (2.0 * np.where(value > 0.0, value, 1.0))
    source = Source("scatter from load case to load case", "A", float(len(cases) - 1))
    return value, Budget((source,), standard_error[None])
