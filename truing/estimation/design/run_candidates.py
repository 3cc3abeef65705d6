"""Runs of readings that could be measured next, as poses are.

Steps of a run belong together: each counts from the run's zero, and what a structure remembers goes from one to the
next. So runs are chosen whole, by the same sums as poses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.estimation.design.rival_design import Candidates, Fitted


@dataclass(frozen=True)
class Readout:
    """One standard deviation (K,), SI, of what further readings would be off by, and of their zero in a run."""

    sigma: NDArray
    zero: NDArray


@dataclass(frozen=True)
class Runs:
    """R runs of S ``steps`` each, one after the other in ``conditions`` (R S), and what can be read in them.

    Candidate c is the run ``run`` (C,) with the channels ``reads`` (C, N).
    """

    conditions: Any
    steps: int
    run: NDArray
    reads: NDArray

    def by_run(self, values: NDArray) -> NDArray:
        """Return values (R S, K, ...) as those of the candidates (C, S N, ...)."""
        count, read = self.reads.shape
        of_runs = values.reshape(len(values) // self.steps, self.steps, *values.shape[1:])
        found = of_runs[self.run[:, None, None], np.arange(self.steps)[:, None], self.reads[:, None]]
        return np.asarray(found.reshape(count, self.steps * read, *values.shape[2:]))


def run_candidates(fitted: Fitted, runs: Runs, readout: Readout) -> Candidates:
    """Return runs as a fitted model sees them; a run's own unknowns are its zeros, and the load errors of its steps."""
    model = fitted.model.at(runs.conditions)
    whole = len(runs.conditions.readings)
    found = model.predict(fitted.shared, np.zeros((whole, model.local_size)))
    weight = 1.0 / readout.sigma[:, None]
    predicted = runs.by_run((found.values[:, :, 0] * weight[:, 0])[..., None])[..., 0]
    rows = runs.by_run(found.by_shared[:, :, 0] * weight)
    of_steps = _of_steps(runs.by_run(found.by_local[:, :, 0] * weight), runs.steps)
    own = np.concatenate([of_steps, _zeros(runs, readout)], -1)
    priors = np.broadcast_to(np.eye(own.shape[2]), (len(own), *[own.shape[2]] * 2))
    return Candidates(fitted, predicted, rows, np.linalg.qr(np.concatenate([own, priors], 1))[0])


def _of_steps(columns: NDArray, steps: int) -> NDArray:
    """Return how readings (C, S N, H) follow each step's own unknowns, as columns (C, S N, S H)."""
    count, size, each = columns.shape
    apart = columns.reshape(count, steps, size // steps, 1, each) * np.eye(steps)[:, None, :, None]
    return np.asarray(apart.reshape(count, size, steps * each))


def _zeros(runs: Runs, readout: Readout) -> NDArray:
    """Return how readings (C, S N) follow the zeros of their channels, (C, S N, N)."""
    count, read = runs.reads.shape
    own = (readout.zero / readout.sigma)[runs.reads]
    each = own[:, None, :, None] * np.eye(read)
    return np.broadcast_to(each, (count, runs.steps, read, read)).reshape(count, -1, read)
