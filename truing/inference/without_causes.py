"""Prediction error of a fitted model without some of its causes, after the measurement's set-up is fitted again."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from truing.inference.fit import linearise
from truing.inference.fitted_model import FittedModel
from truing.inference.model import CauseT, ConditionsLike
from truing.inference.observations import Epochs
from truing.inference.prediction import PredictionError, prediction_error, without_epoch_unknowns

_ROUNDS, _LEAST_GAIN = 20, 1e-6  # of the sum of squares, in the last round

Errors = tuple[PredictionError[CauseT], PredictionError[CauseT] | None]  # of fitted and of held-out epochs


def errors_without(
    fitted: FittedModel[CauseT], causes: Collection[CauseT], held_out: Epochs[ConditionsLike] | None
) -> Errors[CauseT]:
    """Return the errors of a model without some of its causes on fitted and held-out epochs.

    Other unknowns stay as identified. Those of the set-up, which no prior knowledge fixes (``Model.setup``), are fitted
    anew: else the error would include effects that they absorb.
    """
    others = tuple(cause for cause in fitted.causes if all(cause is not left for left in causes))
    model = fitted.model.with_causes(others)
    shared = fitted.model.embedded(fitted.fit.shared, model)
    error = prediction_error(model, fitted.measured, fitted.fit.frames, shared)
    for _ in range(_ROUNDS if model.setup.any() else 0):
        better = _after_step(error)
        gain = float(np.sum(error.squares) - np.sum(better.squares))
        if gain > 0.0:
            error = better
        if not gain > _LEAST_GAIN * float(np.sum(error.squares)):
            break
    if held_out is None or fitted.held_out is None:
        return error, None
    there = fitted.held_out.model.with_causes(others)
    return error, prediction_error(there, held_out.measured, held_out.frames, error.shared)


def _after_step(error: PredictionError[CauseT]) -> PredictionError[CauseT]:
    """Return the error after a least-squares step of the set-up's unknowns alone."""
    model, measured, at = error.model, error.measured, error.model.setup
    linear = linearise(model.predict, measured, error.frames, error.shared, error.local)
    design = without_epoch_unknowns(linear.by_shared[..., at], error.by_fitted, measured, model.zero_groups)
    rows = design.reshape(-1, design.shape[-1])
    shared = error.shared.copy()
    shared[at] += np.linalg.lstsq(rows, error.whitened.reshape(-1), rcond=None)[0]
    return prediction_error(model, measured, error.frames, shared)
