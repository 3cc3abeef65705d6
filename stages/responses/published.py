"""Published displacements compared with those of this campaign at the same load."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from truing.arrays import Array
from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS, READING_SI
from truing.simulation.bench.six_upur.nominal_sensor import SimulatedCompliance
from truing.stages.common.rows import Rows

_BAR = 1.959963985  # of 95 %, in sigmas
_SAME = 1e-3  # of a load: two records of the same one
_COPIED = ("load", "channel", "applied", "source", "published", "unit")


@dataclass(frozen=True)
class _Curve:
    """Measured displacement at each applied load (n,), ascending; zero without load."""

    applied: Array
    measured: Array
    sigma: Array

    def at(self, load: float) -> tuple[float, float]:
        """Return value and sigma at a load, interpolated; NaN beyond the loads applied."""
        if not len(self.applied) or not self.applied[0] <= load / (1.0 + _SAME) <= self.applied[-1]:
            return math.nan, math.nan
        return tuple(float(np.interp(load, self.applied, each)) for each in (self.measured, self.sigma))  # type: ignore[return-value]


def compared_with_published(published: pa.Table, curves: pa.Table, simulated: SimulatedCompliance | None) -> Rows:
    """Compare theory with the simulation and a measurement with the measurement, each at the published load.

    A published theory may differ by what the tolerances leave open. A published measurement may be of another specimen,
    so that noise and the tolerances of both count. Without a simulation there is no verdict.
    """
    rows = Rows("published_compared")
    for row in published.to_pylist():
        value, sigma = _simulated(row, simulated)
        measured, own_sigma, allowed = value, sigma, _BAR * sigma
        if row["source"] == "measurement":
            measured, own_sigma = _curve(curves, row["load"], row["channel"]).at(row["applied"])
            allowed = _BAR * math.hypot(own_sigma, math.sqrt(2.0) * sigma)
        rows.add(
            **{name: row[name] for name in _COPIED},
            own=measured,
            own_sigma=own_sigma,
            allowed_difference=allowed,
            verdict=_verdict(abs(row["published"] - measured), allowed),
            **{name: row[name] for name in ("published_in",) if name in row},
        )
    return rows


def _verdict(difference: float, allowed: float) -> str | None:
    if not math.isfinite(difference) or not math.isfinite(allowed):
        return None
    return "agrees" if difference <= allowed else "differs"


def _simulated(row: dict[str, object], simulated: SimulatedCompliance | None) -> tuple[float, float]:
    """Return the simulated displacement at a published load, and its sigma, um or arcsec; NaN without simulation."""
    if simulated is None:
        return math.nan, math.nan
    i, j = CHANNELS.index(str(row["channel"])), LOADS.index(str(row["load"]))
    load = float(str(row["applied"])) / READING_SI[i]
    return float(simulated.entries[i, j] * load), float(simulated.sigma[i, j] * abs(load))


def _curve(curves: pa.Table, load: str, channel: str) -> _Curve:
    rows = [row for row in curves.to_pylist() if (row["load"], row["channel"]) == (load, channel)]
    applied = np.array([row["applied"] for row in rows], float)
    at, index = np.unique(applied, return_inverse=True)
    weight = np.array([row["sigma"] for row in rows], float) ** -2.0
    total = np.bincount(index, weight)
    mean = np.bincount(index, weight * np.array([row["measured"] for row in rows], float)) / total
    return _Curve(at, mean, np.asarray(total**-0.5))
