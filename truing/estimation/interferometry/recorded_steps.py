"""Load steps of a bench as arrays in SI: what was applied, what channels and signals read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LOADS = ("fx", "fy", "fz", "mx", "my", "mz")
CHANNELS = ("dx", "dy", "dz", "rx", "ry", "rz")
ARCSECOND = np.pi / 180.0 / 3600.0
# What one unit of a channel's readings is in SI.
READING_SI = np.array([1e-6] * 3 + [ARCSECOND] * 3)
Index = NDArray[np.int64]


@dataclass(frozen=True)
class RecordedSteps:
    """The load steps of a campaign in the order taken: B steps of R runs.

    ``reading`` (B, 6) in m and rad, NaN where a channel was not read; ``sigma`` (B, 6) one standard deviation, NaN
    where none is declared; ``load`` (B, 6) in N and N m; ``signal`` (B, S) in V, NaN where there is none. ``run`` (B,)
    counts in ``runs``. ``covariates`` (B,) are surroundings and further columns, in the units of their names.
    """

    runs: tuple[int | str, ...]
    run: NDArray[np.int64]
    step: NDArray[np.int64]
    time_s: Array
    load: Array
    reading: Array
    sigma: Array
    signal: Array
    held_out: NDArray[np.bool_]
    covariates: Mapping[str, Array]

    @property
    def signals(self) -> tuple[str, ...]:
        """The names of the signal channels: v1, v2, .."""
        return tuple(f"v{number + 1}" for number in range(self.signal.shape[1]))

    def chosen(self, rows: NDArray[np.bool_]) -> RecordedSteps:
        """Some of the steps; runs keep their numbers."""
        own = ("run", "step", "time_s", "load", "reading", "sigma", "signal", "held_out")
        covariates = {name: values[rows] for name, values in self.covariates.items()}
        return replace(self, **{name: getattr(self, name)[rows] for name in own}, covariates=covariates)


def repeated_runs(steps: RecordedSteps) -> list[Index]:
    """Rows (R, S) of runs of the same loads in the same order, group by group."""
    alike: dict[bytes, list[Index]] = {}
    for run in range(len(steps.runs)):
        rows = np.flatnonzero((steps.run == run) & ~steps.held_out)
        if len(rows) > 1:
            alike.setdefault((steps.load[rows].round(9) + 0.0).tobytes(), []).append(rows)
    return [np.array(rows) for rows in alike.values() if len(rows) > 1]
