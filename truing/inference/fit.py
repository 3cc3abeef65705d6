"""Gauss-Newton fit of a model of observations to observations of all groups and epochs, each epoch in a frame of its
own.

Knows no mechanism: the model is a function of shared and local unknowns that returns observations and derivatives. A
observation has d coordinates: three, or one where an instrument reads a number; numbers have no frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from truing.inference.arrays import Array
from truing.inference.linear_problem import Linearised, Whitened, whiten
from truing.inference.model import Predict
from truing.inference.observations import Frames, Observations

_MAX_ITERATIONS = 25
# A step that makes things worse, far from the optimum, is halved until it does not.
_MOST_HALVINGS = 8
# A fit has settled when its next step would lower the sum of squares by less than this: nothing moves by more than a
# hundredth of its standard deviation then.
_SETTLED = 1e-4


class FitState(StrEnum):
    """How a fit ended."""

    SETTLED = "settled"
    NOT_SETTLED = "not-settled"


@dataclass(frozen=True)
class Fit:
    """The unknowns at the optimum, in prior sigmas, the frames, and the whitened problem there."""

    shared: Array  # (G,)
    local: Array  # (B, H) without the frames
    frames: Frames
    whitened: Whitened
    state: FitState
    iterations: int


def fit_model(predict: Predict, measured: Observations, frames: Frames, shared: Array, local: Array) -> Fit:
    """Return the maximum of posterior probability over shared (G,) and local (B, H) unknowns and frames."""
    problem = linearise(predict, measured, frames, shared, local)
    for iteration in range(_MAX_ITERATIONS):
        whitened = whiten(problem)
        if whitened.explained < _SETTLED:
            return Fit(shared, local, frames, whitened, FitState.SETTLED, iteration)
        of_shared, of_local = whitened.step()
        for halved in range(_MOST_HALVINGS):
            part = 0.5**halved
            own = shared + part * of_shared, local + part * of_local[:, frames.size :]
            moved = frames.moved(part * of_local[:, : frames.size])
            problem = linearise(predict, measured, moved, *own)
            if problem.squares <= whitened.problem.squares:
                break
        (shared, local), frames = own, moved
    return Fit(shared, local, frames, whiten(problem), FitState.NOT_SETTLED, _MAX_ITERATIONS)


def linearise(
    predict: Predict, measured: Observations, frames: Frames, shared: Array, local: Array, by_shared: bool = True
) -> Linearised:
    """Return the whitened problem at some values of the unknowns; the frames' six come first among the local ones.

    Derivatives by the shared unknowns are many, and left out (G = 0) where they are not asked for.
    """
    found = predict(shared, local, by_shared)
    arms = found.values @ np.swapaxes(frames.R, 1, 2)
    gap = measured.values - arms - frames.t[:, None]
    turned = measured.whitener @ frames.R[:, None]
    by_local = np.concatenate([measured.whitener @ frames.columns(arms), turned @ found.by_local], -1)
    epochs, height = len(arms), arms.shape[1] * arms.shape[2]
    return Linearised(
        residual=(measured.whitener @ gap[..., None]).reshape(epochs, -1),
        by_local=by_local.reshape(epochs, height, by_local.shape[-1]),
        by_shared=_turned(turned, found.by_shared).reshape(epochs, height, -1 if by_shared else 0),
        local_value=np.concatenate([np.zeros((epochs, frames.size)), local], 1),
        shared_value=shared,
        extra_residual=found.known_residual,
        extra_by_shared=found.known_by_shared,
        present=np.repeat(measured.seen, measured.size, axis=1),
        local_known=np.concatenate([np.zeros(frames.size, bool), found.local_known]),
        shared_known=found.shared_known,
    )


def _turned(turned: Array, slopes: Array) -> Array:
    """Return slopes (B, K, d, G) multiplied by matrices (B, K, d, d): numbers where observations are numbers."""
    return turned * slopes if turned.shape[-1] == 1 else turned @ slopes
