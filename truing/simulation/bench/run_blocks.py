"""Which load steps are left out of a fit together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.load_steps import LOADS, LoadSteps

_BLOCKS = 5  # of what is left out in turn


def run_blocks(steps: LoadSteps) -> NDArray:
    """Return a number for each step (B,): whole runs, one of each that loads the same axes; parts of a run where no
    other loads its axes."""
    axes = (steps.load != 0.0) @ (1 << np.arange(len(LOADS)))
    pattern = np.zeros(int(steps.code.max(initial=-1)) + 1, int)
    np.bitwise_or.at(pattern, steps.code, axes)
    alike = pattern[:, None] == pattern
    # Runs that load the same axes may each read another channel: not one channel's runs are left out all at once.
    of_axes = np.unique(pattern, return_inverse=True)[1]
    of_run = (np.tril(alike, -1).sum(1) + of_axes) % _BLOCKS
    length = np.bincount(steps.code)
    within = steps.rank * _BLOCKS // np.maximum(length, 1)[steps.code]
    return np.where(alike.sum(1)[steps.code] > 1, of_run[steps.code], within)
