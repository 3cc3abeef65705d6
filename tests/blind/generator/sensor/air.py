"""The refractive index of moist air near 633 nm, by the short equation of NIST's Engineering Metrology Toolbox."""

from __future__ import annotations

import numpy as np

from tests.blind.generator.quaternions import Array


def index(air: Array) -> Array:
    """Refractive index (S,) for rows (S, 4) with the columns ``schedule.COLUMNS``: time, degrees C, hPa, per cent.

    Accurate to 1e-7 between 0 and 35 C.
    """
    t, kilopascal, humidity = air[:, 0], air[:, 1] / 10, air[:, 2]
    return np.asarray(1 + 7.86e-4 * kilopascal / (273 + t) - 1.5e-11 * humidity * (t**2 + 160))
