"""How far the way out and the way back of a load lie apart, for every load and channel, as table rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.responses.tables import Rows
from stages.sensor.reading_arrays import CHANNELS, LOADS, READING_SI
from truing.estimation.interferometry.load_run import BranchGap, branch_gap

Array = NDArray[np.float64]

_MEASURED = "measured"


def branch_gap_rows(rows: Rows, load: Array, run: NDArray[np.int64], reading: Array, sigma: Array) -> None:
    """Add the widest gap, met loads of all runs taken together, and the probability of such gaps by chance.

    load (B, 6), reading and sigma (B, 6), SI, NaN where there is none. Of runs that load one axis alone.
    """
    loaded = np.stack([np.any(load[run == r] != 0.0, axis=0) for r in range(int(run.max(initial=-1)) + 1)])
    for a, axis in enumerate(LOADS):
        alone = np.flatnonzero(loaded[:, a] & (loaded.sum(1) == 1))
        for k, channel in enumerate(CHANNELS):
            gaps = [_gap(load[run == r, a], reading[run == r, k], sigma[run == r, k]) for r in alone]
            if met := [gap for gap in gaps if len(gap.load)]:
                _add(rows, f"{channel} under {axis}", k, met)


def _gap(load: Array, reading: Array, sigma: Array) -> BranchGap:
    seen = np.isfinite(reading)
    return branch_gap(load, reading, float(np.sqrt(np.mean(sigma[seen] ** 2))) if seen.any() else 1.0)


def _add(rows: Rows, subject: str, k: int, met: list[BranchGap]) -> None:
    from scipy.special import chdtrc

    load, gap, sigma = (np.concatenate([getattr(one, name) for one in met]) for name in ("load", "gap", "sigma"))
    _, at = np.unique(load, return_inverse=True)
    mean = np.bincount(at, gap / sigma**2) / np.bincount(at, sigma**-2.0)
    widest = float(mean[np.argmax(np.abs(mean))] / READING_SI[k])
    unit = "um" if k < 3 else "arcsec"
    chance = float(chdtrc(len(gap), np.sum((gap / sigma) ** 2)))
    rows.add(model=_MEASURED, figure="branch_gap", value=widest, unit=unit, subject=subject)
    rows.add(model=_MEASURED, figure="branch_gap_p_value", value=chance, unit="1", subject=subject)
