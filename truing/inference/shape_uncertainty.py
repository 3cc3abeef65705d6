"""Uncertainty of a cause's nonlinear shape parameters, from the rise of the sum of squares on both sides of the
optimum."""

from __future__ import annotations

import numpy as np

from truing.inference.arrays import Array
from truing.inference.fitted_model import FittedModel
from truing.inference.fitter import Fitter
from truing.inference.model import CauseT

# Shapes are held at this many sigmas to either side; a sigma is widened at most by this factor.
_REACH, _WIDEST = 2.0, 4.0


def shape_covariance_factors(fitter: Fitter[CauseT], final: FittedModel[CauseT], cause: CauseT, size: int) -> Array:
    """Return factors (P, P) on the covariance of a cause in the final model, which widen the sigmas of its shape.

    All parameters after the first ``size`` are its shape. Each sigma is widened until it matches the smaller rise of
    the sum of squares on the two sides.
    """
    values, covariance = final.values(cause)
    wider = np.ones(len(values))
    for index in range(size, len(values)):
        step = _REACH * np.sqrt(covariance[index, index]) * (np.arange(len(values)) == index)
        held = [cause.with_fixed_shape((values + way * step)[size:]) for way in (-1.0, 1.0)]
        rises = [_rise(fitter, final, cause, fixed) for fixed in held if fixed is not None]
        least = min((np.sqrt(max(rise, 0.0)) for rise in rises), default=_REACH)
        wider[index] = np.clip(_REACH / max(least, 1e-9), 1.0, _WIDEST)
    return np.outer(wider, wider)


def _rise(fitter: Fitter[CauseT], final: FittedModel[CauseT], cause: CauseT, held: CauseT) -> float:
    """Return the rise of the sum of squares, in units of the noise, if a cause's shape is held at given values."""
    causes = tuple(held if other is cause else other for other in final.causes)
    without = fitter.comparable(causes, final)
    return float(np.sum(without.fit.whitened.rest**2) - np.sum(final.fit.whitened.rest**2)) / final.noise_ratio**2
