"""Epochs that deviate as a whole: several observations of one epoch deviate together, though none is a gross error."""

from __future__ import annotations

import numpy as np

from truing.inference.arrays import Array
from truing.inference.fitted_model import FittedModel, epoch_height, observation_residuals
from truing.inference.model import CauseT


def p_values(fitted: FittedModel[CauseT]) -> Array:
    """Return the p-value (B,) of the residuals of observations and inputs of each epoch, at the noise found, corrected
    for the number of epochs.

    The largest residual of an epoch does not count: one bad observation, or noise with heavy tails, is no deviation of
    the epoch. Nor do the coordinates that determine what is fitted to each epoch, such as its frame. NaN where no
    coordinate is left.
    """
    from scipy.special import chdtrc  # all of scipy.stats takes 0.5 s to import

    residuals = observation_residuals(fitted.fit, fitted.measured)
    squares = np.where(fitted.measured.is_observed, np.sum(residuals**2, axis=-1), 0.0)
    epochs, count = len(squares), fitted.measured.is_observed.sum(axis=1)
    height = epoch_height(fitted.measured) + fitted.fit.whitened.problem.local_value.shape[1]
    of_epoch = np.sum(fitted.fit.whitened.rest[: epochs * height].reshape(epochs, height) ** 2, axis=1)
    rest = (of_epoch - squares.max(axis=1, initial=0.0)) / fitted.noise_ratio**2
    fitted_there = fitted.fit.frames.size + int(np.sum(fitted.model.unpredicted))
    freedom = fitted.measured.size * (count - 1) - fitted_there
    values = epochs * chdtrc(np.maximum(freedom, 1), np.maximum(rest, 0.0))
    return np.where(freedom > 0, np.minimum(values, 1.0), np.nan)
