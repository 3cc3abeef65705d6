"""The measured deformation of a platform against the one that the user's own simulation predicts."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from truing.arrays import Array
from truing.estimation.deformation import AttachmentModels, LegShifts
from truing.estimation.matrix_comparison import MatrixComparison, compare_matrices
from truing.estimation.response import FALSE_ALARM, ResponseFit, birge, fit_response, holm_significant
from truing.stages.common.point_arrays import number_column
from truing.stages.common.rows import Rows
from truing.stages.responses.tables import add_figures

SIMULATED = "simulated"
WITHIN = 2.0  # standard deviations of an entry, of which the closing line counts those that agree


def given_deformation(table: pa.Table) -> tuple[Array, Array]:
    """The simulated K (L, L) and its standard deviations (L, L) of a long table."""
    leg, column = (number_column(table, name).astype(int) - 1 for name in ("leg", "column"))
    values = np.zeros((2, leg.max() + 1, column.max() + 1))
    values[0, leg, column], values[1, leg, column] = (number_column(table, name) for name in ("coefficient", "sigma"))
    return values[0], values[1]


def compared(models: AttachmentModels, shifts: LegShifts, simulated: tuple[Array, Array]) -> MatrixComparison | None:
    """The measured K against the simulated one, in the legs whose row is determined; None where K is not known.

    K modulo a plane is not compared: poses that leave out different targets have different planes.
    """
    if "matrix" not in models.fits or shifts.modulo_plane:
        return None
    fit, rows = models.fits["matrix"], models.determined["matrix"]
    covariance = birge(fit) ** 2 * fit.covariance
    return compare_matrices(fit.coefficients, covariance, *simulated, rows, shifts.attachments[:, :2])


def simulated_fit(drive: Array, models: AttachmentModels, shifts: LegShifts, simulated: Array) -> ResponseFit:
    """Residuals of the fitted shifts by the simulated K, with the offset of the survey alone."""
    fitted = models.fitted
    residual = models.kept[fitted] - drive[fitted] @ simulated.T
    return fit_response(drive[fitted], residual, shifts.noise[fitted], form="none", offset_cov=shifts.survey)


def entry_rows(matrix_comparison: MatrixComparison | None) -> Rows:
    """Every compared entry: measured, simulated, and whether they differ beyond chance over all entries."""
    from scipy.special import ndtr

    rows = Rows("simulated_deformation")
    if matrix_comparison is None:
        return rows
    leg, column = np.nonzero(matrix_comparison.sigma > 0.0)
    pull = matrix_comparison.difference[leg, column] / matrix_comparison.sigma[leg, column]
    differs = holm_significant(2.0 * ndtr(-np.abs(pull)), FALSE_ALARM)
    rows.add(
        leg=leg + 1,
        column=column + 1,
        measured=matrix_comparison.measured[leg, column],
        sigma=matrix_comparison.measured_sigma[leg, column],
        simulated=matrix_comparison.simulated[leg, column],
        simulated_sigma=matrix_comparison.simulated_sigma[leg, column],
        difference=matrix_comparison.difference[leg, column],
        pull=pull,
        verdict=["differs" if is_other else "agrees" for is_other in differs],
        unit="1",
    )
    return rows


def add_comparison(rows: Rows, matrix_comparison: MatrixComparison) -> None:
    """Add the joint tests of a comparison to the error figures of the matrix model."""
    figures = {
        "agreement_chi_square": matrix_comparison.together.chi_square,
        "entries_compared": matrix_comparison.together.dof,
        "agreement_p_value": matrix_comparison.together.p_value,
        "measured_over_simulated": matrix_comparison.factor,
        "measured_over_simulated_sigma": matrix_comparison.factor_sigma,
        "scaled_p_value": matrix_comparison.scaled.p_value,
    }
    if matrix_comparison.without_plane is not None:
        figures["agreement_without_plane_p_value"] = matrix_comparison.without_plane.p_value
    add_figures(rows, "matrix", {name: value for name, value in figures.items() if np.isfinite(value)})


def words(matrix_comparison: MatrixComparison | None) -> str:
    """Number of entries that agree with the simulated ones, in words."""
    if matrix_comparison is None:
        return "not compared with the simulated K"
    pull = np.abs(
        matrix_comparison.difference[matrix_comparison.sigma > 0.0]
        / matrix_comparison.sigma[matrix_comparison.sigma > 0.0]
    )
    return f"{int((pull < WITHIN).sum())} of {len(pull)} entries of K within two sigma of the simulated ones"
