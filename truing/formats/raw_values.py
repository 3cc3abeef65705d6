"""Arithmetic on a raw column: scaled, shifted, wrapped, and divided by a coverage factor, in this order."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from truing.schemas.raw_value import RawValue

if TYPE_CHECKING:
    import pyarrow as pa


def as_meant(values: pa.Array, meant: RawValue) -> pa.Array:
    """Numbers (N,) of a raw column as what they stand for, in the unit that the mapping gives; null stays null."""
    if meant.is_plain:
        return values
    import pyarrow as pa

    plain = np.array(values.cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=float)
    gone = np.asarray(values.is_null())
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite becomes a fault
        plain = plain * meant.scale + meant.offset
        if meant.modulo is not None:
            lowest = meant.lowest or 0.0
            turned = np.mod(plain - lowest, meant.modulo)
            plain = np.where(turned < meant.modulo, turned, 0.0) + lowest  # just below 0 rounds to a whole period
    return pa.array(plain / (meant.coverage or 1.0), mask=gone)
