"""Whether loads and signals determine a calibration, and what is missing where they do not.

The printed formula inverts V V^T. That has no inverse where channels repeat one another or loads leave a direction out;
where it differs from singular by noise alone, its inverse is that noise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from truing.estimation.design.combinations import inseparable
from truing.estimation.design.observability import observe

_LEAST = 1e-8  # share of the unit columns' largest singular value that is no zero
# Power of a combination of signals over that of its noise, below which it counts as noise; and, of the scatter of the
# latter in few rows, how many sigmas.
_OVER_NOISE, _SIGMAS = 2.0, 6.0


class UndeterminedCalibrationError(ValueError):
    """Loads or signals that do not determine the calibration asked for; says which combinations are missing."""


def check_determined(columns: NDArray, labels: Sequence[str], what: str) -> None:
    """Raise UndeterminedCalibrationError, naming combinations, unless columns (N, Q) are independent.

    ``what`` is what has to be independent, in words. Columns may differ in unit by any factor.
    """
    unseen = _unseen(columns, labels)
    if unseen:
        raise UndeterminedCalibrationError(f"{what}: {'; '.join(unseen)}")


def _unseen(columns: NDArray, labels: Sequence[str]) -> list[str]:
    """Return in words what columns (N, Q) leave open: names that are always zero, and combinations."""
    length = np.linalg.norm(columns, axis=0)
    idle = length <= _LEAST**2 * max(length.max(initial=0.0), np.finfo(float).tiny)
    said = [f"{label} is zero in all rows" for label, none in zip(labels, idle, strict=True) if none]
    used = [label for label, none in zip(labels, idle, strict=True) if not none]
    if not used:
        return said
    seen = observe(columns[:, ~idle], 1.0 / length[~idle], used, unidentifiable=1.0 / _LEAST)
    return said + [group.text for group in inseparable(seen)]


def check_signals(signals: NDArray, signal_cov: NDArray | None, labels: Sequence[str]) -> None:
    """Raise UndeterminedCalibrationError unless V V^T of signals (N, C) has an inverse that is not noise.

    signal_cov (C, C): covariance of one row's errors; where nobody declared it, rounding alone is the limit.
    """
    rank = "V V^T is singular"
    check_determined(signals, labels, f"{rank}, the channels are not independent")
    if signal_cov is None:
        return
    level = np.sqrt(np.diag(signal_cov))
    known = level > 0
    if not known.any():
        return
    rows = len(signals)
    least = np.sqrt(rows * max(_OVER_NOISE, 1.0 + _SIGMAS * np.sqrt(2.0 / rows)))
    used = [label for label, noisy in zip(labels, known, strict=True) if noisy]
    seen = observe(signals[:, known], 1.0 / level[known], used, unidentifiable=1.0 / least)
    if seen.rank < known.sum():
        unseen = "; ".join(group.text for group in inseparable(seen))
        raise UndeterminedCalibrationError(
            f"{rank} but for noise: {len(signals)} rows hold {seen.rank} independent signals in {known.sum()} channels "
            f"({unseen}); apply loads in more directions, or fit signals to loads (direction 'forward')"
        )


def check_loads(loads: NDArray, labels: Sequence[str]) -> None:
    """Raise UndeterminedCalibrationError, naming the loads, unless loads (N, W) were applied in every direction."""
    unseen = _unseen(loads, labels)
    if unseen:
        raise UndeterminedCalibrationError(
            f"the loads leave a direction of the wrench out: {'; '.join(unseen)}; apply loads that tell them apart"
        )
