"""Standard deviations in tables: from what no instrument resolves to what is no measurement any more."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.schemas.column import SIGMA_BOUNDS

if TYPE_CHECKING:
    from truing.formats.faultlog import FaultLog
    from truing.formats.gather import Gathered

Array = NDArray[np.float64]


# The square of a bound is no exact number.
_ROUNDING = 1e-9


def check_sigma(
    found: Gathered, values: Array, name: str, unit: str, log: FaultLog, *, or_zero: bool = False, cure: str = ""
) -> None:
    """Note rows whose standard deviation (N,), in ``unit``, is 0 or beyond ``SIGMA_BOUNDS``; NaN is none given.

    ``or_zero``: 0 is allowed, and stands for what is taken as exact. ``cure``: what to do where none is known.
    """
    least, most = SIGMA_BOUNDS[unit]
    too_small = (values < least) & ~((values == 0.0) & or_zero)
    expected = f"{'0, or ' if or_zero else 'a standard deviation above 0, from '}{least:g} to {most:g} {unit}{cure}"
    found.fault(log, np.asarray(too_small | (values > most), dtype=bool), name, expected)


def check_variance(found: Gathered, values: Array, name: str, unit: str, log: FaultLog) -> None:
    """Note rows whose variance (N,), in ``unit`` squared, is 0 or beyond the squares of ``SIGMA_BOUNDS``."""
    least, most = (bound**2 for bound in SIGMA_BOUNDS[unit])
    wrong = (values < least * (1.0 - _ROUNDING)) | (values > most * (1.0 + _ROUNDING))
    found.fault(log, np.asarray(wrong, dtype=bool), name, f"a variance above 0, from {least:g} to {most:g} {unit}²")
