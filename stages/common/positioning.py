"""Positions of an axis as deviations, and prior knowledge of the axis."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import Array
from truing.estimation.interferometry.iso230 import InstrumentUncertainty
from truing.estimation.interferometry.recorded_steps import REFERENCE_C
from truing.stages.common.point_arrays import number_column

if TYPE_CHECKING:
    from truing.schemas.interferometer import Interferometer

_UM = 1e3  # per mm
SEED = 230


def deviations(rows: pa.Table) -> tuple[Array, Array]:
    """Targets (P,) in mm and deviations (P, 2, C) in um of the rows of a run, which are in order."""
    target = np.unique(number_column(rows, "target_mm"))
    shape = len(target), 2, -1  # forward and backward
    off = number_column(rows, "position_mm") - number_column(rows, "target_mm")
    return target, off.reshape(shape) * _UM


def instrument(rows: pa.Table, optics: Interferometer) -> InstrumentUncertainty:
    """Uncertainty of the axis' length by the correction to 20 degrees C; none without a correction."""
    axis, spread = optics.material.axis, optics.surroundings_sigma
    if axis is None:
        return InstrumentUncertainty()
    return InstrumentUncertainty(
        expansion=axis.expansion_per_k,
        expansion_sigma=axis.expansion_sigma_per_k,
        temperature_sigma=0.0 if spread is None else spread.material_temperature_c,
        warmer_by=float(np.mean(number_column(rows, "material_temperature_c"))) - REFERENCE_C,
    )
