"""The matrix of a force sensor, loads told by it, and its held-out accuracy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.common.recorded_signals import ranges_of, recorded
from stages.uncertainty_statement.found_causes import found_causes
from stages.uncertainty_statement.statement import Statement
from truing.estimation.sensor.calibrate import fit_calibration
from truing.estimation.sensor.calibration import Calibration
from truing.estimation.sensor.calibration_matrix import MatrixEstimate, calibration_matrix, wrenches
from truing.estimation.sensor.contenders import by_cases, contenders
from truing.estimation.sensor.held_out_loads import covariance_by_case, hold_out
from truing.estimation.sensor.load_table import LoadTable
from truing.estimation.sensor.recorded_signals import Recorded
from truing.estimation.uncertainty_budget import NOT_HELD, Budget, Source, budget, linear_estimate

if TYPE_CHECKING:
    import pyarrow as pa

    from schemas.campaign import Campaign

Array = NDArray[np.float64]

BY_LOADS = Source("applied loads, as declared", "B")
_BY_CHANCE = 0.01
_UNITS = ("N", "N", "N", "N m", "N m", "N m")


@dataclass(frozen=True)
class _Calibrated:
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


def state_sensor(statement: Statement, tables: Mapping[str, pa.Table], settings: Campaign) -> None:
    """State the entries of G_B, the loads that one reading at full range tells, and errors of held-out loads."""
    name = _chosen(tables)
    if name is None:
        if settings.campaign.kind == "interferometer" and "positions" not in tables:
            statement.not_evaluated("G_B", "all", "no signals were calibrated")
        return
    try:
        made = _calibrated(tables, settings, name)
    except (ValueError, np.linalg.LinAlgError) as why:
        statement.not_evaluated("G_B", "all", f"the calibration cannot be made once more: {why}")
        return
    _matrix(statement, made)
    _loads(statement, made, ranges_of(settings, made.found))
    _held_out(statement, made)
    if not made.found.load_sigma.any():
        for result in ("G_B", "load"):
            statement.omitted(result, "applied loads", "[noise] declares neither load_n nor load_nm")
    if made.found.covariate_names == ():
        statement.omitted("G_B", "temperature of the sensor", "it was not recorded, or did not change")
    for name in found_causes(tables):
        if " signal " in f"{name} ":
            for result in ("G_B", "load"):
                statement.omitted(result, name, NOT_HELD)
    for cause in made.found.causes:
        statement.omitted("G_B", f"size of {cause}", "loads are taken as the diagnosis has them, its size as exact")


def _chosen(tables: Mapping[str, pa.Table]) -> str | None:
    table = tables.get("sensor_matrix")
    rows = [] if table is None else table.to_pylist()
    return next((row["model"] for row in rows if row["chosen"] and row["matrix"] == "G_B"), None)


def _calibrated(tables: Mapping[str, pa.Table], settings: Campaign, name: str) -> _Calibrated:
    found = recorded(tables, settings)
    model = next(model for model in contenders(found) if model.name == name)
    table, _ = by_cases(found, ~found.steps.held_out)
    fit = fit_calibration(table, model)
    spare = float(max(len(table.signals) - fit.matrix.shape[1], 1))
    declared = settings.noise.signal_mv is not None
    signals = Source("noise of the signals", "B") if declared else Source("noise of the signals", "A", spare)
    parts = _parts(fit, table, signals)
    return _Calibrated(found, table, fit, parts, covariance_by_case(table, model), signals)


def _parts(fit: Calibration, table: LoadTable, signals: Source) -> dict[Source, Array]:
    """The covariance of all coefficients, row by row, that each source gives."""
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


def _of_matrix(made: _Calibrated) -> dict[Source, Array]:
    """The covariance of the entries of G_B, row by row, that each source gives."""
    return {
        source: calibration_matrix(replace(made.fit, covariance=part), made.table.signal_cov).covariance
        for source, part in made.parts.items()
    }


def _matrix(statement: Statement, made: _Calibrated) -> None:
    matrix = calibration_matrix(made.fit, made.table.signal_cov)
    told = budget(_of_matrix(made))
    more = made.beyond_chance(np.diag(made.by_case.covariance), told.standard**2)
    rows, columns = (index.ravel() for index in np.indices(matrix.value.shape))
    names = [f"{made.table.load_names[i]} per {made.table.signal_names[j]}" for i, j in zip(rows, columns, strict=True)]
    units = [f"{_UNITS[i]}/mV" for i in rows]
    told = told.beside(made.cases, more).filled()
    statement.state("G_B", made.fit.model.name, names, matrix.value.ravel(), units, told)


def _loads(statement: Statement, made: _Calibrated, ranges: Array) -> None:
    """State each load at its full range, as one reading of the signals tells it."""
    fit, table = made.fit, made.table
    axes = np.flatnonzero(np.isfinite(ranges))
    loads = np.diag(ranges)[axes]
    none = np.zeros((len(axes), table.covariates.shape[1]))
    if fit.model.direction == "forward":
        signals = fit.predict(loads, none)
    else:
        signals = loads @ np.linalg.pinv(fit.matrix[:, : len(fit.terms.inputs)]).T
    noise = np.zeros((signals.shape[1],) * 2) if table.signal_cov is None else table.signal_cov
    found = wrenches(fit, signals, none, noise)
    own = np.arange(len(axes)), axes, axes
    reading = Source("noise of the signals, in the one reading", made.signals.evaluation, made.signals.dof)
    parts = {reading: found.own[own]}
    for source, part in made.parts.items():
        by_part = replace(found, own=np.zeros_like(found.own), coefficients=part).covariance
        parts[Source(f"calibration: {source.name}", source.evaluation, source.dof)] = by_part[own]
    told = Budget(tuple(parts), np.sqrt(np.maximum(np.array(list(parts.values())), 0.0)))
    width = made.by_case.value.shape[1]
    blocks = made.by_case.covariance.reshape(-1, width, len(table.load_names), width)
    by_case = np.einsum("nc,ncd,nd->n", signals, blocks[axes, :, axes], signals)
    calibration = told.standard**2 - parts[reading]
    told = told.beside(made.cases, made.beyond_chance(by_case, calibration)).filled()
    names = [table.load_names[k] for k in axes]
    subject = [f"one reading at {ranges[k]:g} {_UNITS[k]} of {table.load_names[k]}" for k in axes]
    statement.state("load", subject, names, found.value[np.arange(len(axes)), axes], [_UNITS[k] for k in axes], told)


def _held_out(statement: Statement, made: _Calibrated) -> None:
    """State the rms error of loads whose case the calibration has not seen."""
    errors, cases = hold_out(made.table, made.fit.model).errors, made.table.cases
    if len(cases) < 2:
        statement.not_evaluated("accuracy", "all", "there is one load case alone, and none to hold out")
        return
    share = np.stack([np.sum(errors[made.table.case == case] ** 2, 0) for case in cases]) * len(cases) / len(errors)
    value = np.sqrt(share.mean(0))
    own = np.std(share, axis=0, ddof=1) / np.sqrt(len(cases)) / (2.0 * np.where(value > 0.0, value, 1.0))
    source = Source("scatter from load case to load case", "A", float(len(cases) - 1))
    names = [f"{name}, rms" for name in made.table.load_names]
    statement.state("accuracy", "held-out load cases", names, value, list(_UNITS), Budget((source,), own[None]))
