"""Names of what effects depend on: columns of the campaign, and what is known of each actuator by itself."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

TIME, ORDER, TEMPERATURE = "time_s", "order", "temperature_c"
OWN_DRIVE, APPROACH, LAST_STEP, MEMORY = "own drive", "approach", "last step", "memory"
# What is known of each actuator by itself: its own displacement, and how it came to the pose.
LOOKING_BACK = (APPROACH, LAST_STEP, MEMORY)
PER_ACTUATOR = (OWN_DRIVE, *LOOKING_BACK)


def drive_of(column: str) -> int | None:
    """Return which leg's displacement a column is, counted from 1; none where it is another."""
    number = column.removeprefix("rho").removesuffix("_mm")
    return int(number) if column == f"rho{number}_mm" and number.isdigit() else None


def varying(covariates: Mapping[str, NDArray], seen: NDArray | None = None) -> dict[str, NDArray]:
    """Return the columns of numbers (B,) that vary, at epochs ``seen`` (B,); the order only where there is no time."""
    own = slice(None) if seen is None else seen
    found = {
        name: values
        for name, values in covariates.items()
        if np.ndim(values) == 1 and np.asarray(values).dtype.kind in "fiu" and np.isfinite(values).all()
        if np.size(values[own]) and np.ptp(values[own]) > 0
    }
    return {name: values for name, values in found.items() if name != ORDER or TIME not in found}


def middle_and_half(values: NDArray) -> tuple[float, float]:
    """Return the centre of values and half their range."""
    return float(values.max() + values.min()) / 2, float(values.max() - values.min()) / 2
