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
    found = np.zeros((2, leg.max() + 1, column.max() + 1))
    found[0, leg, column], found[1, leg, column] = (number_column(table, name) for name in ("coefficient", "sigma"))
    return found[0], found[1]


def compared(found: AttachmentModels, shifts: LegShifts, given: tuple[Array, Array]) -> MatrixComparison | None:
    """The measured K against the simulated one, in the legs whose row is determined; None where K is not known.

    K modulo a plane is not compared: poses that leave out different targets have different planes.
    """
    if "matrix" not in found.fits or shifts.modulo_plane:
        return None
    fit, rows = found.fits["matrix"], found.determined["matrix"]
    covariance = birge(fit) ** 2 * fit.covariance
    return compare_matrices(fit.coefficients, covariance, *given, rows, shifts.attachments[:, :2])


def simulated_fit(drive: Array, found: AttachmentModels, shifts: LegShifts, simulated: Array) -> ResponseFit:
    """Residuals of the fitted shifts by the simulated K, with the offset of the survey alone."""
    fitted = found.fitted
    left = found.kept[fitted] - drive[fitted] @ simulated.T
    return fit_response(drive[fitted], left, shifts.noise[fitted], form="none", offset_cov=shifts.survey)


def entry_rows(one: MatrixComparison | None) -> Rows:
    """Every compared entry: measured, simulated, and whether they differ beyond chance over all entries."""
    from scipy.special import ndtr

    rows = Rows("simulated_deformation")
    if one is None:
        return rows
    leg, column = np.nonzero(one.sigma > 0.0)
    pull = one.difference[leg, column] / one.sigma[leg, column]
    differs = holm_significant(2.0 * ndtr(-np.abs(pull)), FALSE_ALARM)
    rows.add(
        leg=leg + 1,
        column=column + 1,
        measured=one.measured[leg, column],
        sigma=one.measured_sigma[leg, column],
        simulated=one.simulated[leg, column],
        simulated_sigma=one.simulated_sigma[leg, column],
        difference=one.difference[leg, column],
        pull=pull,
        verdict=["differs" if apart else "agrees" for apart in differs],
        unit="1",
    )
    return rows


def add_comparison(rows: Rows, one: MatrixComparison) -> None:
    """Add the joint tests of a comparison to the error figures of the matrix model."""
    figures = {
        "agreement_chi_square": one.together.chi_square,
        "entries_compared": one.together.dof,
        "agreement_p_value": one.together.p_value,
        "measured_over_simulated": one.factor,
        "measured_over_simulated_sigma": one.factor_sigma,
        "scaled_p_value": one.scaled.p_value,
    }
    if one.without_plane is not None:
        figures["agreement_without_plane_p_value"] = one.without_plane.p_value
    add_figures(rows, "matrix", {name: value for name, value in figures.items() if np.isfinite(value)})


def words(one: MatrixComparison | None) -> str:
    """Number of entries that agree with the simulated ones, in words."""
    if one is None:
        return "not compared with the simulated K"
    pull = np.abs(one.difference[one.sigma > 0.0] / one.sigma[one.sigma > 0.0])
    return f"{int((pull < WITHIN).sum())} of {len(pull)} entries of K within two sigma of the simulated ones"
