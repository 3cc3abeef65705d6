"""Errors and figures of calibrations as table rows, and which one suits the campaign."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from truing.calibration.accuracy import ARCSEC, PoseErrors
from truing.calibration.choice import Figure, Judged, error_figures, fit_figures
from truing.calibration.extended import ESTIMATOR, MODEL, Extended
from truing.calibration.fits import MAXIMUM_LIKELIHOOD
from truing.calibration.measured import Measured
from truing.estimation.held_out import Choice
from truing.simulation.mechanisms.structures.catalogue import departure, structures
from truing.simulation.mechanisms.structures.structure import Machine
from truing.stages.calibration.extended import extended_figures
from truing.stages.common.rows import Rows


def choice_rows(judged: Sequence[Judged], roles: NDArray, made: Choice) -> Rows:
    """Return the figures of every calibration; ``made`` concerns those by maximum likelihood, which come first."""
    rows = Rows("model_choice")
    for i, one in enumerate(judged):
        likely = one.calibration.estimator == MAXIMUM_LIKELIHOOD
        figures = [*error_figures(one.errors, roles), *fit_figures(one)]
        if likely:
            figures.append(("chosen", float(i == made.chosen), "1"))
            figures.append(("indistinguishable", float(made.indistinguishable[i]), "1"))
        _add(
            rows,
            one.calibration.case.structure.name,
            one.calibration.case.deformation,
            one.calibration.estimator,
            figures,
        )
    return rows


def nominal_rows(model: str, errors: PoseErrors, roles: NDArray) -> Rows:
    """Return the figures of the machine before any calibration."""
    rows = Rows("model_choice")
    _add(rows, model, "none", "nominal", error_figures(errors, roles))
    return rows


def extended_choice_rows(extended: Extended, roles: NDArray) -> Rows:
    """Return the figures of the extended model, which was fitted to other data and is not among those chosen from."""
    rows = Rows("model_choice")
    figures = [*error_figures(extended.errors, roles), *extended_figures(extended)]
    _add(rows, MODEL, extended.deformation, ESTIMATOR, figures)
    return rows


def departure_rows(machine: Machine, readings: NDArray) -> Rows:
    """Return how far every other model of the structure departs from rigid legs, over the campaign's own readings."""
    rows = Rows("model_choice")
    for structure in structures(machine)[1:]:
        found = departure(structure, machine, readings) * 1e6
        told = found[np.isfinite(found)]
        if len(told):
            figures = [
                ("reading_rms_from_rigid_legs", float(np.sqrt(np.mean(told**2))), "um"),
                ("reading_max_from_rigid_legs", float(np.max(np.abs(told))), "um"),
            ]
            _add(rows, structure.name, "none", "nominal", figures)
    return rows


def _add(rows: Rows, model: str, deformation: str, estimator: str, figures: Sequence[Figure]) -> None:
    for name, value, unit in figures:
        rows.add(model=model, deformation=deformation, estimator=estimator, figure=name, value=value, unit=unit)


def accuracy_rows(artifact: str, told: Sequence[tuple[tuple[str, str], PoseErrors]], measured: Measured) -> Rows:
    """Return the errors of all models, (model, deformation) each, as rows of accuracy.parquet or its like."""
    rows = Rows(artifact)
    parts = ("dx_um", "dy_um", "dz_um", "rx_arcsec", "ry_arcsec", "rz_arcsec")
    units = np.array([1e-6] * 3 + [ARCSEC] * 3)
    for (model, deformation), found in told:
        kept = np.isfinite(found.error).all(-1)
        rows.add(
            model=model,
            deformation=deformation,
            pose=[pose for pose, good in zip(measured.poses, kept, strict=True) if good],
            role=measured.roles[kept],
            position_error_um=found.position[kept] * 1e6,
            orientation_error_arcsec=found.orientation[kept] / ARCSEC,
            **{name: found.error[kept, i] / units[i] for i, name in enumerate(parts)},
            position_noise_um=found.expected(0)[kept] * 1e6,
            orientation_noise_arcsec=found.expected(3)[kept] / ARCSEC,
        )
    return rows
