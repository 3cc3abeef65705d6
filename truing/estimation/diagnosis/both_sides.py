"""How surely data tell the shape of an effect, asked on both sides of its value: far from linear, curvature misleads.

A time constant shorter than a load is held hardly differs from a still shorter one: there the sum of squares rises by
less than its curvature at the minimum promises, and sigma is taken from how much it does.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.estimation.diagnosis.fitted_model import Fitter, Stand

# So many sigmas to either side it is asked; at most so many times as wide the answer makes a sigma.
_REACH, _WIDEST = 2.0, 4.0


def both_sides(fitter: Fitter, final: Stand, cause: Any, size: int) -> NDArray:
    """Return factors (P, P) on the covariance of a cause in the final model, all of whose parameters but the first
    ``size`` are its shape: those that make sigmas of shapes what the wider side's rise of the sum of squares says."""
    values, covariance = final.values(cause)
    wider = np.ones(len(values))
    for place in range(size, len(values)):
        step = _REACH * np.sqrt(covariance[place, place]) * (np.arange(len(values)) == place)
        held = [cause.held_at((values + way * step)[size:]) for way in (-1.0, 1.0)]
        rises = [_rise(fitter, final, cause, own) for own in held if own is not None]
        least = min((np.sqrt(max(rise, 0.0)) for rise in rises), default=_REACH)
        wider[place] = np.clip(_REACH / max(least, 1e-9), 1.0, _WIDEST)
    return np.outer(wider, wider)


def _rise(fitter: Fitter, final: Stand, cause: Any, held: Any) -> float:
    """Return by how much the sum of squares rises, in those of the noise, where a cause's shape is held."""
    causes = tuple(held if other is cause else other for other in final.causes)
    without = fitter.stand(causes, final)
    return float(np.sum(without.fit.whitened.rest**2) - np.sum(final.fit.whitened.rest**2)) / final.noise_ratio**2
