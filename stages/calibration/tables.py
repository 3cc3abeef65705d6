"""Identified parameters and their correlations as table rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stages.calibration.fits import Calibration
from stages.responses.tables import Rows
from truing.simulation.parameters import SHARED, Parameter

# Pairs of parameters less correlated than this are not told.
LEAST_CORRELATION = 0.05


def parameter_rows(artifact: str, calibrations: Sequence[Calibration]) -> Rows:
    """Return every identified parameter of every calibration, in the units of the tables."""
    rows = Rows(artifact)
    for calibration in calibrations:
        entries, units = calibration.parameters.entries, calibration.parameters.units
        rows.add(
            model=calibration.case.structure.name,
            deformation=calibration.case.deformation,
            leg=[_leg(entry) for entry in entries],
            parameter=[entry.name for entry in entries],
            unit=[entry.unit for entry in entries],
            nominal=calibration.nominal / units,
            identified=calibration.values / units,
            sigma=calibration.sigma / units,
            tolerance=calibration.tolerance / units,
            pull=calibration.pull,
            identifiable=calibration.identifiable,
            status=calibration.status,
        )
    return rows


def correlation_rows(calibrations: Sequence[Calibration]) -> Rows:
    """Return the correlated pairs of every calibration's parameters."""
    rows = Rows("correlations")
    for calibration in calibrations:
        entries = calibration.parameters.entries
        correlation = calibration.covariance / np.outer(calibration.sigma, calibration.sigma)
        first, second = np.nonzero(np.triu(np.abs(np.nan_to_num(correlation)) >= LEAST_CORRELATION, 1))
        rows.add(
            model=calibration.case.structure.name,
            deformation=calibration.case.deformation,
            leg=[_leg(entries[i]) for i in first],
            parameter=[entries[i].name for i in first],
            other_leg=[_leg(entries[j]) for j in second],
            other_parameter=[entries[j].name for j in second],
            correlation=np.clip(correlation[first, second], -1.0, 1.0),
        )
    return rows


def _leg(entry: Parameter) -> int | None:
    return None if entry.leg == SHARED else entry.leg + 1
