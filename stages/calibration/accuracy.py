"""How far a calibrated machine's poses are from the measured ones, and how far noise alone would put them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stages.common.rows import Rows
from truing.calibration.accuracy import ARCSEC, PoseErrors
from truing.calibration.measured import Measured


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
